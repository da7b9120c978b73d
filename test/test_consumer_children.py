"""What a consumer starts ends with it: real processes, found by their numbers."""

from pathlib import Path
import sys

from flexx2_sim_ros.consumers.loading import ConsumerSource
from flexx2_sim_ros.consumers.running import run
from programs import PATIENCE, started, until
import pytest

CONSUMER = """
import os
from pathlib import Path
import subprocess


class Parent:
    name, measures = 'parent', {'error': 'mm'}

    def __init__(self):
        child = subprocess.Popen(['sleep', '1000'])
        here = Path(__file__)
        here.with_suffix('.part').write_text(str(child.pid))
        here.with_suffix('.part').rename(here.with_suffix('.pid'))


class Good(Parent):
    def look(self, view):
        return 0

    def errors(self, seen, true):
        return {'error': 0.0}


class Ends(Good):
    def __init__(self):
        super().__init__()
        os._exit(1)


class Raises(Good):
    def __init__(self):
        super().__init__()
        raise SystemExit


class Hangs(Good):
    def __init__(self):
        super().__init__()
        import time
        time.sleep(1000)
"""
COMMAND = """
import sys
from flexx2_sim_ros.consumers.loading import ConsumerSource
from flexx2_sim_ros.consumers.running import run
from flexx2_sim_ros.signals import leave_on_signals

if __name__ == '__main__':
    leave_on_signals()
    run(ConsumerSource('mine', sys.argv[1], 'Hangs', True), [], 1.0, lambda: None)
"""


def ended(pid):
    """Say whether a process has ended; nobody may have asked for its exit status."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] in 'ZX'
    except OSError:
        return True


@pytest.fixture
def file(tmp_path):
    """Return a file with consumers that start a process and say which."""
    path = tmp_path / 'mine.py'
    path.write_text(CONSUMER)
    return path


@pytest.mark.parametrize('name', ['Good', 'Ends', 'Raises'])
def test_children_of_a_consumer_end_with_it(file, name):
    result = run(ConsumerSource('mine', str(file), name, True), [], 1.0, lambda: None)
    assert bool(result.fault) == (name != 'Good')
    child = int(file.with_suffix('.pid').read_text())
    until(lambda: ended(child))


@pytest.mark.parametrize('end', ['terminate', 'kill'])
def test_children_of_a_consumer_end_with_the_command(file, end):
    script = file.with_name('command.py')
    script.write_text(COMMAND)
    with started([sys.executable, script, file]) as command:
        until(file.with_suffix('.pid').exists)
        child = int(file.with_suffix('.pid').read_text())
        assert not ended(child)
        getattr(command, end)()
        command.wait(PATIENCE)
    until(lambda: ended(child))
