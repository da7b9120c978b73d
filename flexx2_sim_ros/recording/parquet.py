"""Untrusted Parquet tables: their columns, row group by row group, within a limit of size."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, one_sentence, shown_path, unquoted
from flexx2_sim_ros.limits import file_limit_bytes
from flexx2_sim_ros.npz_arrays import LIMIT, LIMIT_MB

MOST_ROWS = 10_000_000  # assumed, as the next
_MOST_FOOTER = 16 << 20
_TRUE, _FALSE, _BYTE, _DOUBLE, _TEXT, _LIST, _SET, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
_WHOLE = (4, 5, 6)


@contextmanager
def open_table(path: Path, columns: list[str], most_rows: int = MOST_ROWS) -> Iterator[Any]:
    """
    Open a table, of which `columns` will be read; needs pyarrow that unpickles nothing.

    Raises InputError when it cannot be read, lacks a column, has more than ``most_rows`` rows, or
    a row group of the columns is over the limit.
    """
    import pyarrow.parquet

    name = shown_path(path)
    if not is_regular_file(path):
        raise InputError(f'{name}: must be a table of the data set, got no file')
    with one_sentence(f'{name}: cannot be read'):
        groups = _row_groups(path)
        with pyarrow.parquet.ParquetFile(path, buffer_size=1 << 20) as file:
            for column in columns:
                if column not in file.schema_arrow.names:
                    raise InputError(f'{name}: {unquoted(column)}: must be a column, got none')
            rows = file.metadata.num_rows
            if rows > most_rows:
                raise InputError(f'{name}: must have at most {most_rows} rows, got {rows}')
            most = file_limit_bytes(LIMIT, LIMIT_MB, path.stat().st_size)
            size = max((_bytes(group, columns) for group in groups), default=0)
            if size > most:
                raise InputError(
                    f'{name}: must not decompress to more than {most >> 20} MB, got {size >> 20} '
                    f'MB; the environment variable {LIMIT} raises the limit'
                )
            yield file


def _bytes(group: dict[int, Any], columns: list[str]) -> int:
    # Decompressed. A row can have all values of its group, however few bytes these take.
    size = 0
    for chunk in group[1]:
        path, values, plain = (chunk[3][number] for number in (3, 5, 6))
        if path[0].decode() in columns:
            size += max(plain, 4 * values)
    return size


def _row_groups(path: Path) -> list[dict[int, Any]]:
    # By the numbers of parquet.thrift. pyarrow ends the process if it finds a mistake in what
    # the footer says of a column, so it is not asked.
    with path.open('rb') as file:
        file.seek(-8, 2)
        length = int.from_bytes(file.read(4), 'little')
        if file.read() != b'PAR1':
            raise InputError(f'{shown_path(path)}: must be a Parquet table, got another file')
        if length > _MOST_FOOTER:
            raise InputError(f'{shown_path(path)}: must have a footer of at most {_MOST_FOOTER} B')
        file.seek(-8 - length, 2)
        found = _Footer(file.read(length)).value(_STRUCT)
    return list(found[4])


class _Footer:
    # Reads the compact protocol of Thrift.

    def __init__(self, content: bytes) -> None:
        self._bytes = iter(content)

    def value(self, kind: int) -> Any:
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind == _BYTE:
            return next(self._bytes)
        if kind in _WHOLE:
            number = self._number()
            return number >> 1 ^ -(number & 1)
        if kind in (_DOUBLE, _TEXT):
            size = 8 if kind == _DOUBLE else self._number()
            return bytes(next(self._bytes) for _ in range(size))
        if kind in (_LIST, _SET):
            head = next(self._bytes)
            count = head >> 4 if head >> 4 < 15 else self._number()
            one = head & 15
            return [self.value(_BYTE if one in (_TRUE, _FALSE) else one) for _ in range(count)]
        if kind == _STRUCT:
            return dict(self._fields())
        raise ValueError(f'a value of the kind {kind}')

    def _fields(self) -> Iterator[tuple[int, Any]]:
        number = 0
        while head := next(self._bytes):
            number = number + (head >> 4) if head >> 4 else self.value(_WHOLE[0])
            yield number, self.value(head & 15)

    def _number(self) -> int:
        number = 0
        for shift in range(0, 70, 7):  # 64 bits
            byte = next(self._bytes)
            number |= (byte & 127) << shift
            if byte < 128:
                return number
        raise ValueError('a number of more than 64 bits')
