"""The intact messages of a bag that was cut off, read without an index."""

from collections.abc import Iterator
from contextlib import ExitStack
import io
import os
from pathlib import Path
import shutil
import sqlite3
import struct
from typing import BinaryIO, NamedTuple
import weakref

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.checksums import Check, check_mcap, check_sqlite, sqlite_rows
from flexx2_sim_ros.recording.chunks import ChunkLimitError, decompress, naming

# The format: https://mcap.dev/spec. Operation codes of the records that matter here.
_MAGIC = b'\x89MCAP0\r\n'
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _LAST = 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct('<BQ')
_SQLITE_HEADER = 100


class Message(NamedTuple):
    """
    A message (CDR) of a bag, its topic and type, as ``sensor_msgs/msg/Image``.

    ``time`` is when it was received, nanoseconds.
    """

    topic: str
    kind: str
    time: int
    data: bytes


class McapRemains:
    """
    An MCAP file without its end.

    Of the last, incomplete chunk, intact messages are read if chunks are not compressed.
    """

    def __init__(self, path: Path) -> None:
        """Remember the path."""
        self._path = path

    def messages(self) -> Iterator[Message]:
        """Iterate over messages in the order of the file, up to the first broken one."""
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}
        with naming(self._path), self._path.open('rb') as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                return
            for operation, body in _records(stream, self._path.stat().st_size):
                try:
                    if operation == _SCHEMA:
                        schemas[_number(body)] = _text(body, 2)[0]
                    elif operation == _CHANNEL:
                        schema = struct.unpack_from('<H', body, 2)[0]
                        channels[_number(body)] = _text(body, 4)[0], schemas[schema]
                    elif operation == _MESSAGE:
                        topic, kind = channels[_number(body)]
                        time = struct.unpack_from('<Q', body, 6)[0]
                        yield Message(topic, kind, time, body[22:])
                except (struct.error, UnicodeDecodeError, KeyError):
                    return


def _records(stream: BinaryIO, size: int, in_chunk: bool = False) -> Iterator[tuple[int, bytes]]:
    # Records as (operation, content), those inside chunks included, up to the first broken one.
    while len(head := stream.read(_RECORD.size)) == _RECORD.size:
        operation, length = _RECORD.unpack(head)
        body = stream.read(min(length, size))
        whole = len(body) == length
        if not 0 < operation <= _LAST or not (whole or operation == _CHUNK):
            return
        if operation == _CHUNK:
            if in_chunk:
                return
            try:
                content = _chunk(body, whole)
            except ChunkLimitError:
                raise
            except Exception:  # Damaged data can raise any error.
                return
            yield from _records(io.BytesIO(content), len(content), in_chunk=True)
        else:
            yield operation, body


def _chunk(body: bytes, whole: bool) -> bytes:
    size, checksum = struct.unpack_from('<QI', body, 16)
    compression, start = _text(body, 28)
    data = body[start + 8 :]
    if whole:
        return decompress(data, compression, size, checksum)
    return b'' if compression else data


def _number(body: bytes) -> int:
    return int(struct.unpack_from('<H', body)[0])


def _text(body: bytes, start: int) -> tuple[str, int]:
    # The string at an offset, and where it ends.
    end = start + 4 + int(struct.unpack_from('<I', body, start)[0])
    return body[start + 4 : end].decode(), end


class SqliteRemains:
    """
    A ``.db3`` file that was not closed or was cut off.

    A journal beside it is applied first, to a copy. The bag is not changed. Raises InputError when
    there is no room for the copy.
    """

    def __init__(self, path: Path) -> None:
        """Copy the file and its journal."""
        scratch = ExitStack()
        folder = scratch.enter_context(scratch_folder())
        weakref.finalize(self, scratch.close)
        self._copy = folder / 'copy.db3'
        try:
            shutil.copyfile(path, self._copy)
            for suffix in ('-journal', '-wal'):
                journal = path.with_name(path.name + suffix)
                if journal.is_file():
                    shutil.copyfile(journal, self._copy.with_name(self._copy.name + suffix))
            _cut_to_whole_pages(self._copy)
        except OSError as error:
            raise InputError(f'{path}: cannot be copied to {folder}: {error}') from error

    def messages(self) -> Iterator[Message]:
        """Iterate over messages in the order of writing, up to the first broken one."""
        connection = sqlite3.connect(self._copy)
        try:
            # Without this, SQLite refuses a file that is shorter than its header says.
            connection.execute('PRAGMA writable_schema=ON')
            for row in sqlite_rows(connection):
                if row.intact:
                    yield Message(row.topic, row.kind, row.time, row.data)
        except (sqlite3.Error, KeyError):
            return
        finally:
            connection.close()


def check_file(path: Path) -> Check:
    """Check whether a bag's file is complete and its checksums are right."""
    if path.suffix == '.mcap':
        return check_mcap(path)
    journals = (path.with_name(path.name + suffix) for suffix in ('-journal', '-wal'))
    if any(journal.is_file() and journal.stat().st_size > 0 for journal in journals):
        return Check('a journal was left behind', False)
    page = _page_size(path)
    if page and path.stat().st_size % page:
        return Check('the last page is cut', False)
    return check_sqlite(path)


def _page_size(path: Path) -> int:
    with path.open('rb') as file:
        head = file.read(_SQLITE_HEADER)
    if len(head) < _SQLITE_HEADER or not head.startswith(b'SQLite format 3\0'):
        return 0
    size = int.from_bytes(head[16:18], 'big')
    return 1 << 16 if size == 1 else size


def _cut_to_whole_pages(path: Path) -> None:
    # SQLite would return the missing end of a page as zeros.
    page = _page_size(path)
    if page:
        os.truncate(path, path.stat().st_size // page * page)
