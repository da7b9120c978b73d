"""Start and end a node the way a process manager expects it; shared memory for its images."""

from collections.abc import Callable
from contextlib import suppress
import gc
import os
import signal
import sys
from threading import Thread
import time
from traceback import format_exception
from typing import Any

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.signals import SIGNALS

_REPEAT_SECONDS = 5.0


def run_node(make_node: Callable[..., Any], several: bool = False) -> int:
    """
    Make a node and spin it until it is told to stop; return the process's exit code.

    It is 0 after Ctrl-C, SIGTERM or a shutdown, 1 when a node could not start (the reason is on
    stderr). ``make_node`` returns the node; it is called after ``rclpy.init``, with options of
    `rclpy.node.Node`. With ``several``, the command line may name namespaces. Each of them gets a
    node; one that cannot start does not stop the others.
    """
    from flexx2_sim_ros.nodes.executor import MessageExecutor
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.signals import install_signal_handlers, SignalHandlerOptions

    nodes: list[Any] = []
    status = 0
    make_room_for_images()
    told: list[int] = []
    try:
        # rclpy's signal handlers are installed at the end of this block, when a node exists.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        status = _make(make_node, rclpy.utilities.remove_ros_args()[1:] if several else [], nodes)
        if not nodes:
            return status
        # Before a signal can end the context: one that is made after it prints a traceback.
        pairs = [(MessageExecutor(), node) for node in nodes]
        for number in SIGNALS:
            signal.signal(number, lambda number, _frame: told.append(number))
        # From here on a signal ends spin(), so that the node can leave the ROS graph. A signal
        # that came between these lines is in `told`.
        install_signal_handlers(SignalHandlerOptions.ALL)
        if not told:
            _spin_all(pairs)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        if not nodes and not rclpy.ok():
            print(f'error: ROS arguments: {error}', file=sys.stderr)
            return 1
        # A signal inside a callback invalidates the context that the callback uses.
        if rclpy.ok():
            raise
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return status


def _make(make_node: Callable[..., Any], spaces: list[str], nodes: list[Any]) -> int:
    """Add a node, or one in each namespace; return 1 if one could not start, else 0."""
    from rclpy.exceptions import NameValidationException, ParameterException

    status = 0
    made: set[str] = set()
    for space in spaces or ['']:
        try:
            nodes.append(make_node(cli_args=_remap(space, made)) if spaces else make_node())
        except (InputError, NameValidationException, ParameterException) as error:
            print(f'error: {space}: {error}' if space else f'error: {error}', file=sys.stderr)
            status = 1
        if status:
            gc.collect()  # A node that could not start leaves the graph.
    return status


def _remap(space: str, made: set[str]) -> list[str]:
    """Return arguments of ROS that put a node in a namespace, below that of the process."""
    from rclpy.exceptions import InvalidNamespaceException
    from rclpy.validate_namespace import validate_namespace

    base = next((word.partition('__ns:=')[2] for word in sys.argv if '__ns:=' in word), '')
    whole = space if space.startswith('/') else f'{base.rstrip("/")}/{space}'
    if whole in made:
        raise InputError(f'namespace: must be given once, got {whole} again')
    try:
        validate_namespace(whole)
    except InvalidNamespaceException as error:
        raise InputError(
            'namespace: must be a name such as front_left (parameters follow --ros-args), got '
            f'{shown(space)}'
        ) from error
    made.add(whole)
    return ['--ros-args', '-r', f'__ns:={whole}']


def _spin_all(pairs: list[tuple[Any, Any]]) -> None:
    """Run each executor's node in a thread: busy cores have more time for two than for one."""
    import rclpy

    def alongside(executor: Any, node: Any) -> None:
        with suppress(Exception):  # It was told to stop.
            _spin(executor, node)

    for executor, node in pairs:
        executor.add_node(node)
    others = [Thread(target=alongside, args=pair) for pair in pairs[1:]]
    try:
        for one in others:
            one.start()
        _spin(*pairs[0])
    finally:
        rclpy.try_shutdown()
        for one in others:
            one.join()


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


# Jazzy (Fast DDS 2) reads the first, ROS 2 after it (Fast DDS 3) the second.
_OWN = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'
PROFILE_VARIABLES = (*_OWN, 'FASTDDS_BUILTIN_TRANSPORTS')


def make_room_for_images() -> None:
    """
    Give the publishers of this process more shared memory; to be called before ``rclpy.init``.

    ``config/fastdds.xml`` explains why. A user's own configuration of Fast DDS, in any of its
    environment variables, has priority. Other middleware ignores it.
    """
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        os.environ.update(dict.fromkeys(_OWN, str(config_dir() / 'fastdds.xml')))
