"""
Kill every command that writes files or starts processes at random moments; check the rest.

``python -m bench.torture_kill [KILLS [SEED]]`` resumes an earlier run with the same seed.
"""

from collections import Counter
from contextlib import suppress
import os
from pathlib import Path
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile

from bench.journal import FOLDER, Journal
from flexx2_sim_ros.recording import open_recording
import numpy as np

MARK = 'FLEXX2_TORTURE'
_PATIENCE = 30.0  # seconds until children have ended
_SHARE_KILLED = 0.5  # the others get SIGINT or SIGTERM
WRONG = ('orphans', 'damaged', 'leftovers', 'loud')
_QUIET = ('Traceback', 'Exception', 'Error', 'Warning')


def _whole_archive(path):
    with zipfile.ZipFile(path) as archive:
        if archive.testzip() is not None:
            raise ValueError(f'{path}: damaged')


def _whole_png(path):
    if not path.read_bytes().endswith(b'IEND\xaeB`\x82'):
        raise ValueError(f'{path}: cut off')


# Command, seconds until it has started everything, and a check of each output.
COMMANDS = {
    'simulate': (
        ('simulate', 'campaign/a.npz', 'out.npz', '--frames', '200000'),
        4,
        {'out.npz': _whole_archive},
    ),
    'convert mcap': (('convert', 'long.npz', 'out.mcap'), 4, {'out.mcap': open_recording}),
    'convert sqlite3': (
        ('convert', 'long.npz', 'out', '--storage', 'sqlite3'),
        4,
        {'out': open_recording},
    ),
    'convert npz': (('convert', 'long.npz', 'out.npz'), 4, {'out.npz': open_recording}),
    'effects show': (
        ('effects', 'show', 'offset', '--out', 'out.png'),
        8,
        {'out.png': _whole_png},
    ),
    'effects presets': (('effects', '--write-presets', 'out'), 2, {}),
    'capture': (
        ('characterize', 'capture', 'out', '--jobs', '2', '--frames', '60'),
        10,
        {'out/*.npz': _whole_archive},
    ),
    'fit': (
        ('characterize', 'fit', 'campaign', '--out', 'out', '--jobs', '2'),
        8,
        {'out/*.png': _whole_png},
    ),
    'diagnose': (('gap', 'diagnose', 'campaign', '--out', 'out', '--jobs', '2'), 12, {}),
    'benchmark': (
        ('gap', 'benchmark', '--quick', '--out', 'out', '--jobs', '2'),
        12,
        {'out/sealed/truth/*.npz': _whole_archive},
    ),
    'demo': (('demo', '--out', 'out', '--renderer', 'ray'), 12, {'out/*.png': _whole_png}),
    'view': (('view', '--demo', '--no-browser', '--port', '0'), 12, {}),
}


