"""
Checksums of bags: written into every bag of this package, and verified before reading.

MCAP has fields for them (https://mcap.dev/spec), which rosbags leaves empty. SQLite bags have no
such fields, so a table beside the messages holds one for each. Other programs ignore that table.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
import os
from pathlib import Path
import sqlite3
import struct
import sys
from typing import BinaryIO, NamedTuple
from zlib import crc32

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# Level 3, zstd's default, takes 1.6 times as long for 2 % less (`python -m bench bags`).
ZSTD_LEVEL = 1
# Operation codes of the MCAP records that matter here.
_FOOTER, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x05, 0x06, 0x0F
_MAGIC_SIZE = 8
_RECORD = struct.Struct('<BQ')
_FOOTER_RECORD = struct.Struct('<BQQQI')
_CHECKSUM = struct.Struct('<I')
_CHUNK_CHECKSUM = 24  # bytes from the start of a chunk's content
_BLOCK = 1 << 20
_TABLE = 'flexx2_checksums'
# What SQLite reads as something else in a URI.
_ESCAPES = str.maketrans({character: f'%{ord(character):02X}' for character in '%?#'})


@dataclass(frozen=True)
class Check:
    """
    Result of the verification of a file's checksums: what is wrong, or None.

    ``protected`` says whether all messages have checksums. Otherwise damage may not be noticed.
    """

    problem: str | None
    protected: bool


class BagRow(NamedTuple):
    """
    A message (CDR) of an SQLite bag, its topic and type.

    ``time`` is when it was received, nanoseconds; ``intact`` says whether its checksum is right,
    or the bag has none.
    """

    topic: str
    kind: str
    time: int
    data: bytes
    intact: bool


class _McapWriter(McapWriter):
    """Fills in the checksums of chunks and of the summary."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        if compression is CompressionMode.STORAGE:
            self.compressor = partial(zstd.compress, level=ZSTD_LEVEL)

    def close_chunk(self) -> None:
        """Write the chunk, and its checksum into the field that was left empty."""
        checksum = crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        self.bio.seek(start + _RECORD.size + _CHUNK_CHECKSUM)
        self.bio.write(_CHECKSUM.pack(checksum))
        self.bio.seek(0, os.SEEK_END)

    def close(self, version: int, metadata: str) -> None:
        """Write the end of the file, and the checksum of the summary."""
        super().close(version, metadata)
        with self.path.open('r+b') as file:
            size = file.seek(0, os.SEEK_END)
            footer = _footer(file, size)
            if footer is not None:
                checksum = _checksum(file, footer[0], size - _MAGIC_SIZE - _CHECKSUM.size)
                file.seek(size - _MAGIC_SIZE - _CHECKSUM.size)
                file.write(_CHECKSUM.pack(checksum))


def in_uri(path: Path) -> Path:
    """
    Return a path so that SQLite finds it in a URI.

    rosbags puts a path into a URI as it is. SQLite ends the path there at ``#`` and ``?``, and
    takes ``%41`` for an ``A``: it would write and read another file.
    """
    return Path(str(path).translate(_ESCAPES))


class _SqliteWriter(Sqlite3Writer):
    """Writes a checksum for each message into a table of its own."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(in_uri(path), compression)
        self.path = path / f'{path.name}.db3'
        self.conn.execute(f'CREATE TABLE {_TABLE}(id INTEGER PRIMARY KEY, crc32 INTEGER NOT NULL)')

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message and its checksum."""
        super().write(connection, timestamp, data)
        self.cursor.execute(
            f'INSERT INTO {_TABLE} VALUES (last_insert_rowid(), ?)',
            (message_checksum(connection.topic, connection.msgtype, timestamp, data),),
        )


class CheckedWriter(Writer):
    """The writer of rosbags, with checksums in what it writes."""

    STORAGE_PLUGINS = {StoragePlugin.SQLITE3: _SqliteWriter, StoragePlugin.MCAP: _McapWriter}


def message_checksum(topic: str, kind: str, time: int, data: bytes | memoryview) -> int:
    """Return the CRC-32 of a message with its topic, type and time of receipt."""
    return crc32(data, crc32(f'{topic}\0{kind}\0{time}\0'.encode()))


def check_mcap(path: Path) -> Check:
    """
    Verify the checksums of an MCAP file, except those of its chunks.

    Chunks are verified when they are read.
    """
    with path.open('rb') as file:
        size = file.seek(0, os.SEEK_END)
        footer = _footer(file, size)
        if footer is None:
            return Check(None, _has_checksums(file, size))
        start, checksum = footer
        if checksum and _checksum(file, start, size - _MAGIC_SIZE - _CHECKSUM.size) != checksum:
            return Check('the checksum of its summary is wrong', True)
        file.seek(start - _RECORD.size - _CHECKSUM.size)
        operation, _ = _RECORD.unpack(file.read(_RECORD.size))
        checksum = _CHECKSUM.unpack(file.read(_CHECKSUM.size))[0]
        if operation != _DATA_END:
            return Check('its summary is not where its footer says', False)
        if checksum == 0:
            return Check(None, _has_checksums(file, size))
        if _checksum(file, 0, start - _RECORD.size - _CHECKSUM.size) != checksum:
            return Check('the checksum of its data is wrong', True)
        return Check(None, True)


