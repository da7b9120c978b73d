"""Recordings in NumPy archives, frame by frame."""

from collections.abc import Iterator
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.given import in_metres
from flexx2_sim_ros.recording.reader import Content, Layout, RecordingReader, STACKS
import numpy as np


class NpzRecording(RecordingReader):
    """
    An ``.npz`` recording.

    Parameters
    ----------
    path : pathlib.Path
        The file; nothing in it is unpickled.
    profile : Profile, optional
        As for `open_recording`.

    Raises
    ------
    InputError
        When the file cannot be read, or is not a recording.

    """

    def __init__(self, path: Path, profile: Profile | None = None) -> None:
        """Read everything except the stacks."""
        # Stacks whose frames are not contiguous.
        self._loaded: dict[str, np.ndarray] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._whole = False  # Whether depth is whole millimetres in the file.
        content = self._read(path)
        if 'depth' not in content.layouts or 0 in self._shapes['depth']:
            raise InputError(
                f'{path}: depth: must be (T, H, W) float32, not empty, '
                f'got {self._found_depth(content)}'
            )
        content.frames = self._shapes['depth'][0]
        depth = content.layouts['depth']
        if depth.dtype != np.float32:
            self._whole = depth.dtype.kind in 'iu'
            how = 'taken for millimetres, 0 for invalid' if self._whole else 'rounded to float32'
            content.notes.append(f'{path}: depth: {depth.dtype} is {how}')
            content.layouts['depth'] = Layout(np.dtype(np.float32), depth.shape)
        super().__init__(path, None, content, profile)
        for key, shape in self._shapes.items():
            if shape != self.shape:
                raise InputError(
                    f'{path}: {key}: must have shape {self.shape}, one image for each of '
                    f'stamp, got {shape}'
                )

    def _read(self, path: Path) -> Content:
        content = Content({}, {})
        with open_npz(path) as archive:
            for key, header in archive.headers.items():
                if key in STACKS and len(header.shape) == 3 and header.dtype.kind in 'fiu':
                    self._shapes[key] = header.shape
                    content.layouts[key] = Layout(header.dtype.newbyteorder('='), header.shape[1:])
                    if header.fortran:
                        self._loaded[key] = archive.read(key)
                elif key == 'depth' and len(header.shape) == 2 and header.dtype.kind in 'fiu':
                    self._loaded[key] = archive.read(key)[None]  # A single frame.
                    self._shapes[key] = (1, *header.shape)
                    content.layouts[key] = Layout(header.dtype.newbyteorder('='), header.shape)
                else:
                    content.arrays[key] = archive.read(key)
        return content

    def _found_depth(self, content: Content) -> str:
        if 'depth' in self._shapes:
            return f'shape {self._shapes["depth"]}'
        if 'depth' in content.arrays:
            found = content.arrays['depth']
            return f'shape {found.shape} of {found.dtype}'
        return f'none; the file has {", ".join(content.arrays) or "nothing"}'

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        dtype = self.layouts[key].dtype
        for image in self._stored(key):
            if key == 'depth' and self._whole:
                yield in_metres(image)
            else:
                yield image.astype(dtype, copy=False)

    def _stored(self, key: str) -> Iterator[np.ndarray]:
        if key in self._loaded:
            yield from self._loaded[key]
            return
        with open_npz(self.path) as archive:
            header = archive.headers.get(key)
            if header is None or header.shape != self._shapes[key]:
                raise InputError(f'{self.path}: {key}: has changed since the file was opened')
            yield from archive.images(key)
