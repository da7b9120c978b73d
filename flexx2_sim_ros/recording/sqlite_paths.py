"""
Paths of SQLite bags, for rosbags.

rosbags puts a path into a URI as it is. SQLite ends the path there at ``#`` and ``?``, and takes
``%41`` for an ``A``: it would write and read another file.
"""

from pathlib import Path

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

_ESCAPES = str.maketrans({character: f'%{ord(character):02X}' for character in '%?#'})


def in_uri(path: Path) -> Path:
    """Return a path so that SQLite finds it in a URI."""
    return Path(str(path).translate(_ESCAPES))


class _Sqlite(Sqlite3Reader):
    """Opens the file that it is given."""

    def __init__(self, path: Path) -> None:
        super().__init__(in_uri(path))


class _Folder(DirectoryReader):
    STORAGE_PLUGINS = {**DirectoryReader.STORAGE_PLUGINS, 'sqlite3': _Sqlite}


class BagReader(Reader):
    """The reader of rosbags, also for SQLite bags whose paths have characters of URIs."""

    STORAGE_PLUGINS = {**Reader.STORAGE_PLUGINS, 'dir': _Folder, '.db3': _Sqlite}
