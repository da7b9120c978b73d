"""The recordings of a run, and the files that it writes."""

from collections.abc import Callable, Sequence
import hashlib
from pathlib import Path
from typing import Any, TypeVar

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.jobs import Map
from flexx2_sim_ros.recording import open_recording, RecordingReader
from flexx2_sim_ros.recording.folders import BAG_FILES, find_recordings, is_bag
import yaml

FILES = 'truth.yaml', 'truth.html'
CACHE = '.truth'  # folder for the results of an interrupted run
_Job = TypeVar('_Job')


def recordings_of(given: Sequence[Path]) -> list[Path]:
    """Return the recordings among paths to recordings and to folders of them."""
    paths: list[Path] = []
    for path in given:
        folder = path.is_dir() and not is_bag(path)
        paths += find_recordings(path) if folder else [path]
    return paths


def names_of(paths: Sequence[Path]) -> list[str]:
    """Return the names of the files that recordings with ground truth are written to."""
    names: list[str] = []
    for path in paths:
        stem, number = path.name, 1
        if path.suffix in ('.npz', *BAG_FILES):
            stem = path.stem
        name = f'{stem}.npz'
        while name in names:
            number += 1
            name = f'{stem}-{number}.npz'
        names.append(name)
    return names


def opened(out: Path, paths: Sequence[Path], camera: str | None) -> list[RecordingReader]:
    """
    Open recordings, and check that their ground truth can be written.

    Raises
    ------
    InputError
        When a file cannot be read or written; then nothing is computed.

    """
    atomic.check_outputs('--out', out, FILES)
    readers = []
    for path, name in zip(paths, names_of(paths), strict=True):
        readers.append(open_recording(path, camera))
        atomic.check_distinct(path, out / name)
    return readers


def write_results(out: Path, table: dict[str, Any], html: str) -> None:
    """Write ``truth.yaml`` and ``truth.html``, both or none."""
    with atomic.whole_files(atomic.output_folder(out)) as part:
        text = yaml.safe_dump(table, sort_keys=False, allow_unicode=True)
        (part / FILES[0]).write_text(text, encoding='utf-8')
        (part / FILES[1]).write_text(html, encoding='utf-8', errors='backslashreplace')


def digest(paths: Sequence[Path], words: Sequence[Any]) -> str:
    """Return a digest of files, in their present state, and of other values."""
    parts: list[Any] = [__version__, *words]
    for path in paths:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        parts += [(str(f.resolve()), f.stat().st_size, f.stat().st_mtime_ns) for f in files]
    return hashlib.sha256(repr(parts).encode('utf-8', 'surrogatepass')).hexdigest()[:32]


def remembered(
    folder: Path,
    names: Sequence[str],
    jobs: Sequence[_Job],
    work: Callable[[_Job], str],
    mapped: Map,
    tick: Callable[[], None],
) -> list[str]:
    """
    Return the results of jobs; results of an earlier run are read from files.

    Parameters
    ----------
    folder : pathlib.Path
        Folder for results; each is written whole or not at all.
    names : sequence of str
        The `digest` of each job.
    jobs : sequence of object
        The arguments of `work`.
    work : callable
        Function that returns the result of a job as text; at module level, because other processes
        call it.
    mapped : callable
        A map as from `jobs.workers`.
    tick : callable
        Called after each job that is computed, for progress.

    """
    files = [folder / f'{name}.json' for name in names]
    missing = [
        (work, job, file) for file, job in zip(files, jobs, strict=True) if not file.is_file()
    ]
    if missing:
        atomic.output_folder(folder)
        mapped(_write_result, missing, tick)
    return [file.read_text(encoding='utf-8') for file in files]


def _write_result(item: tuple[Callable[[_Job], str], _Job, Path]) -> None:
    work, job, file = item
    atomic.write_text(file, work(job))