def _footer(file: BinaryIO, size: int) -> tuple[int, int] | None:
    # Where the summary starts, and its checksum. None for a file without its end or a summary.
    at = size - _MAGIC_SIZE - _FOOTER_RECORD.size
    if at < _MAGIC_SIZE:
        return None
    file.seek(at)
    operation, length, start, _, checksum = _FOOTER_RECORD.unpack(file.read(_FOOTER_RECORD.size))
    if (operation, length) != (_FOOTER, _FOOTER_RECORD.size - _RECORD.size):
        return None
    return (start, checksum) if 2 * _MAGIC_SIZE + _RECORD.size <= start <= at else None


def _checksum(file: BinaryIO, start: int, end: int) -> int:
    file.seek(start)
    checksum = 0
    while start < end and (block := file.read(min(_BLOCK, end - start))):
        checksum = crc32(block, checksum)
        start += len(block)
    return checksum


def _has_checksums(file: BinaryIO, size: int) -> bool:
    # Whether every message is in a chunk that has one.
    at = _MAGIC_SIZE
    while at < size:
        file.seek(at)
        head = file.read(_RECORD.size + _CHUNK_CHECKSUM + _CHECKSUM.size)
        if len(head) < _RECORD.size:
            break
        operation, length = _RECORD.unpack_from(head)
        if operation == _MESSAGE or operation == _CHUNK and not any(head[-_CHECKSUM.size :]):
            return False
        at += _RECORD.size + length
    return True


def check_sqlite(path: Path) -> Check:
    """Verify the structure of an SQLite file, and the checksums of its messages if it has any."""
    connection = sqlite3.connect(f'{path.absolute().as_uri()}?mode=ro&immutable=1', uri=True)
    try:
        found = connection.execute('PRAGMA integrity_check(1)').fetchone()[0]
        if found != 'ok':
            return Check(f'its structure is damaged: {found}', False)
        _check_content(connection)
        if not _has_table(connection):
            return Check(None, False)
        wrong = sum(not row.intact for row in sqlite_rows(connection))
        (lost,) = connection.execute(
            f'SELECT count(*) FROM {_TABLE} WHERE id NOT IN (SELECT id FROM messages)'
        ).fetchone()
        if wrong or lost:
            return Check(
                f'the checksums of {wrong} messages are wrong, {lost} messages are missing', True
            )
        return Check(None, True)
    except (sqlite3.Error, KeyError, TypeError, ValueError) as error:
        return Check(str(error), False)
    finally:
        connection.close()


def sqlite_rows(connection: sqlite3.Connection) -> Iterator[BagRow]:
    """
    Iterate over the messages of an SQLite bag, in the order of writing.

    Raises sqlite3.Error or KeyError when the file is damaged.
    """
    _check_tables(connection)
    topics = {
        number: (name, kind)
        for number, name, kind in connection.execute('SELECT id, name, type FROM topics')
        if isinstance(name, str) and isinstance(kind, str)
    }
    if not _has_table(connection):
        for number, time, data in connection.execute(
            'SELECT topic_id, timestamp, data FROM messages ORDER BY id'
        ):
            if not isinstance(data, bytes) or not isinstance(time, int):
                return
            yield BagRow(*topics[number], time, data, True)
        return
    for number, time, data, checksum in connection.execute(
        f'SELECT topic_id, timestamp, data, crc32 FROM messages LEFT JOIN {_TABLE} USING (id) '
        'ORDER BY id'
    ):
        topic, kind = topics.get(number, ('', ''))
        yield BagRow(
            topic,
            kind,
            time,
            data,
            isinstance(data, bytes)
            and isinstance(time, int)
            and message_checksum(topic, kind, time, data) == checksum,
        )


def _check_tables(connection: sqlite3.Connection) -> None:
    # A view could return endless rows.
    kinds = connection.execute(
        "SELECT type FROM sqlite_master WHERE name IN ('topics', 'messages')"
    ).fetchall()
    if any(kind != ('table',) for kind in kinds):
        raise sqlite3.DatabaseError('topics and messages must be tables, got something else')


def _check_content(connection: sqlite3.Connection) -> None:
    # SQLite allows values of any type in a column.
    _check_tables(connection)
    for table, types in (
        ('topics', {'name': 'text', 'type': 'text'}),
        ('messages', {'timestamp': 'integer', 'data': 'blob'}),
    ):
        for column, wanted in types.items():
            (wrong,) = connection.execute(
                f"SELECT count(*) FROM {table} WHERE typeof({column}) <> '{wanted}'"
            ).fetchone()
            if wrong:
                raise sqlite3.DatabaseError(
                    f'{table}: {column}: must be {wanted}, got another type in {wrong} rows'
                )


def _has_table(connection: sqlite3.Connection) -> bool:
    return connection.execute(
        "SELECT count(*) FROM sqlite_master WHERE type='table' AND name=?", (_TABLE,)
    ).fetchone() == (1,)
