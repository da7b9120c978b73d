"""Start and end a node the way a process manager expects it; shared memory for its images."""

from collections.abc import Callable
import os
import signal
import sys
import time
from traceback import format_exception
from typing import Any

from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.signals import SIGNALS

_REPEAT_SECONDS = 5.0


def run_node(make_node: Callable[[], Any], args: list[str] | None = None) -> int:
    """
    Make a node and spin it until it is told to stop.

    Parameters
    ----------
    make_node : callable
        Returns the node; called after ``rclpy.init``.
    args : list of str, optional
        Command line, ``sys.argv`` when left out.

    Returns
    -------
    int
        The process's exit code: 0 after Ctrl-C, SIGTERM or a shutdown, 1 when the node could
        not start (the reason is on stderr).

    """
    import rclpy
    from rclpy.exceptions import NameValidationException, ParameterException
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import install_signal_handlers, SignalHandlerOptions

    node = None
    make_room_for_images()
    told: list[int] = []
    try:
        # rclpy's signal handlers are installed at the end of this block, when a node exists.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        for number in SIGNALS:
            signal.signal(number, lambda number, _frame: told.append(number))
        # From here on a signal ends spin(), so that the node can leave the ROS graph. A signal
        # that came between these lines is in `told`.
        install_signal_handlers(SignalHandlerOptions.ALL)
        if not told:
            _spin(executor, node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (InputError, NameValidationException, ParameterException) as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except Exception as error:
        if node is None and not rclpy.ok():
            print(f'error: ROS arguments: {error}', file=sys.stderr)
            return 1
        # A signal inside a callback invalidates the context that the callback uses.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return 0


def _spin(executor: Any, node: Any) -> None:
    """Run a node's callbacks until it is told to stop; an error in one does not end the node."""
    throttle = Throttle()
    while executor.context.ok():
        try:
            executor.spin()
        except Exception as error:
            _survive(error, executor, node, throttle)


def spin_some(executor: Any, node: Any, throttle: 'Throttle', seconds: float) -> None:
    """Wait this long for a callback of a node and run it; its error does not end the node."""
    try:
        executor.spin_once(timeout_sec=seconds)
    except Exception as error:
        _survive(error, executor, node, throttle)


def _survive(error: Exception, executor: Any, node: Any, throttle: 'Throttle') -> None:
    # Ctrl-C and SIGTERM; inside a callback they invalidate the context that it uses.
    if not executor.context.ok():
        raise error
    if throttle.ready(type(error).__name__):
        node.get_logger().error(
            f'internal error, please report it: {unquoted("".join(format_exception(error)), 4000)}'
        )


class Throttle:
    """Limit how often messages with the same key are logged."""

    def __init__(self) -> None:
        """Start without messages."""
        self._said: dict[str, float] = {}

    def ready(self, key: str, every: float = _REPEAT_SECONDS) -> bool:
        """Return whether a message may be logged now, at most once in ``every`` seconds."""
        now = time.monotonic()
        if now - self._said.get(key, float('-inf')) < every:
            return False
        self._said[key] = now
        return True


PROFILE_VARIABLES = (
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
)


def make_room_for_images() -> None:
    """
    Give the publishers of this process more shared memory; to be called before ``rclpy.init``.

    ``config/fastdds.xml`` explains why. A user's own configuration of Fast DDS, in any of its
    environment variables, has priority. Other middleware ignores it.
    """
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        os.environ[PROFILE_VARIABLES[0]] = str(config_dir() / 'fastdds.xml')
