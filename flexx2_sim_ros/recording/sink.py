"""Write messages into a bag in a separate thread."""

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

# Well below the second that may be lost: a flush takes time as well.
_FLUSH_SECONDS = 0.25


class BagSink:
    """
    Write messages as they arrive, through a queue of bounded size.

    `put` never waits: it refuses messages when the queue is full. If this process crashes, the
    bag lacks at most the last second.

    Parameters
    ----------
    writer : BagWriter
        The bag; it is opened and closed by the thread.
    capacity : int
        Largest size of the queue, bytes.

    Attributes
    ----------
    error : InputError or None
        Why writing ended early; later messages are refused.
    waiting : int
        Bytes in the queue.
    remarks : dict of str to str
        Remarks that are added to the bag's custom data at its end.

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
        """Set the QoS of a topic's publishers, before its first message; see `BagWriter`."""
        self._writer.offers[topic] = offers

    def put(self, message: Message) -> bool:
        """Add a message; return whether there was room for it."""
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
        """Close the bag, also after an error."""
        self.close()

    def close(self) -> None:
        """
        Write the queue, and close the bag.

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
        except Exception as error:  # The recording thread must learn of every error.
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
