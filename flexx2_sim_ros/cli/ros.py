"""Common parts of the subcommands that need ROS, and nodes as their child processes."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import importlib.util
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.runtime import make_room_for_images
from flexx2_sim_ros.processes import watched_environment
from flexx2_sim_ros.signals import exit_status, SIGNALS


@dataclass
class Stop:
    """Whether this process was told to stop, by `signals`; a callable."""

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
    Start ROS for the block, or raise `InputError` when there is none.

    Ctrl-C and SIGTERM do not interrupt the block; what is yielded tells of them.
    """
    if importlib.util.find_spec('rclpy') is None:
        raise InputError(
            'ROS 2 is not installed or not sourced: rclpy cannot be imported. Source a ROS 2 '
            'Jazzy installation, or run pip install "flexx2_sim_ros[ros]"'
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


Processes = dict[str, 'subprocess.Popen[bytes]']


def node_command(node: str, *remappings: str, **parameters: Any) -> list[str]:
    """Return the module of a node and its arguments: remappings, as ``from:=to``, and values."""
    words = [node, '--ros-args']
    for one in remappings:
        words += ['-r', one]
    for name, value in parameters.items():
        words += ['-p', f'{name}:={value}']
    return words


def camera_command(camera: str, **parameters: Any) -> list[str]:
    """Return the command that starts the camera node of a robot's camera."""
    return node_command('flexx2_camera', f'__ns:=/{camera}', **parameters)


@contextmanager
def nodes(commands: Mapping[str, Sequence[str]], folder: Path) -> Iterator[Processes]:
    """
    Run nodes as separate processes, with their logs in a folder.

    All end with the block and with this process, even if it is killed. ``commands`` are, by the
    log's name, a module of ``flexx2_sim_ros.nodes`` and its arguments. Yields the processes.
    """
    processes: Processes = {}
    try:
        for name, (module, *rest) in commands.items():
            with (folder / f'{name}.log').open('wb') as log:
                # Nothing is written to stdin. It closes with this process, which ends the node.
                # In a separate session, so that a terminal's Ctrl-C goes only to this process.
                processes[name] = subprocess.Popen(
                    [sys.executable, '-m', f'flexx2_sim_ros.nodes.{module}', *rest],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=watched_environment(),
                    start_new_session=True,
                )
        yield processes
    finally:
        for process in processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in processes.values():
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def check(processes: Processes, folder: Path) -> None:
    """Raise `InputError` with the last line of the log if a process has ended."""
    for name, process in processes.items():
        if process.poll() is not None:
            log = (folder / f'{name}.log').read_text(errors='replace').strip().splitlines()
            raise InputError(
                f'{name} ended with exit code {process.returncode}: '
                f'{log[-1] if log else "no output"} (log: {folder / name}.log)'
            )
