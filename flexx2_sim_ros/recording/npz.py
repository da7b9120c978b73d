"""Read and write recordings as NumPy archives."""

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any
import zipfile

from flexx2_sim_ros.atomic import checked_target, named, whole
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.recording.stamps import read_stamps
from flexx2_sim_ros.recording.tidying import factor_of
import numpy as np


@dataclass(frozen=True)
class Scene:
    """
    A scene: its clean depth and the other arrays of its file.

    Attributes
    ----------
    clean_depth : numpy.ndarray
        (H, W) or (T, H, W), metres, NaN where there is no return.
    K : numpy.ndarray
        (3, 3) float64 camera matrix.
    reflectivity : numpy.ndarray or None
        (H, W) or (T, H, W) in 0..1.
    stamp : numpy.ndarray or None
        (T,) float64 seconds.
    stamp_ns : numpy.ndarray or None
        (T,) int64 nanoseconds, if the file has them: `stamp` cannot hold those of a clock exactly.
    extra : dict
        All other arrays of the file.
    notes : tuple of str
        Units that were converted.

    """

    clean_depth: np.ndarray
    K: np.ndarray  # noqa: N815
    reflectivity: np.ndarray | None = None
    stamp: np.ndarray | None = None
    stamp_ns: np.ndarray | None = None
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def load_scene(path: str | Path) -> Scene:
    """
    Read a scene (or a recording, as the scene it shows).

    Parameters
    ----------
    path : str or pathlib.Path
        An ``.npz`` file; nothing in it is unpickled.

    Raises
    ------
    InputError
        When the file cannot be read whole, or a key is missing or of the wrong shape or dtype;
        the message names the file and the key.

    """
    arrays = _read(Path(path))
    for key in ('clean_depth', 'K'):
        if key not in arrays:
            found = ', '.join(arrays) or 'nothing'
            raise InputError(
                f'{path}: {key}: must be in the file, with clean_depth (H, W) or (T, H, W) '
                f'and K (3, 3), got {found}'
            )
    clean = _numbers(path, arrays, 'clean_depth')
    if clean.ndim not in (2, 3) or 0 in clean.shape:
        raise InputError(
            f'{path}: clean_depth: must have shape (H, W) or (T, H, W), not empty, got '
            f'{clean.shape}'
        )
    matrix = _numbers(path, arrays, 'K')
    if matrix.shape != (3, 3):
        raise InputError(f'{path}: K: must have shape (3, 3), got {matrix.shape}')
    reflectivity = _numbers(path, arrays, 'reflectivity') if 'reflectivity' in arrays else None
    if reflectivity is not None and reflectivity.shape not in (clean.shape, clean.shape[-2:]):
        raise InputError(
            f'{path}: reflectivity: must have the size of clean_depth, {clean.shape}, got '
            f'{reflectivity.shape}'
        )
    stamp, stamp_ns = (
        read_stamps(path, arrays) if {'stamp', 'stamp_ns'} & arrays.keys() else (None, None)
    )
    notes: list[str] = []
    if clean.dtype.kind == 'f':
        clean = _converted('clean_depth', clean, path, notes)
    if reflectivity is not None:
        reflectivity = _converted('reflectivity', reflectivity, path, notes)
    known = {'clean_depth', 'K', 'reflectivity', 'stamp', 'stamp_ns'}
    return Scene(
        clean,
        matrix.astype(np.float64),
        reflectivity,
        stamp,
        stamp_ns if 'stamp_ns' in arrays else None,
        {key: value for key, value in arrays.items() if key not in known},
        tuple(notes),
    )


def _converted(key: str, image: np.ndarray, path: str | Path, notes: list[str]) -> np.ndarray:
    factor, note = factor_of(key, image, str(path))
    if not note:
        return image
    notes.append(note)
    return np.asarray(image.astype(np.float32) * np.float32(factor))


def _read(path: Path) -> dict[str, np.ndarray]:
    with open_npz(path) as archive:
        return {key: archive.read(key) for key in archive.headers}


