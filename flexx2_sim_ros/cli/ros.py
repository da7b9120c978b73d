"""Common parts of the subcommands that need ROS."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
import importlib.util
import signal

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.transport import make_room_for_images
from flexx2_sim_ros.signals import exit_status, SIGNALS


@dataclass
class Stop:
    """
    Whether this process was told to stop; a callable.

    Attributes
    ----------
    signals : list of int
        The signals received.

    """

    signals: list[int] = field(default_factory=list)

    def __call__(self) -> bool:
        """Return whether a signal was received."""
        return bool(self.signals)

    @property
    def status(self) -> int:
        """Return the command's exit status: 0, or 130 or 143 after a signal."""
        return exit_status(self.signals[0]) if self.signals else 0


@contextmanager
def ros() -> Iterator[Stop]:
    """
    Start ROS for the block. Ctrl-C and SIGTERM do not interrupt it but are reported.

    Yields
    ------
    Stop
        Returns whether the process was told to stop.

    Raises
    ------
    InputError
        When there is no ROS.

    """
    if importlib.util.find_spec('rclpy') is None:
        raise InputError(
            'ROS 2 is not installed or not sourced: rclpy cannot be imported. Source a ROS 2 '
            'Jazzy installation, or run pip install "flexx2_sim_ros[all,ros]"'
        )
    make_room_for_images()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    stop = Stop()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    before = {
        number: signal.signal(number, lambda number, _frame: stop.signals.append(number))
        for number in SIGNALS
    }
    try:
        yield stop
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
