"""Nodes as child processes of a command."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
import signal
import subprocess
import sys

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processes import watched_environment

Processes = dict[str, 'subprocess.Popen[bytes]']


def camera_command(camera: str) -> list[str]:
    """Return what starts the camera node of a camera of the Go1."""
    return ['flexx2_camera', '--ros-args', '-r', f'__ns:=/{camera}']


@contextmanager
def nodes(commands: Mapping[str, Sequence[str]], folder: Path) -> Iterator[Processes]:
    """
    Run nodes, each a process of its own with its log in a folder.

    All end with the block, and with this process, even if it is killed.

    Parameters
    ----------
    commands : mapping of str to sequence of str
        By the log's name: a module of ``flexx2_sim_ros.nodes`` and its arguments.
    folder : pathlib.Path
        For the logs.

    Yields
    ------
    dict of str to subprocess.Popen
        The processes.

    """
    processes: Processes = {}
    try:
        for name, (module, *rest) in commands.items():
            with (folder / f'{name}.log').open('wb') as log:
                # Nothing is written to stdin: it ends with this process, and the node with it.
                # In a session of its own: a terminal's Ctrl-C goes to this process alone.
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
    """Raise `InputError` with the last line of its log when one has ended."""
    for name, process in processes.items():
        if process.poll() is not None:
            log = (folder / f'{name}.log').read_text(errors='replace').strip().splitlines()
            raise InputError(
                f'{name} ended with exit code {process.returncode}: '
                f'{log[-1] if log else "no output"} (log: {folder / name}.log)'
            )
