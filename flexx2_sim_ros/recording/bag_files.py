"""The files of a bag: complete ones, and the intact part of damaged ones."""

from collections import Counter
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
import re
from typing import Protocol

from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.recording.bag_cameras import Sample, sample, unknown_topics
from flexx2_sim_ros.recording.bag_remains import check_file, McapRemains, Message, SqliteRemains
from flexx2_sim_ros.recording.bag_ros1 import Ros1Bag
from flexx2_sim_ros.recording.checksums import Check, in_uri
from flexx2_sim_ros.recording.chunks import limited, naming
from flexx2_sim_ros.recording.mcap_index import IndexedMcap
from rosbags.interfaces import Connection, ConnectionExtRosbag2, QosDurability
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

# Key of a bag's custom data: what was lost while it was recorded, as text.
LOST = 'flexx2_lost'
_REMAINS: dict[str, type[McapRemains] | type[SqliteRemains]] = {
    '.mcap': McapRemains,
    '.db3': SqliteRemains,
}


class _Part(Protocol):
    topics: dict[str, str]
    latched: set[str]

    def messages(self, topics: Collection[str]) -> Iterator[Message]: ...


class Bag:
    """
    A rosbag2 bag (a folder, or a single ``.mcap`` or ``.db3`` file), or a ``.bag`` file of ROS 1.

    Of a bag that was cut off (no end, no ``metadata.yaml``, a journal left behind), the intact
    messages are read, and `notes` says how many. No file is changed. Raises InputError when there
    is no bag, or it has no complete message.

    ``topics`` are types, as ``sensor_msgs/msg/Image``, by topic, without topics that have no
    messages; ``latched`` those whose publishers were transient local according to the bag. Reading
    can add to the `notes`.
    """

    def __init__(self, path: str | Path) -> None:
        """Open and check the bag, and close it again."""
        self.path = Path(path)
        self.notes: list[str] = []
        try:
            self._parts = self._open()
        except OSError as error:
            raise InputError(f'{path}: cannot be read: {error}') from error
        self.topics = {topic: kind for part in self._parts for topic, kind in part.topics.items()}
        self.latched = {topic for part in self._parts for topic in part.latched}
        if not self.topics:
            raise InputError('; '.join([f'{path}: it contains no complete message', *self.notes]))

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Iterate over the messages of some topics (default: all), by the time of reception."""
        wanted = self.topics if topics is None else topics
        files = [self.path] if self.path.is_file() else filter(Path.is_file, self.path.iterdir())
        with naming(self.path):
            yield from limited(
                (message for part in self._parts for message in part.messages(wanted)), files
            )

    @cached_property
    def samples(self) -> dict[str, Sample]:
        """Return the properties of images and camera infos with unknown names."""
        wanted = set(unknown_topics(self.topics))
        found: dict[str, Sample] = {}
        broken: set[str] = set()
        if not wanted:
            return found
        for topic, kind, _, data in self.messages(wanted):
            if topic not in found:
                try:
                    one = sample(kind, data, f'{self.path}: {topic}')
                    if all(one.size):  # Else it does not say yet what it will be.
                        found[topic] = one
                except InputError as error:  # The next message may be intact.
                    if topic not in broken:
                        broken.add(topic)
                        self.notes.append(str(error))
                if len(found) == len(wanted):
                    break
        return found

    def _open(self) -> list[_Part]:
        if self.path.is_file():
            if self.path.suffix == '.bag':
                return [Ros1Bag(self.path, self.notes)]
            if self.path.suffix not in _REMAINS:
                raise InputError(
                    f'{self.path}: must be a .mcap, .db3 or .bag file or the folder of a bag, got '
                    f'a file {unquoted(self.path.suffix) or "without an ending"}'
                )
            return [self._open_file(self.path, check_file(self.path))]
        if not self.path.is_dir():
            got = 'something else' if self.path.exists() else 'a path that does not exist'
            raise InputError(
                f'{self.path}: must be a bag (a folder, or a .mcap, .db3 or .bag file), got {got}'
            )
        files = sorted(
            (file for file in self.path.iterdir() if file.suffix in _REMAINS), key=_natural
        )
        for file in files:
            if not file.is_file():
                raise InputError(f'{file}: must be a file, got something else')
        checks = {file: check_file(file) for file in files}
        if not (self.path / 'metadata.yaml').is_file():
            if not files:
                raise InputError(f'{self.path}: must have a .mcap or .db3 file, got none')
            self.notes.append(f'{self.path}: was not closed: it has no metadata.yaml')
        elif not any(check.problem for check in checks.values()):
            try:
                whole = _Whole(self.path, self.notes)
                self._say_unprotected(checks)
                return [whole]
            except InputError:
                raise
            except Exception as error:  # A damaged file breaks the reader in any way.
                self.notes.append(f'{self.path}: not whole: {error}')
        if not files:
            raise InputError(
                '; '.join([f'{self.path}: must have a .mcap or .db3 file, got none', *self.notes])
            )
        return [self._open_file(file, check) for file, check in checks.items()]

    def _open_file(self, path: Path, check: Check) -> _Part:
        reason = check.problem
        if reason is None:
            try:
                whole = _Whole(path, self.notes)
                self._say_unprotected({path: check})
                return whole
            except InputError:
                raise
            except Exception as error:  # A damaged file breaks the reader in any way.
                reason = str(error)
        return _Remains(path, reason, self.notes)

    def _say_unprotected(self, checks: dict[Path, Check]) -> None:
        if not all(check.protected for check in checks.values()):
            self.notes.append(
                f'{self.path}: has no checksums: damage inside of messages would not be noticed'
            )


class _Whole:
    """A complete bag, read by rosbags: a folder with its metadata, or a file with its end."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        self._path = path
        self._notes = notes
        with naming(path), BagReader(path) as reader:
            self.topics = {
                connection.topic: connection.msgtype
                for connection in reader.connections
                if connection.msgcount
            }
            self.latched = {
                connection.topic for connection in reader.connections if _is_latched(connection)
            }
            files = [reader.storage]
            if isinstance(reader.storage, DirectoryReader):
                _compare(reader.storage)
                files = reader.storage.storages
            chunked = [
                IndexedMcap(one) for one in files if isinstance(one, McapReader) and one.chunks
            ]
            packed = reader.storage.metadata.compression_mode  # of files or messages
            # Empty where rosbags reads the files each time.
            self._indexed = [] if packed or len(chunked) < len(files) else chunked
            lost = (reader.storage.metadata.custom or {}).get(LOST)
        if lost:
            notes.append(f'{path}: lost while it was recorded: {lost}')

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        try:
            if self._indexed and all(file.is_current() for file in self._indexed):
                with naming(self._path):
                    for file in self._indexed:
                        yield from file.messages(topics)
                return
            with naming(self._path), BagReader(self._path) as reader:
                wanted = [item for item in reader.connections if item.topic in topics]
                if not wanted:
                    return
                for connection, time, data in reader.messages(wanted):
                    yield Message(connection.topic, connection.msgtype, time, bytes(data))
        except InputError:
            raise
        except Exception as error:  # A damaged file breaks the reader in any way.
            note = f'{self._path}: damaged: {error}; read up to there'
            if note not in self._notes:
                self._notes.append(note)


