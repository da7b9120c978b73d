"""
Compressed bags, decompressed within a limit: chunks, messages, and whole files.

A few kilobytes can expand to gigabytes. rosbags does not limit this, so importing this module
replaces its decompressors: those of chunks in the tables of MCAP and of ROS 1, and those of
compressed messages and files (`compression_mode` of ``metadata.yaml``) in the module that reads
bags.
"""

from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
import sys
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol, TypeVar

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.limits import file_limit_bytes, limit_bytes
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag1.reader import decompressors
from rosbags.rosbag2 import reader
from rosbags.rosbag2.storage_mcap import decompress, DECOMPRESSORS

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor, ZstdFile
else:
    from backports.zstd import ZstdDecompressor, ZstdFile

__all__ = ['ChunkLimitError', 'FILE_LIMIT', 'LIMIT', 'decompress', 'limited', 'naming']

LIMIT = 'FLEXX2_CHUNK_LIMIT_MB'
# Writers close a chunk after 1 to 8 MB, or after one larger message.
_LIMIT_MB = 128
FILE_LIMIT = 'FLEXX2_BAG_LIMIT_MB'
_FILE_LIMIT_MB = 512


class _Message(Protocol):
    """A message of a bag."""

    @property
    def data(self) -> bytes: ...


_Sized = TypeVar('_Sized', bound=_Message)


class ChunkLimitError(InputError):
    """A chunk, message or file expands to more than the limit."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the file in the error of what is over the limit, as an `InputError`."""
    try:
        yield
    except ChunkLimitError as error:
        raise InputError(f'{path}: {error}') from error


def _expanded(new_decompressor: Callable[[], Any], data: bytes, most: int) -> tuple[bytes, bool]:
    # All frames of `data` up to one byte more than `most`, and whether they are whole.
    content = b''
    while data and len(content) <= most:
        decompressor = new_decompressor()
        content += decompressor.decompress(data, max_length=most + 1 - len(content))
        if not decompressor.eof:
            return content, False
        data = decompressor.unused_data or b''
    return content, True


def _limit_error(what: str, limit: int, got: str, variable: str) -> ChunkLimitError:
    return ChunkLimitError(
        f'{what} must not decompress to more than {limit >> 20} MB, got {got}; the environment '
        f'variable {variable} raises the limit'
    )


def _within_limit(new_decompressor: Callable[[], Any]) -> Callable[[bytes, int], bytes]:
    def expand(data: bytes, size: int) -> bytes:
        # `size` is what the chunk declares. The caller compares it with what comes out, so one
        # byte more is enough.
        limit = limit_bytes(LIMIT, _LIMIT_MB)
        content, _ = _expanded(new_decompressor, data, min(size, limit))
        # A damaged file may declare a large size too, but does not contain it.
        if len(content) > limit:
            raise _limit_error('a chunk', limit, f'{size >> 20} MB', LIMIT)
        return content

    return expand


class _LimitedFile(ZstdFile):
    """A compressed file that stops at a limit."""

    def __init__(self, file: BinaryIO, mode: str) -> None:
        packed = file.seek(0, 2)
        file.seek(0)
        self._most = file_limit_bytes(FILE_LIMIT, _FILE_LIMIT_MB, packed)
        super().__init__(file, mode)  # type: ignore[call-overload]

    def read(self, size: int | None = -1) -> bytes:
        """Read up to `size` bytes."""
        content = super().read(size)
        if self.tell() > self._most:
            raise _limit_error('a file of the bag', self._most, 'more', FILE_LIMIT)
        return content


def _whole(new_decompressor: Callable[[], Any], what: str) -> Callable[[bytes], bytes]:
    def expand(data: bytes) -> bytes:
        limit = limit_bytes(LIMIT, _LIMIT_MB)
        content, whole = _expanded(new_decompressor, data, limit)
        if len(content) > limit:
            raise _limit_error(what, limit, 'more', LIMIT)
        if not whole:
            raise EOFError(f'{what} ends early')
        return content

    return expand


def limited(messages: Iterable[_Sized], files: Iterable[Path]) -> Iterator[_Sized]:
    """
    Iterate over the messages of a bag, made of `files`, up to the limit of their total size.

    An index can also name one message many times. Raises ChunkLimitError when the messages are
    larger than the limit.
    """
    limit = file_limit_bytes(FILE_LIMIT, _FILE_LIMIT_MB, sum(one.stat().st_size for one in files))
    total = 0
    for message in messages:
        total += len(message.data)
        if total > limit:
            raise _limit_error('the messages of a bag', limit, 'more', FILE_LIMIT)
        yield message


DECOMPRESSORS['zstd'] = _within_limit(ZstdDecompressor)
DECOMPRESSORS['lz4'] = _within_limit(LZ4FrameDecompressor)
reader.zstd = SimpleNamespace(  # type: ignore[attr-defined,assignment]
    open=_LimitedFile, decompress=_whole(ZstdDecompressor, 'a message')
)
decompressors['bz2'] = _whole(BZ2Decompressor, 'a chunk')
decompressors['lz4'] = _whole(LZ4FrameDecompressor, 'a chunk')
