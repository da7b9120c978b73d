"""Recordings in ``.npz`` and HDF5 files of other programs: other keys, units and shapes."""

from collections.abc import Iterator
from pathlib import Path

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.npz_arrays import NpzFile, open_npz
from flexx2_sim_ros.recording.corrections import Given, in_metres
from flexx2_sim_ros.recording.hdf5 import open_hdf5, SUFFIXES
from flexx2_sim_ros.recording.reader import Content, Layout, RecordingReader, STACKS
import numpy as np

ARCHIVES = ('.npz', *SUFFIXES)


class OtherArchive(RecordingReader):
    """
    An ``.npz`` or HDF5 file of another program, held in memory; nothing in it is unpickled.

    Of `given` the keys, unit (else millimetres for whole numbers, and metres) and calibration are
    used. Raises InputError when the file cannot be read, lacks a key, or is not a recording with
    these options.
    """

    def __init__(self, path: Path, given: Given) -> None:
        """Read the file."""
        with open_npz(path) if path.suffix == '.npz' else open_hdf5(path) as archive:
            for ours, theirs in given.keys.items():
                if theirs not in archive.headers:
                    raise InputError(
                        f'--key: must name a key of {path}, got {unquoted(f"{ours}={theirs}")}; '
                        f'the file has {unquoted(", ".join(archive.headers) or "nothing")}'
                    )
            names = {
                key: key
                for key in (archive.headers if isinstance(archive, NpzFile) else archive.usual)
                if key not in given.keys and key not in given.keys.values()
            }
            arrays = {key: archive.read(name) for key, name in {**names, **given.keys}.items()}
        depth = _metres(path, arrays, given.unit)
        lens = given.lens
        notes: list[str] = []
        if given.rectified is not None and lens is None:
            raise InputError(
                '--rectified: must come with --calibration for an .npz or HDF5 file, got none'
            )
        if lens is not None:
            camera = lens.intrinsics(depth.shape[1:], bool(given.rectified), notes)
            arrays |= {'K': camera.matrix, 'distortion': np.array(camera.distortion)}
        self._stacks = {'depth': depth}
        for key in STACKS:
            if key in arrays and arrays[key].ndim == 3 and arrays[key].dtype.kind in 'fiu':
                self._stacks[key] = arrays.pop(key)
        layouts = {
            key: Layout(stack.dtype, stack.shape[1:]) for key, stack in self._stacks.items()
        }
        super().__init__(path, None, Content(layouts, arrays, notes, frames=len(depth)))
        for key, stack in self._stacks.items():
            if stack.shape != self.shape:
                raise InputError(
                    f'{path}: {key}: must have shape {self.shape}, one image for each of stamp, '
                    f'got {stack.shape}'
                )

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        return iter(self._stacks[key])


def _metres(path: Path, arrays: dict[str, np.ndarray], unit: float | None) -> np.ndarray:
    found = arrays.pop('depth', None)
    if found is None:
        raise InputError(
            f'{path}: depth: must be in the file, or named with --key depth=NAME, got '
            f'{shown(", ".join(arrays))}'
        )
    if found.dtype.kind not in 'fiu' or found.ndim not in (2, 3) or not found.size:
        raise InputError(
            f'{path}: depth: must be numbers (H, W) or (T, H, W), got {found.dtype} of shape '
            f'{found.shape}'
        )
    return in_metres(found if found.ndim == 3 else found[None], unit)