def _numbers(path: str | Path, arrays: dict[str, np.ndarray], key: str) -> np.ndarray:
    if arrays[key].dtype.kind not in 'fiu':
        raise InputError(f'{path}: {key}: must be numbers, got dtype {arrays[key].dtype}')
    return arrays[key]


class RecordingWriter:
    """
    Write a recording frame by frame, in bounded memory.

    The file gets its name when the ``with`` block ends without an error; otherwise there is none.

    Parameters
    ----------
    path : str or pathlib.Path
        Where to write; replaced if it exists.
    frames, height, width : int
        Shape of ``depth``.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with RecordingWriter(f'{folder}/r.npz', 2, 4, 5) as writer:
    ...         writer.add_depth(np.ones((2, 4, 5), np.float32))
    ...         writer.add_array('K', np.eye(3))
    ...     sorted(np.load(f'{folder}/r.npz', allow_pickle=False).files)
    ['K', 'depth']

    """

    def __init__(self, path: str | Path, frames: int, height: int, width: int) -> None:
        """Check the path; the file is made later."""
        checked_target(path)
        self._path = Path(path)
        self._shape = (frames, height, width)
        self._left = frames
        self._closing = ExitStack()
        self._depth: Any = None

    def __enter__(self) -> 'RecordingWriter':
        """Open a scratch file beside the target and start ``depth``."""
        with ExitStack() as opening:
            part = opening.enter_context(whole(self._path))
            self._archive = opening.enter_context(zipfile.ZipFile(part, 'w'))
            opening.callback(self._end_depth)
            self._depth = self._archive.open('depth.npy', 'w', force_zip64=True)
            header = {'descr': '<f4', 'fortran_order': False, 'shape': self._shape}
            np.lib.format.write_array_header_1_0(self._depth, header)
            self._closing = opening.pop_all()
        return self

    def add_depth(self, frames: np.ndarray) -> None:
        """Append (n, H, W) frames, metres, NaN where invalid."""
        if frames.shape[1:] != self._shape[1:] or len(frames) > self._left:
            raise InputError(
                f'depth: must be at most {(self._left, *self._shape[1:])}, got {frames.shape}'
            )
        with named(self._path):
            self._depth.write(np.ascontiguousarray(frames, dtype='<f4').data)
        self._left -= len(frames)

    def add_array(self, key: str, value: Any) -> None:
        """Add another array; after all depth frames."""
        if self._left:
            raise InputError(f'depth: {self._left} frames are missing before {key!r}')
        self._end_depth()
        with named(self._path), self._archive.open(f'{key}.npy', 'w', force_zip64=True) as entry:
            np.lib.format.write_array(entry, np.asarray(value), allow_pickle=False)

    def add_frames(self, key: str, dtype: np.dtype, frames: Iterable[np.ndarray]) -> None:
        """
        Add another array of depth's shape, frame by frame; after all depth frames.

        It has `dtype`; there must be as many (H, W) `frames` as depth has.
        """
        if self._left:
            raise InputError(f'depth: {self._left} frames are missing before {key!r}')
        self._end_depth()
        with named(self._path), self._archive.open(f'{key}.npy', 'w', force_zip64=True) as entry:
            np.lib.format.write_array_header_1_0(
                entry,
                {
                    'descr': np.lib.format.dtype_to_descr(dtype),
                    'fortran_order': False,
                    'shape': self._shape,
                },
            )
            count = 0
            for frame in frames:
                entry.write(np.ascontiguousarray(frame, dtype).data)
                count += 1
        if count != self._shape[0]:
            raise InputError(f'{key}: must have {self._shape[0]} frames, got {count}')

    def _end_depth(self) -> None:
        if self._depth is not None:
            with named(self._path):
                self._depth.close()
            self._depth = None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Move the file to its place, or remove it after an error."""
        if error is None and self._left:
            error = InputError(f'{self._path}: depth: {self._left} frames are missing')
        with self._closing:  # All that is open, whatever fails.
            if error is not None:
                raise error
