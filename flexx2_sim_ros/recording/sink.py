"""Messages into a bag from a thread of its own."""

import queue
import sqlite3
import threading
import time
from types import TracebackType

from flexx2_sim_ros.atomic import reason
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.bag_writer import BagWriter
from rosbags.interfaces import Qos

_FLUSH_SECONDS = 1.0


class BagSink:
    """
    Write messages while they come, through a queue of bounded size.

    `put` never waits: what does not fit is refused, for the caller to count. When this process
    dies, at most the last second is missing from the bag.

    Parameters
    ----------
    writer : BagWriter
        The bag; it is opened and closed by the thread.
    capacity : int
        How many bytes of messages wait at most.

    Attributes
    ----------
    error : InputError or None
        Why writing has ended early; what comes after it is refused.
    waiting : int
        Bytes that wait.
    remarks : dict of str to str
        What goes into the bag's custom data at its end.

    """

    def __init__(self, writer: BagWriter, capacity: int) -> None:
        """Start the thread."""
        self.error: InputError | None = None
        self.waiting = 0
        self.remarks: dict[str, str] = {}
        self._writer = writer
        self._capacity = capacity
        self._queue: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name='bag writer')
        self._thread.start()

    def offer(self, topic: str, offers: list[Qos]) -> None:
        """Say what a topic's publishers offer, before its first message; see `BagWriter`."""
        self._writer.offers[topic] = offers

    def put(self, message: Message) -> bool:
        """Take a message; say whether there was room for it."""
        with self._lock:
            if self.error is not None or self.waiting + len(message.data) > self._capacity:
                return False
            self.waiting += len(message.data)
        self._queue.put(message)
        return True

    def __enter__(self) -> 'BagSink':
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, however the block ends."""
        self.close()

    def close(self) -> None:
        """
        Write what waits, and close the bag.

        Raises
        ------
        InputError
            When the bag could not be written to its end.

        """
        self._queue.put(None)
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            with self._writer as writer:
                self._write(writer)
                for key, value in self.remarks.items():
                    writer.note(key, value)
        except InputError as error:
            self.error = error
        except (OSError, sqlite3.Error) as error:
            self.error = InputError(
                f'{self._writer.path}: {reason(error)}; earlier messages are in the bag'
            )
        except Exception as error:  # Whatever it is, the thread that records has to know.
            self.error = InputError(f'{self._writer.path}: cannot be written: {shown(error, 200)}')

    def _write(self, writer: BagWriter) -> None:
        flushed = time.monotonic()
        while True:
            try:
                message = self._queue.get(timeout=_FLUSH_SECONDS)
            except queue.Empty:
                pass
            else:
                if message is None:
                    return
                writer.write(*message)
                with self._lock:
                    self.waiting -= len(message.data)
            if time.monotonic() - flushed > _FLUSH_SECONDS:
                writer.flush()
                flushed = time.monotonic()
