"""Recordings in PNG or TIFF files: one image a frame, with a calibration file."""

from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime, UTC
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.png import check_gray, read_gray, TIFFS
from flexx2_sim_ros.recording.calibration import read_calibration
from flexx2_sim_ros.recording.corrections import Given, in_metres
from flexx2_sim_ros.recording.opening import has_bag_files
from flexx2_sim_ros.recording.reader import Content, Layout, RecordingReader
import numpy as np

MASK = 'mask.png'
_DEPTH = 'depth'
_DEPTH_BITS = (16, 32)
_GRAYS = ('gray', 'ir', 'infra', 'amplitude')
_OTHERS = ('.exr', '.npy', '.pgm', '.raw', '.jpg', '.jpeg', '.pcd', '.ply')
_SUFFIXES = ('.png', *TIFFS)
_YAML = ('.yaml', '.yml')
_STAMP = re.compile(r'(\d+)(?:\.(\d{1,9}))?$')
# 2026-11-27_10-20-30.250: the fraction after a point, or of whole milli- to nanoseconds.
_CALENDAR = re.compile(
    r'(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_T. ]?(\d\d)[-_.:]?(\d\d)[-_.:]?(\d\d)'
    r'(?:[.,](\d{1,9})|[-_](\d{3}|\d{6}|\d{9}))?$'
)
_END_OF_TIME = 2**63  # nanoseconds in int64
_NANOSECONDS = {19: 1, 16: 1_000, 13: 1_000_000}  # of a unit, by the digits since 1970


class ImageRecording(RecordingReader):
    """
    A folder of 16-bit PNG files, or of TIFF files of 16 or 32 bits, or a single one.

    Depth is in the folder or in its folder ``depth``, gray images of the same names in ``gray``,
    ``ir``, ``infra`` or ``amplitude``. Stamps come from the names: seconds with a decimal point,
    or milliseconds, microseconds or nanoseconds since 1970. Without them frames are in the order
    of the names' numbers.

    Of `given` the calibration (else the folder's only YAML file) and unit (else millimetres, and
    metres of floating-point numbers) are used. ``view`` is the only depth image of the folder to
    read. Raises InputError when there are no such images, one of them is of another kind or size,
    or there is no calibration for them.
    """

    def __init__(self, path: Path, given: Given, view: Path | None = None) -> None:
        """Check all images, reading no pixels."""
        self._unit = given.unit
        root = path if path.is_dir() else path.parent
        one = path if path.is_file() else view
        files, stamps = _in_order(_depth_files(path) if one is None else [one])
        if not files:
            raise InputError(
                f'{shown_path(path)}: must be a PNG or TIFF image or a folder of them, got none'
            )
        size = _common_size(files, _DEPTH_BITS)
        lens = given.lens or read_calibration(_only_yaml(root))
        notes: list[str] = []
        camera = lens.intrinsics(size, bool(given.rectified), notes)
        content = Content({}, {'K': camera.matrix}, notes, frames=len(files))
        if any(camera.distortion):
            content.arrays['distortion'] = np.array(camera.distortion)
        if stamps is not None:
            content.arrays['stamp_ns'] = np.array(stamps, np.int64)
        self._files = {'depth': files}
        content.layouts['depth'] = Layout(np.dtype(np.float32), size)
        self._add_gray(path, root, content)
        super().__init__(path, None, content)

    def _add_gray(self, path: Path, root: Path, content: Content) -> None:
        folders = [root / name for name in _GRAYS if path.is_dir() and (root / name).is_dir()]
        if not folders:
            return
        files = [folders[0] / file.name for file in self._files['depth']]
        missing = sum(not file.is_file() for file in files)
        if missing:
            content.notes.append(
                f'{path}: amplitude: left out: {missing} of {len(files)} depth images have none '
                f'of their name in {folders[0].name}'
            )
            return
        size = _common_size([self._files['depth'][0], *files], (8, 16))
        self._files['amplitude'] = files
        bits = read_gray(files[0], (8, 16)).dtype
        content.layouts['amplitude'] = Layout(bits, size)

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        layout = self.layouts[key]
        for file in self._files[key]:
            image = read_gray(
                file, _DEPTH_BITS if key == 'depth' else (8 * layout.dtype.itemsize,)
            )
            if image.shape != layout.shape:
                raise InputError(f'{shown_path(file)}: has changed since it was opened')
            if key == 'depth':
                image = in_metres(image, self._unit)
            yield image


