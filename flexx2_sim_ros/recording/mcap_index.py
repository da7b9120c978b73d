"""Read a whole MCAP file several times, by the index that rosbags has read once."""

from collections import deque
from collections.abc import Collection, Iterator
import heapq
import struct
from typing import Any, BinaryIO

from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.chunks import decompress
from rosbags.interfaces import Connection
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, read_exact

# The format: https://mcap.dev/spec.
_MESSAGE = 0x05
_RECORD = struct.Struct('<BQ')
_HEAD = struct.Struct('<HIQQ')  # of a message: channel, sequence, log time, publish time
_CHECKSUM = struct.Struct('<I')
_CHUNK_CHECKSUM = 24  # bytes from the start of a chunk's content
_CHUNK_COMPRESSION = 40  # the same, to the end of all but the name of the compression
_KEPT_BYTES = 64 << 20  # two seconds of a camera at 60 Hz with its ground truth
_LAST_CHUNKS = 2  # The images of a frame are beside each other.

_Entry = tuple[int, int, Connection | None, bytes]


class IndexedMcap:
    """
    The messages of an MCAP file that has an index.

    The first 64 MB of its chunks are kept: stamps are looked for before images, and each stack of
    images is read on its own. Of the others, the last ones are kept.
    """

    def __init__(self, opened: McapReader) -> None:
        """Take the index of a file that is open; it may be closed then."""
        self._path = opened.path
        self._stamp = _stamp(self._path)
        self._chunks = list(opened.chunks)
        self._connections = list(opened.connections)
        self._kept: dict[int, bytes] = {}
        self._room = _KEPT_BYTES
        self._last: deque[tuple[int, bytes]] = deque(maxlen=_LAST_CHUNKS)

    def is_current(self) -> bool:
        """Say whether the file is the one whose index this is."""
        return _stamp(self._path) == self._stamp

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Iterate over the messages of some topics, by the time of reception."""
        wanted = {one.id: one for one in self._connections if one.topic in topics}
        with self._path.open('rb') as file:
            parts = [
                self._of_chunk(file, chunk, wanted)
                for chunk in self._chunks
                if any(chunk.channel_count.get(number) for number in wanted)
            ]
            for time, _, connection, data in heapq.merge(*parts):
                if connection is not None:
                    yield Message(connection.topic, connection.msgtype, time, data)

    def _of_chunk(
        self, file: BinaryIO, chunk: ChunkInfo, wanted: dict[int, Connection]
    ) -> Iterator[_Entry]:
        first, last, place = chunk[:3]
        yield first, 0, None, b''  # A chunk is not read before its time.
        content = self._content(file, chunk)
        found = []
        at = 0
        while at < len(content):
            operation, length = _RECORD.unpack_from(content, at)
            at += _RECORD.size
            if operation == _MESSAGE:
                if not _HEAD.size <= length <= len(content) - at:
                    raise ReaderError(f'Message of {length} bytes at {at} of a chunk.')
                channel, _, time, _ = _HEAD.unpack_from(content, at)
                if first <= time <= last and channel in wanted:
                    found.append((time, at + _HEAD.size, at + length, wanted[channel]))
            at += length
        for time, start, end, connection in sorted(found):
            yield time, place, connection, content[start:end]

    def _content(self, file: BinaryIO, chunk: ChunkInfo) -> bytes:
        place = chunk.chunk_start_offset
        for one, content in ((place, self._kept.get(place)), *self._last):
            if one == place and content is not None:
                return content
        start = place + _RECORD.size
        file.seek(start + _CHUNK_CHECKSUM)
        (checksum,) = _CHECKSUM.unpack(read_exact(file, _CHECKSUM.size))
        file.seek(start + _CHUNK_COMPRESSION + len(chunk.compression))
        data = read_exact(file, chunk.compressed_size)
        content = decompress(data, chunk.compression, chunk.uncompressed_size, checksum)
        self._room -= len(content)
        if self._room > 0:
            self._kept[place] = content
        else:
            self._last.append((place, content))
        return content


def _stamp(path: Any) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns
