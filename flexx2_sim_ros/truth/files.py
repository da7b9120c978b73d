"""The recordings of a run, and the files that it writes."""

from collections.abc import Sequence
from dataclasses import replace
import os
from pathlib import Path
from typing import Any

from flexx2_sim_ros import atomic
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.recording import RecordingReader
from flexx2_sim_ros.recording.opening import BAG_FILES, find_recordings, is_bag
from flexx2_sim_ros.recording.reader import uptime_of
from flexx2_sim_ros.truth.run import GivenRecording, TruthRequest
import numpy as np
import yaml

FILES = 'truth.yaml', 'truth.html'
_LONGEST = 24 * 3600.0  # seconds: recordings farther apart are not of one session


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
        stem = path.stem if path.suffix in ('.npz', *BAG_FILES) else path.name
        name, number = f'{stem}.npz', 1
        while name in names:
            number += 1
            name = f'{stem}-{number}.npz'
        names.append(name)
    return names


def uptimes(
    readers: Sequence[RecordingReader], first: float | None = None
) -> list[np.ndarray | None]:
    """
    Return the time since power-on of each recording, (T,) seconds, from stamps of one clock.

    `first` is that of the first frame of the earliest recording. Without it the time is counted
    from there: an error that decays looks the same from any moment on, but for its size.
    Recordings that say their times themselves keep them. None where the stamps are not of one
    clock and one session. Raises `InputError` where `first` cannot be used.
    """
    if not readers:
        return []
    own = [uptime_of(reader) for reader in readers]
    stamps = sorted((reader.stamp_ns for reader in readers), key=lambda stamp: int(stamp[0]))
    begin, why = stamps[0][0], ''
    if any(one is not None for one in own):
        why = 'must not be given where recordings have the key uptime'
    elif any(one[-1] >= other[0] for one, other in zip(stamps, stamps[1:], strict=False)):
        why = 'must be given for recordings of one session and one clock, got stamps that overlap'
    elif (stamps[-1][-1] - begin) / 1e9 >= _LONGEST:
        why = (
            'must be given for recordings of one session and one clock, got more than a day '
            'between two of them'
        )
    if why and first is not None:
        raise InputError(f'--uptime: {why}')
    return own if why else [(one.stamp_ns - begin) / 1e9 + (first or 0.0) for one in readers]


def given_recordings(request: TruthRequest, inputs: Sequence[Path]) -> list[GivenRecording]:
    """
    Return the recordings of a request; those of a folder may be unreadable, as their rows say.

    Raises `InputError` where a folder has none, one that was named cannot be read, its file cannot
    be written, or a file that is read, one of `inputs` too, would be overwritten.
    """
    paths = recordings_of(request.recordings)
    targets = [request.out / name for name in names_of(paths)]
    atomic.check_outputs('--out', request.out, FILES)
    results = [request.out / name for name in FILES]
    _check_kept(request.out, [*results, *targets], [*paths, *request.recordings, *inputs])
    # Each goes to another process, without the paths of all.
    alone = replace(request, recordings=())
    out = [GivenRecording(path, alone, to) for path, to in zip(paths, targets, strict=True)]
    readers: dict[int, RecordingReader] = {}
    for i, one in enumerate(out):
        try:
            readers[i] = one.opened()
        except InputError:
            if one.path in request.recordings:
                raise
            continue
        if one.target.exists() and not has_truth(one.target):
            raise InputError(
                f'--out: must be a folder without other recordings, got {shown_path(request.out)}:'
                f' {one.target.name} there has no clean_depth and would be replaced'
            )
    times = uptimes([*readers.values()], request.uptime)
    for (i, reader), uptime in zip(readers.items(), times, strict=True):
        notes = tuple(dict.fromkeys(reader.notes))
        out[i] = replace(out[i], uptime=uptime, notes=notes)
    return out


def _check_kept(out: Path, written: Sequence[Path], inputs: Sequence[Path]) -> None:
    # No input is overwritten, whichever of the inputs a file is written for, through links or not.
    read = {_identity(path): path for path in inputs}
    for path in written:
        found = _identity(path)
        if found is not None and found in read:
            raise InputError(
                f'--out: must be a folder where no input is overwritten, got {shown_path(out)}: '
                f'{path.name} there is the input {shown_path(read[found])}'
            )


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except (OSError, ValueError):
        return None
    return stat.st_dev, stat.st_ino


def has_truth(path: Path) -> bool:
    """Return whether a file is a recording with ground truth, as a run writes it."""
    try:
        with open_npz(path) as archive:
            return 'clean_depth' in archive.headers
    except InputError:
        return False


def write_results(out: Path, table: dict[str, Any], html: str) -> None:
    """Write ``truth.yaml`` and ``truth.html``, both or none."""
    text = yaml.safe_dump(table, sort_keys=False, allow_unicode=True)
    atomic.write_texts(out, dict(zip(FILES, (text, html), strict=True)))
