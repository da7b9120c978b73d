"""Arrays of an untrusted HDF5 file, as `flexx2_sim_ros.npz_arrays` has those of .npz."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, one_sentence, shown_path, unquoted
from flexx2_sim_ros.limits import file_limit_bytes
from flexx2_sim_ros.npz_arrays import LIMIT, LIMIT_MB
import numpy as np

SUFFIXES = ('.h5', '.hdf5')
_MOST = 100_000  # arrays; assumed


class Hdf5File:
    """
    An open HDF5 file, made by `open_hdf5`; ``headers`` is by path, as ``data/demo_0/obs/depth``.

    Only numbers that lie in the file itself are read: no objects, no links.
    """

    def __init__(self, path: Path, file: Any) -> None:
        """Look what there is, reading nothing."""
        self._path, self._read = path, 0
        self.headers: dict[str, Any] = {}

        def visit(name: str, found: Any) -> bool | None:
            if hasattr(found, 'dtype') and found.dtype.kind in 'fiub':
                self.headers[name] = found
            return True if len(self.headers) > _MOST else None

        if file.visititems(visit):
            raise InputError(f'{shown_path(path)}: must have at most {_MOST} arrays, got more')

    @property
    def usual(self) -> list[str]:
        """Return the keys that are read without being asked for: those in no group."""
        return [name for name in self.headers if '/' not in name]

    def read(self, key: str) -> np.ndarray:
        """Return an array; images (T, H, W, 1) as (T, H, W)."""
        found, where = self.headers[key], f'{shown_path(self._path)}: {unquoted(key)}'
        if found.is_virtual or found.external:
            raise InputError(f'{where}: must lie in the file, got a link to another one')
        self._read += found.size * found.dtype.itemsize
        most = file_limit_bytes(LIMIT, LIMIT_MB, self._path.stat().st_size)
        if self._read > most:
            raise InputError(
                f'{where}: must not decompress to more than {most >> 20} MB with the others, got '
                f'{self._read >> 20} MB; the environment variable {LIMIT} raises the limit'
            )
        array = np.asarray(found[()])
        return array[..., 0] if array.ndim == 4 and array.shape[3] == 1 else array


@contextmanager
def open_hdf5(path: Path) -> Iterator[Hdf5File]:
    """Open an HDF5 file; needs h5py. Raises InputError when it cannot be read."""
    import h5py

    with one_sentence(f'{shown_path(path)}: cannot be read'), h5py.File(path, 'r') as file:
        yield Hdf5File(path, file)
