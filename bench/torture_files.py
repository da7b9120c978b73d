"""Damaged and hostile recordings through every command that reads them."""

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
import io
import multiprocessing
import os
from pathlib import Path
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from types import FrameType
import zipfile

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

from made_bags import every_kind, unlike  # noqa: E402, I100

_HANG_SECONDS = 20
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


def _flip(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.choice([1, 1, 1, 8]))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def _flip_structure(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.integers(min(4096, len(data))))
    data[at if rng.random() < 0.5 else -1 - at] ^= 1 << int(rng.integers(8))


def _cut(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(len(data))) :]


def _zero(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.integers(len(data))) // 4096 * 4096
    data[at : at + 4096] = bytes(len(data[at : at + 4096]))


def _swap(data: bytearray, rng: np.random.Generator) -> None:
    size = int(rng.choice([512, 4096]))
    one, other = (int(rng.integers(max(1, len(data) // size))) * size for _ in range(2))
    first, second = data[one : one + size], data[other : other + size]
    if len(first) == len(second):
        data[one : one + size], data[other : other + size] = second, first


def _noise(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.integers(len(data)))
    size = min(64, len(data) - at)
    data[at : at + size] = rng.bytes(size)


_DAMAGES: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    _flip,
    _flip_structure,
    _cut,
    _zero,
    _swap,
    _noise,
)


def _hostile(path: Path, whole: Path, rng: np.random.Generator) -> None:
    """Write an archive with one array of a shape, type and key that nobody writes."""
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


def _words(index: int, path: Path, folder: Path) -> list[str]:
    """Return the command that reads a file: every one, those that take seconds seldom."""
    out = folder / 'out'
    if index % 60 == 7:
        return ['gap', 'diagnose', str(path.parent), '--out', str(out), '--jobs', '1']
    if index % 30 == 11:
        return ['replay', str(path), '--wait', '0', '--rate', '100', '--no-clock']
    if index % 10 == 3:
        return ['characterize', 'fit', str(path.parent), '--out', str(out), '--jobs', '1']
    if path.suffix == '.npz' and index % 4 == 1:
        return ['simulate', str(path), f'{out}.npz', '--frames', '2']
    return ['convert', str(path), f'{out}{(".npz", ".mcap", ".db3")[index % 3]}']


def _hang(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f'more than {_HANG_SECONDS} s')


def _one(task: tuple[int, int, dict[str, Path]]) -> tuple[str, str, float, int]:
    """Damage a file and read it; return outcome, details, seconds and peak memory (kB)."""
    index, seed, kinds = task
    rng = np.random.default_rng([seed, index])
    kind = list(kinds)[int(rng.integers(len(kinds)))]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / 'files' / kinds[kind].name
        path.parent.mkdir()
        hostile = path.suffix == '.npz' and rng.random() < 0.3
        if hostile:
            _hostile(path, kinds[kind], rng)
        else:
            file = path
            if kinds[kind].is_dir():
                shutil.copytree(kinds[kind], path)
                file = sorted(path.iterdir())[int(rng.integers(2))]
            else:
                shutil.copyfile(kinds[kind], path)
            data = bytearray(file.read_bytes())
            _DAMAGES[int(rng.integers(len(_DAMAGES)))](data, rng)
            file.write_bytes(data)
        words = _words(index, path, folder)
        begun = time.monotonic()
        outcome, text = _call(words)
        took = time.monotonic() - begun
        if outcome == '0' and words[0] == 'convert' and not any(word in text for word in _SAID):
            found = unlike(load_recording(words[2]), load_recording(kinds[kind]))
            if found and not hostile:
                outcome, text = 'wrong', f'{found}: {text}'
    return (
        outcome,
        f'{index} {kind} {" ".join(words)}: {text}',
        took,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    )


def _call(words: list[str]) -> tuple[str, str]:
    said = io.StringIO()
    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(_HANG_SECONDS)
    try:
        with redirect_stderr(said), redirect_stdout(said):
            outcome = str(main(words))
    except TimeoutError:
        return 'hang', said.getvalue()
    except BaseException:  # Whatever escapes a command is what is looked for.
        return 'traceback', traceback.format_exc()
    finally:
        signal.alarm(0)
    return outcome, said.getvalue()


def run(files: int = 300, seed: int = 0) -> dict[str, object]:
    """
    Send damaged files through the commands, print what happened, and return it.

    Parameters
    ----------
    files : int
        How many.
    seed : int
        Of the damage.

    Returns
    -------
    dict
        Counts by outcome (exit codes, ``traceback``, ``hang``, ``wrong`` for other values without
        a word), ``details`` of the bad ones, the longest time and the peak memory of a process.

    """
    bad: list[str] = []
    counts: Counter[str] = Counter()
    longest, memory = 0.0, 0
    with tempfile.TemporaryDirectory() as name:
        kinds = every_kind(Path(name))
        with ProcessPoolExecutor(
            os.cpu_count(), multiprocessing.get_context('spawn'), max_tasks_per_child=200
        ) as pool:
            for outcome, text, took, kilobytes in pool.map(
                _one, ((index, seed, kinds) for index in range(files))
            ):
                counts[outcome] += 1
                longest, memory = max(longest, took), max(memory, kilobytes)
                if outcome in ('traceback', 'hang', 'wrong'):
                    bad.append(text)
    print(
        f'{files} damaged files, seed {seed}: '
        + ', '.join(f'{count} x {outcome}' for outcome, count in sorted(counts.items()))
        + f'; longest {longest:.1f} s, peak {memory / 1000:.0f} MB'
    )
    for text in bad:
        print(text)
    return {**counts, 'details': bad, 'seconds': longest, 'megabytes': memory / 1000}


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))