def has_images(path: Path) -> bool:
    """Say whether a path is an image or a folder of them, and no bag beside which one lies."""
    if path.suffix.lower() in _SUFFIXES:
        return True
    if path.is_dir() and has_bag_files(path):
        return False
    found = path.is_dir() and bool(_depth_files(path))
    if not found:
        _refuse_others(path)
    return found


def _refuse_others(path: Path) -> None:
    folders = (path, path / _DEPTH) if path.is_dir() else ()
    files = [path, *(file for folder in folders if folder.is_dir() for file in folder.iterdir())]
    other = next((file for file in files if file.suffix.lower() in _OTHERS), None)
    if other is not None:
        raise InputError(
            f'{shown_path(other)}: must be a gray PNG or TIFF of 16 bits, or an .npz file with '
            f'depth (T, H, W) and K, got a {other.suffix} file: save the images '
            'in one of these forms'
        )


def mask_beside(path: Path) -> Path | None:
    """Return the mask in a folder of images, or None."""
    mask = path / MASK
    return mask if path.is_dir() and mask.is_file() else None


def _images(folder: Path) -> list[Path]:
    # Of one kind, PNG where there are both.
    found = [
        file
        for file in (folder.iterdir() if folder.is_dir() else ())
        if file.suffix.lower() in _SUFFIXES
        if file.name != MASK and not file.name.startswith('.')
    ]
    return [file for file in found if file.suffix.lower() == '.png'] or found


def views(folder: Path) -> dict[str, tuple[Path, Path | None]]:
    """
    Return the views in a folder: by name, what `ImageRecording` takes for each.

    They are its depth images, or else its folders that have some.
    """
    if own := _depth_files(folder):
        return {file.stem: (folder, file) for file in sorted(own)}
    inside = sorted(folder.iterdir()) if folder.is_dir() else []
    return {one.name: (one, None) for one in inside if _depth_files(one)}


def _depth_files(folder: Path) -> list[Path]:
    return _images(folder) or _images(folder / _DEPTH)


def _in_order(files: list[Path]) -> tuple[list[Path], list[int] | None]:
    stamps = [_stamp(file) for file in files]
    known = [stamp for stamp in stamps if stamp is not None]
    if len(known) < len(files):
        return sorted(files, key=_natural), None
    both = sorted(zip(known, files, strict=True))
    return [file for _, file in both], [stamp for stamp, _ in both]


def _stamp(file: Path) -> int | None:
    # Nanoseconds, or None for a name that has only a frame's number, or none.
    if (date := _CALENDAR.search(file.stem)) is not None:
        year, month, day, hour, minute, second = map(int, date.groups()[:6])
        with suppress(ValueError):  # A month 13: another number.
            time = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
            nanoseconds = int((date[7] or date[8] or '').ljust(9, '0'))
            return int(time.timestamp()) * 1_000_000_000 + nanoseconds
    found = _STAMP.search(file.stem)
    if found is None:
        return None
    whole, fraction = found.groups()
    if fraction is not None:
        stamp = int(whole[-10:]) * 1_000_000_000 + int(fraction.ljust(9, '0'))
    elif len(whole) in _NANOSECONDS:
        stamp = int(whole) * _NANOSECONDS[len(whole)]
    else:
        return None
    return stamp if stamp < _END_OF_TIME else None


def _natural(file: Path) -> list[tuple[str, int]]:
    # frame2 comes before frame10.
    parts = re.findall(r'(\D*)(\d{0,18})', file.stem)
    return [(text, int(digits or 0)) for text, digits in parts]


def _common_size(files: list[Path], bits: tuple[int, ...]) -> tuple[int, int]:
    size = check_gray(files[0], bits if files[0].parent == files[-1].parent else (8, 16))
    for file in files[1:]:
        other = check_gray(file, bits)
        if other != size:
            raise InputError(
                f'{shown_path(file)}: must be {size[1]} x {size[0]} pixels as {files[0].name}, '
                f'got {other[1]} x {other[0]}'
            )
    return size


def _only_yaml(folder: Path) -> Path:
    found = sorted(file for file in folder.iterdir() if file.suffix in _YAML)
    if len(found) != 1:
        names = shown(', '.join(file.name for file in found)) if found else 'none'
        raise InputError(
            f'--calibration: must be a YAML file of camera_calibration, or the only one in '
            f'{shown_path(folder)}, got {names} (--intrinsics says the lens in numbers)'
        )
    return found[0]
