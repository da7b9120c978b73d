"""What the subcommands that need ROS share."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import importlib.util
import signal

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.runtime import leave_at_once_on_signals
from flexx2_sim_ros.nodes.transport import make_room_for_images


@contextmanager
def ros() -> Iterator[Callable[[], bool]]:
    """
    Start ROS for the block, with Ctrl-C and SIGTERM as a question instead of an interruption.

    Yields
    ------
    callable
        Says whether the process was told to stop.

    Raises
    ------
    InputError
        When there is no ROS.

    """
    if importlib.util.find_spec('rclpy') is None:
        raise InputError('ROS 2 is not there: rclpy cannot be imported. Wanted a sourced ROS 2 '
                         'Jazzy, or pip install "flexx2_sim_ros[ros]"')
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    leave_at_once_on_signals()
    make_room_for_images()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    told: list[int] = []
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    for number in before:
        signal.signal(number, lambda number, _frame: told.append(number))
    try:
        yield lambda: bool(told)
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
