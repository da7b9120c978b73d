"""Arrays of an untrusted ``.npz`` file: checked before they are read, in bounded memory."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
import io
import math
from pathlib import Path
import struct
from tokenize import TokenError
from typing import IO
import zipfile
import zlib

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.limits import file_limit_bytes
import numpy as np

LIMIT = 'FLEXX2_NPZLIMIT_MB'
LIMIT_MB = 512
_BLOCK = 1 << 20
_UNREADABLE = (
    OSError,
    EOFError,
    ArithmeticError,
    LookupError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    TokenError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
_HEADERS = {(1, 0): 2, (2, 0): 4}  # bytes of the header's length, by version
_PLAIN = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}


@dataclass(frozen=True)
class Header:
    """The header of an array in the file; if `fortran`, the first index changes fastest."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype

    @property
    def size(self) -> int:
        """Return the bytes of its content."""
        return math.prod(self.shape) * self.dtype.itemsize


class _NoArrayError(ValueError):
    pass


class NpzFile:
    """
    An open ``.npz`` file, made by `open_npz`; ``headers`` are by key.

    Nothing is unpickled. An array is read only up to the size on which its header and the
    archive's agree.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        """Read and check the headers."""
        self._archive = archive
        _check_sizes(archive)
        self.headers: Mapping[str, Header] = {
            info.filename.removesuffix('.npy'): self._header(info) for info in archive.infolist()
        }

    def _header(self, info: zipfile.ZipInfo) -> Header:
        with self._archive.open(info) as entry:
            return _checked_header(entry, info.filename.removesuffix('.npy'), info.file_size)

    def read(self, key: str) -> np.ndarray:
        """Return an array."""
        with self._archive.open(f'{key}.npy') as entry:
            _read_header(entry, key)
            return _content(entry, key, self.headers[key])

    def images(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over an array's first index, which must change slowest."""
        header = self.headers[key]
        with self._archive.open(f'{key}.npy') as entry:
            _read_header(entry, key)
            for _ in range(header.shape[0]):
                image = np.empty(math.prod(header.shape[1:]), header.dtype)
                _fill(entry, image)
                yield image.reshape(header.shape[1:])


@contextmanager
def open_npz(path: Path) -> Iterator[NpzFile]:
    """
    Open an ``.npz`` file.

    Raises InputError, which names the file, when it is no such file, damaged, pickled, or over the
    limit of decompressed size; also for errors of reading inside the ``with`` block.
    """
    name = shown_path(path)
    try:
        if not path.is_file():
            got = 'a folder' if path.is_dir() else 'no file'
            raise InputError(f'{name}: must be an .npz archive, got {got}')
        with zipfile.ZipFile(path) as archive:
            yield NpzFile(archive)
    except InputError:
        raise
    except _NoArrayError as error:
        raise InputError(
            f'{name}: {_short(error)}: must be an array, got another kind of file'
        ) from error
    except _UNREADABLE as error:
        raise InputError(
            f'{name}: cannot be read as an .npz archive of plain arrays (damaged, '
            f'cut off, or pickled): {_short(error)}'
        ) from error


def decode_npy(content: bytes, where: str) -> np.ndarray:
    """
    Return the array of an ``.npy`` file; nothing in it is unpickled.

    ``where`` is what to call it in errors. Raises InputError when it is no such file, damaged or
    pickled.
    """
    entry = io.BytesIO(content)
    try:
        return _content(entry, where, _checked_header(entry, where, len(content)))
    except _UNREADABLE as error:
        raise InputError(
            f'{where}: cannot be read as a plain array (damaged, cut off, or pickled): '
            f'{_short(error)}'
        ) from error


def _check_sizes(archive: zipfile.ZipFile) -> None:
    total = sum(info.file_size for info in archive.infolist())
    packed = Path(str(archive.filename)).stat().st_size
    most = file_limit_bytes(LIMIT, LIMIT_MB, packed)
    if total > most:
        raise InputError(
            f'{shown_path(str(archive.filename))}: must not decompress to more than '
            f'{most / 2**20:.0f} MB, got {total / 2**20:.0f} MB; the environment variable {LIMIT} '
            'raises the limit'
        )
    for info in archive.infolist():
        if not info.filename.endswith('.npy'):
            raise _NoArrayError(info.filename)
        if info.compress_type not in _PLAIN:
            raise ValueError(f'{_short(info.filename)} is compressed, but not by deflate')


def _checked_header(entry: IO[bytes], key: str, size: int) -> Header:
    # The header must match `size`, the bytes of the file.
    header = _read_header(entry, key)
    left = size - entry.tell()
    if header.size != left:
        raise ValueError(
            f'{key} has {left} bytes, must have {header.size} for its shape {header.shape}'
        )
    return header


def _read_header(entry: IO[bytes], key: str) -> Header:
    try:
        version = np.lib.format.read_magic(entry)
    except ValueError as error:
        raise _NoArrayError(key) from error
    if version not in _HEADERS:
        raise ValueError(f'array format {version}')
    length = entry.read(_HEADERS[version])
    shape, fortran, dtype = _parsed(version, length + entry.read(int.from_bytes(length, 'little')))
    if not all(type(n) is int and 0 <= n < 2**62 for n in shape):
        raise ValueError(f'an array has the shape {_short(shape)}')
    if dtype.hasobject:
        raise ValueError('an array holds objects, which are pickled')
    return Header(shape, fortran, dtype)


@lru_cache(maxsize=512)
def _parsed(version: tuple[int, int], header: bytes) -> tuple[tuple[int, ...], bool, np.dtype]:
    # The recordings of a campaign have a few headers, and a diagnosis reads them often.
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(io.BytesIO(header))
    return np.lib.format.read_array_header_2_0(io.BytesIO(header))


def _content(entry: IO[bytes], key: str, header: Header) -> np.ndarray:
    # The data after the header.
    array = np.empty(math.prod(header.shape), header.dtype)
    if header.size:
        _fill(entry, array)
    if header.dtype.kind == 'U':
        _check_text(key, array)
    return array.reshape(header.shape, order='F' if header.fortran else 'C')


def _fill(entry: IO[bytes], array: np.ndarray) -> None:
    raw = array.view(np.uint8).data
    place = 0
    while place < len(raw):
        block = entry.read(min(_BLOCK, len(raw) - place))
        if not block:
            raise EOFError('ends too early')
        raw[place : place + len(block)] = block
        place += len(block)


def _check_text(key: str, array: np.ndarray) -> None:
    points = array.astype(array.dtype.newbyteorder('=')).view(np.uint32)
    if ((points > 0x10FFFF) | ((points >= 0xD800) & (points < 0xE000))).any():
        raise ValueError(f'{key} is a text with characters that are none')


def _short(value: object) -> str:
    text = str(value).encode('unicode_escape').decode()
    return text if len(text) <= 80 else f'{text[:77]}...'
