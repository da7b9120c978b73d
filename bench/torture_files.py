"""
Damaged and hostile files through every command that reads them.

``python -m bench.torture_files [FILES [SEED]]`` resumes an earlier run with the same seed.
"""

from collections import Counter
from concurrent.futures import as_completed
from contextlib import redirect_stderr, redirect_stdout
import io
from pathlib import Path
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zipfile

from bench.journal import FOLDER, Journal
from bench.timing import peak_megabytes
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.processes import workers
from flexx2_sim_ros.recording import load_recording
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

from made_bags import every_kind, unlike  # noqa: E402, I100

# A command with more CPU time than this hangs; the first ones of a process import and compile.
# Waiting may be due to a busy machine.
_HANG_SECONDS = 40
_WAIT_SECONDS = 120
_BAD = ('traceback', 'hang', 'wrong')
# Small recordings are fast to read, and damage is more often in their structure.
_FRAMES = 4
# More processes than cores: they wait for the disk and for subscribers.
_PROCESSES = 4
_SAID = ('damaged', 'cut off', 'not whole')
_HOSTILE_SHAPES = (
    '(18446744073709551616, 1)',
    '(True, 43, 56)',
    '(-1, 43, 56)',
    '(12, 43, 56, 1)',
    '(4294967296, 43, 56)',
    '()',
    '(12, 0, 56)',
    '(12,)' * 500,
    '(' * 300,
    '(1e9, 43, 56)',
)
_HOSTILE_KEYS = (
    'depth',
    'usecase',
    '\x1b[31mkey',
    '../../key',
    'k' * 60_000,
    '',
    'seed',
    'clean_depth',
    'stamp',
)
_HOSTILE_TYPES = ('<f4', '|O', '<U1000000000', '<M8[ns]', '|V2147483647', '>c16', '')


