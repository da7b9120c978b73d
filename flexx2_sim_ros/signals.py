"""
End a process on Ctrl-C and SIGTERM.

Imports little, so that a command can handle signals before its other imports.
"""

from collections.abc import Callable
import os
import signal
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_BY_SIGNAL = 128  # plus the signal's number: the exit status that shells give
_SHOW_CURSOR = b'\x1b[?25h'
_cleaning: list[Callable[[], None]] = []


def exit_status(number: int) -> int:
    """Return the exit status of a command that a signal has ended."""
    return _BY_SIGNAL + number


def before_leaving(clean: Callable[[], None]) -> None:
    """Register a function that is called before the process ends."""
    _cleaning.append(clean)


def leave_on_signals(status: Callable[[int], int] = exit_status) -> None:
    """
    Let Ctrl-C and SIGTERM end this process at once, quietly and without leftovers.

    The handler cleans up and does not raise: a library could print an exception as a traceback or
    hide it. ``status`` returns the exit status for a signal's number.
    """

    def handle(number: int, _frame: FrameType | None) -> None:
        leave(status(number))

    for number in SIGNALS:
        signal.signal(number, handle)


def leave(status: int) -> None:
    """Clean up and end this process."""
    for clean in _cleaning:
        clean()
    for stream in (1, 2):
        if os.isatty(stream):
            os.write(stream, _SHOW_CURSOR)  # A progress bar hides it.
    os._exit(status)