def _compare(bag: DirectoryReader) -> None:
    # Topics and QoS in metadata.yaml must match the files. Otherwise rosbags leaves messages
    # out.
    files = [item for file in bag.storages for item in file.connections]
    typed = all(item.digest for item in [*bag.connections, *files])  # MCAP files have none.
    listed: Counter[tuple[str, ...]] = Counter()
    held: Counter[tuple[str, ...]] = Counter()
    for counter, connections in ((listed, bag.connections), (held, files)):
        for item in connections:
            counter[item.topic, item.msgtype, repr(item.ext), item.digest if typed else ''] += (
                item.msgcount
            )
    if +listed != +held:
        raise ReaderError('metadata.yaml lists other topics than the files hold')


class _Remains:
    """The intact messages of one damaged file."""

    def __init__(self, path: Path, reason: str, notes: list[str]) -> None:
        self._remains = _REMAINS[path.suffix](path)
        self.topics: dict[str, str] = {}
        self.latched: set[str] = set()
        count, first, last = 0, 0, 0
        for message in self._remains.messages():
            self.topics[message.topic] = message.kind
            first = message.time if count == 0 else first
            last = message.time
            count += 1
        notes.append(
            f'{path}: cut off or damaged ({reason.rstrip(".")}): {count} messages over '
            f'{max(last - first, 0) / 1e9:.3f} s are whole and are read'
        )

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        return (message for message in self._remains.messages() if message.topic in topics)


class _SqliteReader(Sqlite3Reader):
    """Opens the file that it is given."""

    def __init__(self, path: Path) -> None:
        super().__init__(in_uri(path))


class _Folder(DirectoryReader):
    STORAGE_PLUGINS = {**DirectoryReader.STORAGE_PLUGINS, 'sqlite3': _SqliteReader}


class BagReader(Reader):
    """The reader of rosbags, also for SQLite bags whose paths have characters of URIs."""

    STORAGE_PLUGINS = {**Reader.STORAGE_PLUGINS, 'dir': _Folder, '.db3': _SqliteReader}


def _is_latched(connection: Connection) -> bool:
    return isinstance(connection.ext, ConnectionExtRosbag2) and any(
        offer.durability == QosDurability.TRANSIENT_LOCAL
        for offer in connection.ext.offered_qos_profiles
    )


def _natural(path: Path) -> list[tuple[str, int]]:
    # bag_2 comes before bag_10.
    return [(text, int(digits or 0)) for text, digits in re.findall(r'(\D+)(\d*)', path.name)]
