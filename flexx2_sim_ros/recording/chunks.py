"""
Compressed chunks of MCAP files, decompressed within a limit.

A few kilobytes can expand to gigabytes. rosbags looks its decompressors up in a table and does
not limit them, so importing this module replaces them in that table. Everything that reads a
chunk, here and in rosbags, then keeps to the limit.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.limits import limit_bytes
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag2.storage_mcap import decompress, DECOMPRESSORS

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

__all__ = ['ChunkLimitError', 'LIMIT', 'decompress', 'naming']

LIMIT = 'FLEXX2_CHUNK_LIMIT_MB'
# Writers close a chunk after 1 to 8 MB, or after one larger message.
_LIMIT_MB = 128


class ChunkLimitError(InputError):
    """A chunk expands to more than the limit."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the file in the error of a chunk over the limit, as an `InputError`."""
    try:
        yield
    except ChunkLimitError as error:
        raise InputError(f'{path}: {error}') from error


def _within_limit(new_decompressor: Callable[[], Any]) -> Callable[[bytes, int], bytes]:
    def expand(data: bytes, size: int) -> bytes:
        # `size` is what the chunk declares. The caller compares it with what comes out, so one
        # byte more is enough.
        limit = limit_bytes(LIMIT, _LIMIT_MB)
        most = min(size, limit)
        content = b''
        while data and len(content) <= most:
            decompressor = new_decompressor()
            content += decompressor.decompress(data, max_length=most + 1 - len(content))
            if not decompressor.eof:
                break
            data = decompressor.unused_data or b''
        # A damaged file may declare a large size too, but does not contain it.
        if len(content) > limit:
            raise ChunkLimitError(
                f'a chunk must not decompress to more than {limit >> 20} MB, got '
                f'{size >> 20} MB; the environment variable {LIMIT} raises the limit'
            )
        return content

    return expand


DECOMPRESSORS['zstd'] = _within_limit(ZstdDecompressor)
DECOMPRESSORS['lz4'] = _within_limit(LZ4FrameDecompressor)
