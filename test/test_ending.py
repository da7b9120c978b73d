"""How commands end: by a signal, killed, or with their parent. Real processes throughout."""

from contextlib import suppress
import os
import random
import signal
import subprocess
import time

from bench.torture_kill import family, handles_signals, MARK
from campaigns import save
import numpy as np
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


def leftovers(folder):
    """Return scratch files and whatever lies in the folder for temporary files."""
    return [*folder.rglob('.flexx2-*'), *(folder / 'tmp').iterdir()]


@pytest.fixture
def campaign(tmp_path):
    """Return a folder with two scenes, one of them long."""
    folder = tmp_path / 'campaign'
    folder.mkdir()
    clean = np.full((43, 56), 1.5, np.float32)
    matrix = np.array([[52.0, 0.0, 27.5], [0.0, 53.0, 21.0], [0.0, 0.0, 1.0]])
    depth = clean + np.random.default_rng(1).normal(0, 0.003, (40, 43, 56)).astype('f4')
    for name in ('a', 'b'):
        save(folder / f'{name}.npz', depth, clean, matrix)
    return folder


COMMANDS = {
    'simulate': ('simulate', 'campaign/a.npz', 'out.npz', '--frames', '200000'),
    'diagnose': ('gap', 'diagnose', 'campaign', '--out', 'out', '--jobs', '2'),
    'capture': ('characterize', 'capture', 'out', '--jobs', '2', '--frames', '3000'),
    'fit': ('characterize', 'fit', 'campaign', '--out', 'out', '--jobs', '2'),
}


@pytest.mark.parametrize(
    ('name', 'number', 'seconds'),
    [
        ('simulate', signal.SIGINT, 0.0),
        ('simulate', signal.SIGTERM, 2.0),
        ('diagnose', signal.SIGTERM, 0.0),
        ('capture', signal.SIGTERM, 2.0),
    ],
)
def test_a_signal(tmp_path, start, campaign, name, number, seconds):
    """Assert 130 and 143, silence, no leftovers and no processes, however early it comes."""
    process = start(*COMMANDS[name])
    until(lambda: handles_signals(process.pid), 'the command does not handle signals')
    time.sleep(seconds * random.Random(f'{name} {number}').random())
    process.send_signal(number)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number, err
    for word in ('Traceback', 'Exception', 'Warning', 'Error'):
        assert word not in err, err
    until(lambda: not family(tmp_path), 'a worker outlives its command')
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize('name', ['fit', 'diagnose'])
def test_workers_end_with_a_killed_command(tmp_path, start, campaign, name):
    process = start(*COMMANDS[name])
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
