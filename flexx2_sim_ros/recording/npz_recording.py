"""Recordings in NumPy archives, frame by frame."""

from collections.abc import Iterator
import math
from pathlib import Path
from typing import IO
import zipfile

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.npz import (
    array_keys,
    check_end,
    read_array,
    UNREADABLE,
    unreadable,
)
from flexx2_sim_ros.recording.recordings import Content, Layout, RecordingReader, STACKS
import numpy as np


class NpzRecording(RecordingReader):
    """
    An ``.npz`` recording.

    Parameters
    ----------
    path : pathlib.Path
        The file; nothing in it is unpickled.

    Raises
    ------
    InputError
        When the file cannot be read, or is not a recording.

    """

    def __init__(self, path: Path) -> None:
        """Read all but the stacks."""
        # Stacks whose frames do not lie one after the other.
        self._loaded: dict[str, np.ndarray] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        if not path.is_file():
            raise InputError(f'{path}: not a file, wanted an .npz archive')
        try:
            content = self._read(path)
        except UNREADABLE as error:
            raise unreadable(path, error) from error
        if 'depth' not in content.layouts or 0 in self._shapes['depth']:
            raise InputError(f'{path}: depth: {self._found_depth(content)}, wanted (T, H, W) '
                             'float32, not empty')
        depth = content.layouts['depth']
        if depth.dtype != np.float32:
            content.notes.append(f'{path}: depth: {depth.dtype} is rounded to float32')
            content.layouts['depth'] = Layout(np.dtype(np.float32), depth.shape)
        super().__init__(path, None, content)
        for key, shape in self._shapes.items():
            if shape != self.shape:
                raise InputError(f'{path}: {key}: found shape {shape}, wanted {self.shape}, one '
                                 'image for each of stamp')

    def _read(self, path: Path) -> Content:
        content = Content({}, {})
        with zipfile.ZipFile(path) as archive:
            for key in array_keys(archive):
                if key in STACKS:
                    with archive.open(f'{key}.npy') as entry:
                        shape, fortran, dtype = _header(entry)
                        start = entry.tell()
                    if len(shape) == 3 and dtype.kind in 'fiu':
                        size = archive.getinfo(f'{key}.npy').file_size - start
                        if size != math.prod(shape) * dtype.itemsize:
                            raise ValueError(f'{key}: has {size} bytes, shape {shape} wants '
                                             f'{math.prod(shape) * dtype.itemsize}')
                        self._shapes[key] = shape
                        content.layouts[key] = Layout(dtype.newbyteorder('='), shape[1:])
                        if fortran:
                            self._loaded[key] = read_array(archive, key)
                        continue
                content.arrays[key] = read_array(archive, key)
        return content

    def _found_depth(self, content: Content) -> str:
        if 'depth' in self._shapes:
            return f'found shape {self._shapes["depth"]}'
        if 'depth' in content.arrays:
            found = content.arrays['depth']
            return f'found shape {found.shape} of {found.dtype}'
        return f'not in the file, which has {", ".join(content.arrays) or "nothing"}'

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        layout = self.layouts[key]
        if key in self._loaded:
            yield from self._loaded[key].astype(layout.dtype)
            return
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(f'{key}.npy') as entry:
                (count, *shape), _, dtype = _header(entry)
                size = dtype.itemsize * shape[0] * shape[1]
                for left in reversed(range(count)):
                    raw = entry.read(size)
                    if len(raw) < size:
                        raise EOFError('ends too early')
                    if not left:
                        check_end(entry, key)
                    yield np.frombuffer(raw, dtype).reshape(shape).astype(layout.dtype, copy=False)
        except UNREADABLE as error:
            raise unreadable(self.path, error) from error


def _header(entry: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(entry)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(entry)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(entry)
    raise ValueError(f'array format {version}')
