"""Write messages into a bag in a separate thread, and find missing frames by their stamps."""

from collections.abc import Sequence
from dataclasses import dataclass
import queue
import sqlite3
import threading
import time
from types import TracebackType

from flexx2_sim_ros.atomic import reason
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.bag_writer import BagWriter
import numpy as np
from rosbags.interfaces import Qos

# Well below the second that may be lost: a flush takes time as well.
_FLUSH_SECONDS = 0.25


class BagSink:
    """
    Write messages as they arrive, through a queue of at most `capacity` bytes.

    `put` never waits: it refuses messages when the queue is full. If this process crashes, the
    bag lacks at most the last second. The writer is opened and closed by the thread.

    `error` says why writing ended early; later messages are refused. `waiting` are the bytes in
    the queue. `remarks` are added to the bag's custom data at its end.
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

        Raises InputError when the bag could not be written to its end.
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


_NEIGHBOURS = 8
_QUARTILE = 12  # of 17 steps: the upper one
# Jitter stays below this many periods; one missing frame makes two.
_GAP_PERIODS = 1.5


@dataclass(frozen=True)
class Gaps:
    """
    Gaps in the stamps of a stream: how many, and the longest, seconds; 0 without gaps.

    ``returns`` is the number of stamps that went back or repeated.
    """

    count: int = 0
    longest: float = 0.0
    returns: int = 0


def find_gaps(stamps: Sequence[int]) -> Gaps:
    """
    Compare each step between stamps, nanoseconds in the order of messages, with those around it.

    The usual step is the upper quartile of the eight steps before and after. So a change of the
    rate is no gap, nor are the alternating steps of a 45 Hz mode with 60 Hz input.
    """
    steps = np.diff(np.asarray(stamps, np.int64))
    forward = steps[steps > 0]
    returns = len(steps) - len(forward)
    if len(forward) < 3:
        return Gaps(returns=returns)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(forward, _NEIGHBOURS, mode='symmetric'), 2 * _NEIGHBOURS + 1
    )
    usual = np.sort(around, axis=1)[:, _QUARTILE]
    gaps = forward[forward > _GAP_PERIODS * usual]
    return Gaps(len(gaps), float(gaps.max(initial=0)) / 1e9, returns)
