"""The recordings of a run, and the files that it writes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

from flexx2_sim_ros import atomic
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.recording import RecordingReader
from flexx2_sim_ros.recording.opening import BAG_FILES, find_recordings, is_bag
from flexx2_sim_ros.recording.reader import uptime_of
from flexx2_sim_ros.truth.requests import TruthRequest
import numpy as np
import yaml

FILES = 'truth.yaml', 'truth.html'
_LONGEST = 24 * 3600.0  # seconds: recordings farther apart are not of one session


@dataclass(frozen=True)
class TruthSource:
    """
    One of the recordings, and the `target` file to write it to with ground truth.

    `uptime` is as in `uptimes`; `notes` is what a person should know of the file, as in
    `Recording`.
    """

    path: Path
    target: Path
    uptime: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def row(self, verdict: str, reasons: Sequence[str], **more: Any) -> dict[str, Any]:
        """Return the row of the recording in ``truth.yaml``."""
        return {
            'name': self.target.name,
            'source': str(self.path),
            'verdict': verdict,
            'reasons': list(reasons),
            **({'notes': list(self.notes)} if self.notes else {}),
            **more,
        }


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


def uptimes(
    readers: Sequence[RecordingReader], first: float | None = None
) -> list[np.ndarray | None]:
    """
    Return the time since power-on of each recording, (T,) seconds, from stamps of one clock.

    A bag does not say when the camera was switched on. An error that decays with time looks the
    same from any moment on, but for its size. So without `first`, the seconds from power-on to the
    first frame of the earliest recording, the time is counted from that frame.

    The recordings are of one session: the camera was not switched off in between. Where one of
    them says its times itself, such times are returned. None where nothing is known: the stamps
    are not of one clock and one session. Raises `InputError` where `first` cannot be used.
    """
    if not readers:
        return []
    own = [uptime_of(reader) for reader in readers]
    if any(one is not None for one in own):
        if first is not None:
            raise InputError('--uptime: must not be given where recordings have the key uptime')
        return own
    stamps = sorted((reader.stamp_ns for reader in readers), key=lambda stamp: int(stamp[0]))
    begin = stamps[0][0]
    apart = all(one[-1] < other[0] for one, other in zip(stamps, stamps[1:], strict=False))
    together = (stamps[-1][-1] - begin) / 1e9 < _LONGEST
    if not (apart and together):
        if first is not None:
            raise InputError(
                '--uptime: must be given for recordings of one session and one clock, got '
                + ('more than a day between two of them' if apart else 'stamps that overlap')
            )
        return own
    return [(reader.stamp_ns - begin) / 1e9 + (first or 0.0) for reader in readers]


def sources_of(request: TruthRequest, inputs: Sequence[Path]) -> list[TruthSource]:
    """
    Return the recordings of a request, after a check that their ground truth can be written.

    A file of a folder that cannot be read stays: the run refuses it, and goes on. Raises
    `InputError` where a folder has none, one that was named cannot be read, its file cannot be
    written, or a file that is read, one of `inputs` too, would be overwritten.
    """
    paths = recordings_of(request.recordings)
    targets = [request.out / name for name in names_of(paths)]
    atomic.check_outputs('--out', request.out, FILES)
    results = [request.out / name for name in FILES]
    _check_kept(request.out, [*results, *targets], [*paths, *request.recordings, *inputs])
    readers = list(_readers(request, paths))
    for target, reader in zip(targets, readers, strict=True):
        if reader is not None and target.exists() and not has_truth(target):
            raise InputError(
                f'--out: must be a folder without other recordings, got {shown_path(request.out)}:'
                f' {target.name} there has no clean_depth and would be replaced'
            )
    known = iter(uptimes([one for one in readers if one is not None], request.uptime))
    return [
        TruthSource(path, target)
        if reader is None
        else TruthSource(path, target, next(known), tuple(dict.fromkeys(reader.notes)))
        for path, target, reader in zip(paths, targets, readers, strict=True)
    ]


def _readers(request: TruthRequest, paths: Sequence[Path]) -> Iterator[RecordingReader | None]:
    for path in paths:
        try:
            yield request.opened(path)
        except InputError:
            if path in request.recordings:
                raise
            yield None


def reason_of(error: InputError, path: Path) -> str:
    """Return why a recording cannot be used, without its name, for its row in ``truth.yaml``."""
    return str(error).removeprefix(f'{path}: ')


def _check_kept(out: Path, written: Sequence[Path], inputs: Sequence[Path]) -> None:
    # No input is overwritten, whichever of the inputs a file is written for.
    read = {_identity(path): path for path in inputs}
    for path in written:
        found = _identity(path)
        if found is not None and found in read:
            raise InputError(
                f'--out: must be a folder where no input is overwritten, got {shown_path(out)}: '
                f'{path.name} there is the input {shown_path(read[found])}'
            )


def _identity(path: Path) -> tuple[int, int] | None:
    # The same for all paths to one file, through links as well; None where there is no file.
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
