"""How commands end: by a signal, killed, or with their parent. Real processes throughout."""

from contextlib import suppress
import os
import signal
import subprocess

from bench.torture_kill import COMMANDS, family, kill_one, MARK, write_inputs, WRONG
from programs import flexx2_words, PATIENCE, run_python, starting, until
import pytest


@pytest.fixture
def start(tmp_path):
    """Return a function that starts `flexx2`; all that comes of it is gone at the end."""
    env = {**os.environ, MARK: str(tmp_path), 'TMPDIR': str(tmp_path / 'tmp')}
    (tmp_path / 'tmp').mkdir()
    with starting(env=env, cwd=tmp_path) as run:
        yield lambda *words: run(flexx2_words(*words))
    for pid in family(tmp_path):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ('name', 'number', 'moment'),
    [
        ('simulate', signal.SIGINT, 0.0),
        ('simulate', signal.SIGTERM, 0.3),
        ('diagnose', signal.SIGTERM, 0.0),
        ('capture', signal.SIGTERM, 0.2),
    ],
)
def test_a_signal(tmp_path, name, number, moment):
    """Assert 130 and 143, silence, no leftovers and no processes, however early it comes."""
    write_inputs(tmp_path)
    found = kill_one(tmp_path, name, number, moment)
    assert not found['finished']
    assert not any(found[key] for key in WRONG), found


@pytest.mark.parametrize('name', ['fit', 'diagnose'])
def test_workers_end_with_a_killed_command(tmp_path, start, name):
    write_inputs(tmp_path)
    process = start(*COMMANDS[name][0])
    # The command, its resource tracker and its workers; a diagnosis is one of its jobs itself.
    wanted = 3 if name == 'diagnose' else 4
    until(
        lambda: len(family(tmp_path)) >= wanted or process.poll() is not None,
        'there are no workers',
    )
    process.kill()
    process.communicate(timeout=PATIENCE)
    until(lambda: not family(tmp_path), 'a worker outlives its command')


@pytest.mark.parametrize('words', [['modes'], ['gap', '--help']])
def test_a_reader_that_stops_reading_ends_the_command(words):
    """`flexx2 modes | head -1` ends with 128 + SIGPIPE (13), without a word, also unbuffered."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        flexx2_words(*words),
        stdout=writing,
        stderr=subprocess.PIPE,
        env={**os.environ, 'PYTHONUNBUFFERED': '1'},
        check=False,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b'')


@pytest.mark.parametrize('node', ['flexx2_camera', 'go1_cameras'])
def test_a_node_that_is_asked_for_help_prints_it_and_does_not_start(node):
    done = run_python('-m', f'flexx2_sim_ros.nodes.{node}', '--help', check=True, timeout=PATIENCE)
    assert done.stdout.startswith(f'usage: {node}')
    assert f'example: {node} --ros-args' in done.stdout
    assert not done.stderr