def run(kills=240, seed=0, out=FOLDER):
    """
    Start commands, end each at a random moment, half of them with kill -9; print a table.

    * `seed`: seed of the moments and signals
    * `out`: folder for ``kills.jsonl``, a line for each kill; kills that are in it are left out

    Returns ``kills`` in total, ``by_command`` and ``by_signal``; ``finished``, the number of
    commands that ended before the kill; and lists of failures: ``orphans``, ``damaged``,
    ``leftovers`` (after SIGINT and SIGTERM), ``loud`` (wrong exit status or a traceback after
    these).
    """
    journal = Journal(out / 'kills.jsonl', seed=seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_inputs(folder)
        for index in range(len(journal), kills):
            rng = random.Random(f'{seed} {index}')
            command = list(COMMANDS)[index % len(COMMANDS)]
            number = (
                signal.SIGKILL
                if rng.random() < _SHARE_KILLED
                else rng.choice((signal.SIGINT, signal.SIGTERM))
            )
            journal.add(kill_one(folder, command, number, rng.random()))
    entries = list(journal)[:kills]
    result = {
        'kills': len(entries),
        'by_command': dict(Counter(entry['command'] for entry in entries)),
        'by_signal': dict(Counter(entry['signal'] for entry in entries)),
        'finished': sum(entry['finished'] for entry in entries),
        **{name: [text for entry in entries for text in entry[name]] for name in WRONG},
    }
    for key, value in result.items():
        print(f'{key:12s} {value}')
    return result


def write_inputs(folder):
    """Write what the commands read: a campaign of two recordings, and a long recording."""
    rng = np.random.default_rng(1)
    clean = np.full((43, 56), 1.5, np.float32)
    matrix = np.array([[52.0, 0.0, 27.5], [0.0, 53.0, 21.0], [0.0, 0.0, 1.0]])
    (folder / 'campaign').mkdir()
    for path, frames in (('campaign/a.npz', 40), ('campaign/b.npz', 40), ('long.npz', 3000)):
        depth = clean + rng.normal(0, 0.003, (frames, 43, 56)).astype('f4')
        np.savez(
            folder / path,
            clean_depth=clean,
            K=matrix,
            depth=depth,
            usecase='Mode_9_30fps',
            stamp=np.arange(frames) / 30,
        )


def kill_one(folder, command, number, moment):
    """
    Start a command of `COMMANDS`, and send it a signal.

    `moment` is when, as a part of the time until it has started everything, after it handles
    signals. Returns the journal's entry: lists of what was wrong, by the names in `WRONG`.
    """
    words, seconds, checks = COMMANDS[command]
    for path in folder.glob('out*'):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    scratch = folder / 'tmp'
    scratch.mkdir(exist_ok=True)
    env = {**os.environ, MARK: str(folder), 'TMPDIR': str(scratch)}
    name = signal.Signals(number).name
    said = f'{command}, {name} after {moment * seconds:.2f} s'
    result = {'command': command, 'signal': name, **{key: [] for key in WRONG}}
    with subprocess.Popen(
        [sys.executable, '-m', 'flexx2_sim_ros.cli.main', *words],
        env=env,
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        _wait(lambda: handles_signals(process.pid) or process.poll() is not None)
        with suppress(subprocess.TimeoutExpired):
            process.wait(moment * seconds)
        finished = process.poll() is not None
        process.send_signal(number)
        _, errors = process.communicate()
    result['finished'] = finished
    if not _wait(lambda: not family(folder)):
        result['orphans'].append(said)
        for pid in family(folder):
            os.kill(pid, signal.SIGKILL)
    for pattern, check in checks.items():
        for path in folder.glob(pattern):
            try:
                check(path)
            except Exception as error:  # noqa: B902 - a damaged file raises anything
                result['damaged'].append(f'{said}: {error}')
    if number != signal.SIGKILL and not finished:
        if process.returncode not in (128 + number, 0) or any(w in errors for w in _QUIET):
            result['loud'].append(f'{said}: {process.returncode}: {errors[-300:]}')
        left = [*folder.rglob('.flexx2-*'), *scratch.iterdir()]
        if left:
            result['leftovers'].append(f'{said}: {[path.name for path in left]}')
    for path in (*folder.glob('.flexx2-*'), *scratch.iterdir()):
        shutil.rmtree(path, ignore_errors=True)
    return result


def family(folder):
    """Return the processes that come of commands with this mark, zombies left out."""
    mark = f'{MARK}={folder}\0'.encode()
    found = []
    for entry in Path('/proc').iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and mark in (entry / 'environ').read_bytes():
                found.append(int(entry.name))
    return found


def handles_signals(pid, numbers=(signal.SIGINT, signal.SIGTERM)):
    """Say whether a process handles these signals; Python alone handles SIGINT only."""
    with suppress(OSError):
        status = Path(f'/proc/{pid}/status').read_text()
        caught = int(status.split('SigCgt:')[1].split()[0], 16)
        return all(caught & 1 << (number - 1) for number in numbers)
    return False


def _wait(condition):
    end = time.monotonic() + _PATIENCE
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))
