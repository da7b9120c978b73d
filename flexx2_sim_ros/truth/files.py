"""The recordings of a run, and the files that it writes."""

from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
import hashlib
import json
import os
from pathlib import Path
from typing import Any, TypeVar
from zlib import compress, decompress

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.jobs import Map
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.recording import open_recording, RecordingReader
from flexx2_sim_ros.recording.folders import BAG_FILES, find_recordings, is_bag
import numpy as np
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
        path = Path(os.path.abspath(path))  # noqa: PTH100, a link keeps its name; "." has none
        stem, number = path.name, 1
        if path.suffix in ('.npz', *BAG_FILES):
            stem = path.stem
        name = f'{stem}.npz'
        while name in names:
            number += 1
            name = f'{stem}-{number}.npz'
        names.append(name)
    return names


def opened(
    out: Path,
    paths: Sequence[Path],
    camera: str | None,
    profile: Profile | None,
    given: Sequence[Path] = (),
) -> list[RecordingReader | None]:
    """
    Open recordings, and check that their ground truth can be written.

    Parameters
    ----------
    out : pathlib.Path
        The campaign's folder.
    paths : sequence of pathlib.Path
        The recordings.
    camera : str or None
        Which camera of bags that have several.
    profile : Profile or None
        The camera whose modes give the rate of files without stamps (None: the Flexx2).
    given : sequence of pathlib.Path
        What was named: the recordings or their folders, and further files that the run reads.

    Returns
    -------
    list of RecordingReader or None
        None for a file of a folder that cannot be read: the run goes on without it.

    Raises
    ------
    InputError
        When a file that was named cannot be read, a file cannot be written, or one that is read
        would be overwritten; then nothing is computed.

    """
    atomic.check_outputs('--out', out, FILES)
    check_kept(out, [*FILES, *names_of(paths)], [*paths, *given])
    readers: list[RecordingReader | None] = []
    for path in paths:
        try:
            readers.append(open_recording(path, camera, profile))
        except InputError:
            if path in given:
                raise
            readers.append(None)
    for name, reader in zip(names_of(paths), readers, strict=True):
        if reader is not None and (out / name).exists() and not has_truth(out / name):
            raise InputError(
                f'--out: must be a folder without other recordings, got {shown_path(out)}: {name} '
                'there has no clean_depth and would be replaced'
            )
    return readers


def reason_of(error: InputError, path: Path) -> str:
    """Return why a recording cannot be used, without its name, for its row in ``truth.yaml``."""
    return str(error).removeprefix(f'{path}: ')


def check_kept(out: Path, names: Sequence[str], inputs: Sequence[Path]) -> None:
    """
    Check that no input is overwritten or removed, whichever of the inputs a file is written for.

    Parameters
    ----------
    out : pathlib.Path
        The campaign's folder.
    names : sequence of str
        The files to write there.
    inputs : sequence of pathlib.Path
        The files and folders that are read.

    Raises
    ------
    InputError
        When one of the inputs is a file to write, also by another path.

    """
    read = {_identity(path): path for path in inputs}
    for name in names:
        found = _identity(out / name)
        if found is not None and found in read:
            raise InputError(
                f'--out: must be a folder where no input is overwritten, got {shown_path(out)}: '
                f'{name} there is the input {shown_path(read[found])}'
            )


def has_truth(path: Path) -> bool:
    """Return whether a file is a recording with ground truth, as a run writes it."""
    try:
        with open_npz(path) as archive:
            return 'clean_depth' in archive.headers
    except InputError:
        return False


def _identity(path: Path) -> tuple[int, int] | None:
    # The same for all paths to one file, through links as well; None where there is no file.
    try:
        stat = path.stat()
    except (OSError, ValueError):
        return None
    return stat.st_dev, stat.st_ino


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
        try:
            files = sorted(path.iterdir()) if path.is_dir() else [path]
            parts += [(str(f.resolve()), f.stat().st_size, f.stat().st_mtime_ns) for f in files]
        except OSError:  # It cannot be read, as its job says.
            parts.append(str(path))
    return hashlib.sha256(repr(parts).encode('utf-8', 'surrogatepass')).hexdigest()[:32]


def remembered(
    folder: Path,
    names: Sequence[str],
    jobs: Sequence[_Job],
    work: Callable[[_Job], Any],
    mapped: Map,
    tick: Callable[[], None],
    kinds: Sequence[type],
) -> list[Any]:
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
        Function that returns the result of a job; at module level, because other processes call
        it.
    mapped : callable
        A map as from `jobs.workers`.
    tick : callable
        Called after each job that is computed, for progress.
    kinds : sequence of type
        The dataclasses in results, beside arrays, tuples, numbers and texts.

    """
    files = [folder / f'{name}.json' for name in names]
    missing = [
        (work, job, file) for file, job in zip(files, jobs, strict=True) if not file.is_file()
    ]
    if missing:
        atomic.output_folder(folder)
        mapped(_write_result, missing, tick)
    named = {kind.__name__: kind for kind in kinds}
    return [_whole(json.loads(file.read_text(encoding='utf-8')), named) for file in files]


def _write_result(item: tuple[Callable[[_Job], Any], _Job, Path]) -> None:
    work, job, file = item
    atomic.write_text(file, json.dumps(work(job), default=_parts))


def _parts(value: Any) -> dict[str, Any]:
    # An array or a dataclass, as JSON has none.
    if isinstance(value, np.ndarray):
        text = b64encode(compress(np.ascontiguousarray(value).tobytes())).decode()
        return {'array': text, 'dtype': value.dtype.str, 'shape': value.shape}
    own = {field.name: getattr(value, field.name) for field in fields(value)}
    return {'kind': type(value).__name__, 'own': own}


def _whole(value: Any, kinds: Mapping[str, type]) -> Any:
    # What `_parts` took apart; lists were tuples.
    if isinstance(value, list):
        return tuple(_whole(one, kinds) for one in value)
    if not isinstance(value, dict):
        return value
    if 'array' in value:
        flat = np.frombuffer(decompress(b64decode(value['array'])), value['dtype'])
        return flat.reshape(value['shape'])
    return kinds[value['kind']](**{key: _whole(one, kinds) for key, one in value['own'].items()})