def _flip(data, rng):
    for _ in range(int(rng.choice([1, 1, 1, 8]))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def _flip_structure(data, rng):
    at = int(rng.integers(min(4096, len(data))))
    data[at if rng.random() < 0.5 else -1 - at] ^= 1 << int(rng.integers(8))


def _cut(data, rng):
    del data[int(rng.integers(len(data))) :]


def _zero(data, rng):
    at = int(rng.integers(len(data))) // 4096 * 4096
    data[at : at + 4096] = bytes(len(data[at : at + 4096]))


def _swap(data, rng):
    size = int(rng.choice([512, 4096]))
    one, other = (int(rng.integers(max(1, len(data) // size))) * size for _ in range(2))
    first, second = data[one : one + size], data[other : other + size]
    if len(first) == len(second):
        data[one : one + size], data[other : other + size] = second, first


def _noise(data, rng):
    at = int(rng.integers(len(data)))
    size = min(64, len(data) - at)
    data[at : at + size] = rng.bytes(size)


_DAMAGES = (_flip, _flip_structure, _cut, _zero, _swap, _noise)


def _hostile(path, whole, rng):
    """Write an archive with one array of an unusual shape, type and key."""
    key = _HOSTILE_KEYS[int(rng.integers(len(_HOSTILE_KEYS)))]
    text = (
        f"{{'descr': {_HOSTILE_TYPES[int(rng.integers(len(_HOSTILE_TYPES)))]!r}, "
        f"'fortran_order': {bool(rng.integers(2))}, "
        f"'shape': {_HOSTILE_SHAPES[int(rng.integers(len(_HOSTILE_SHAPES)))]}, }}\n"
    )
    header = b'\x93NUMPY\x01\x00' + len(text).to_bytes(2, 'little') + text.encode()
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name != f'{key}.npy':
                new.writestr(name, old.read(name))
        new.writestr(f'{key}.npy', header + bytes(int(rng.choice([0, 1000, 1 << 26]))))


def _words(index, kind, path, whole, folder):
    """Return a command that reads the file; slow commands are rare."""
    out = folder / 'out'
    if path.suffix == '.yaml':
        option = '--profile' if kind == 'profile' else '--effects'
        return ['simulate', str(whole), f'{out}.npz', '--frames', '2', option, str(path)]
    if index % 200 == 7:
        return ['gap', 'diagnose', str(path.parent), '--out', str(out), '--jobs', '1']
    if index % 30 == 11:
        return ['replay', str(path), '--wait', '0', '--rate', '100', '--no-clock']
    if index % 10 == 3:
        return ['characterize', 'fit', str(path.parent), '--out', str(out), '--jobs', '1']
    if path.suffix == '.npz' and index % 4 == 1:
        return ['simulate', str(path), f'{out}.npz', '--frames', '2']
    return ['convert', str(path), f'{out}{(".npz", ".npz", ".mcap", ".npz", ".db3")[index % 5]}']


class _Hang(BaseException):
    # Commands must not catch this exception.
    pass


def _hang(number, frame):
    raise _Hang


def _limit(computing, waiting):
    signal.setitimer(signal.ITIMER_PROF, computing)
    signal.setitimer(signal.ITIMER_REAL, waiting)


def _one(task):
    """Damage a file and read it; return the journal's entry."""
    index, seed, kinds = task
    rng = np.random.default_rng([seed, index])
    kind = list(kinds)[int(rng.integers(len(kinds)))]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / 'files' / kinds[kind].name
        path.parent.mkdir()
        hostile = _damage(path, kinds[kind], rng)
        words = _words(index, kind, path, kinds['stored'], folder)
        begun, before = time.monotonic(), time.process_time()
        outcome, text = _call(words)
        took, computed = time.monotonic() - begun, time.process_time() - before
        if outcome == '0' and words[0] == 'convert' and not any(word in text for word in _SAID):
            found = unlike(load_recording(words[2]), load_recording(kinds[kind]))
            if found and not hostile:
                outcome, text = 'wrong', f'{found}: {text}'
    command = ' '.join(words[:2] if words[0] in ('gap', 'characterize') else words[:1])
    if kind in ('effects', 'profile'):
        command += f' --{kind}'
    entry = {
        'index': index,
        'outcome': outcome,
        'command': command,
        'seconds': round(took, 2),
        'computing': round(computed, 2),
        'megabytes': round(peak_megabytes(), 1),
    }
    if outcome in _BAD:
        entry['text'] = f'{index} {kind} {" ".join(words)}: {text}'
    return entry


def _damage(path, whole, rng):
    # Write a damaged copy of a file or folder; return whether it was written on purpose.
    if path.suffix == '.npz' and rng.random() < 0.3:
        _hostile(path, whole, rng)
        return True
    file = path
    if whole.is_dir():
        shutil.copytree(whole, path)
        file = sorted(path.iterdir())[int(rng.integers(2))]
    else:
        shutil.copyfile(whole, path)
    data = bytearray(file.read_bytes())
    _DAMAGES[int(rng.integers(len(_DAMAGES)))](data, rng)
    file.write_bytes(data)
    return False


def _call(words):
    said = io.StringIO()
    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, _hang)
    _limit(_HANG_SECONDS, _WAIT_SECONDS)
    try:
        with redirect_stderr(said), redirect_stdout(said):
            outcome = str(main(words))
    except _Hang:
        return 'hang', said.getvalue()
    except BaseException:  # Any exception that a command does not handle is a finding.
        return 'traceback', traceback.format_exc()
    finally:
        _limit(0, 0)
    return outcome, said.getvalue()


def run(files=10_000, seed=0, out=FOLDER):
    """
    Run the commands on damaged files; print and return the outcomes.

    * `seed`: seed of the damage
    * `out`: folder for ``files.jsonl``, a line for each file; files that are in it are left out

    Returns counts by outcome (exit codes, ``traceback``, ``hang``, ``wrong`` for changed values
    without a message), ``commands``, ``details`` of the bad ones, the longest time (``seconds``,
    and ``computing`` of it) and the peak memory of a process.
    """
    journal = Journal(out / 'files.jsonl', seed=seed)
    done = {entry['index'] for entry in journal}
    with tempfile.TemporaryDirectory() as name:
        kinds = _kinds(Path(name))
        tasks = [(index, seed, kinds) for index in range(files) if index not in done]
        with workers(_PROCESSES) as submit:
            for task in as_completed(submit(_one, tasks)):
                journal.add(task.result())
    return _summary([entry for entry in journal if entry['index'] < files], seed)


def _kinds(folder):
    kinds = every_kind(folder, _FRAMES)
    for name, source in (('effects', 'effects/typical.yaml'), ('profile', 'flexx2.yaml')):
        kinds[name] = folder / f'{name}.yaml'
        shutil.copyfile(config_dir() / source, kinds[name])
    return kinds


def _summary(entries, seed):
    counts = Counter(entry['outcome'] for entry in entries)
    commands = Counter(entry['command'] for entry in entries)
    bad = [entry['text'] for entry in entries if entry['outcome'] in _BAD]
    longest = max((entry['seconds'] for entry in entries), default=0.0)
    computing = max((entry['computing'] for entry in entries), default=0.0)
    memory = max((entry['megabytes'] for entry in entries), default=0.0)
    print(
        f'{len(entries)} damaged files, seed {seed}: '
        + ', '.join(f'{count} x {outcome}' for outcome, count in sorted(counts.items()))
        + f'; longest {longest:.1f} s, {computing:.1f} s of computing; peak {memory:.0f} MB'
    )
    print(', '.join(f'{count} x {command}' for command, count in commands.most_common()))
    for text in bad:
        print(text)
    return {
        **counts,
        'commands': dict(commands),
        'details': bad,
        'seconds': longest,
        'computing': computing,
        'megabytes': memory,
    }


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))
