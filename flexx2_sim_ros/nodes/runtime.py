"""Start and end a node the way a process manager expects it."""

from collections.abc import Callable
import os
import signal
import sys
import time
from types import FrameType
from typing import Any

from flexx2_sim_ros.errors import InputError

_REPEAT_SECONDS = 5.0


def leave_at_once_on_signals() -> None:
    """
    Let Ctrl-C and SIGTERM end the process quietly while it is still starting.

    Importing and compiling take a second or two in which rclpy does not handle signals yet.
    Nothing has been opened by then, so leaving at once is safe.
    """
    def leave(_number: int, _frame: FrameType | None) -> None:
        os._exit(0)

    signal.signal(signal.SIGINT, leave)
    signal.signal(signal.SIGTERM, leave)


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
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    node = None
    try:
        rclpy.init(args=args)
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except Exception:
        # A signal that arrives inside a callback invalidates what the callback is using.
        if rclpy.ok():
            raise
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


class Throttle:
    """Let a message with a given key through once every five seconds."""

    def __init__(self) -> None:
        """Start with nothing said."""
        self._said: dict[str, float] = {}

    def ready(self, key: str) -> bool:
        """Say whether the message may be logged now, and remember it."""
        now = time.monotonic()
        if now - self._said.get(key, -_REPEAT_SECONDS) < _REPEAT_SECONDS:
            return False
        self._said[key] = now
        return True
