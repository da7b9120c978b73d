"""Write bags: single messages, or a whole recording."""

from collections.abc import Callable, Iterator
from contextlib import suppress
import io
from pathlib import Path
import re
from types import TracebackType
from typing import Literal

from flexx2_sim_ros.atomic import named, whole
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_cameras import CameraTopics, EVENTS, topics_of
from flexx2_sim_ros.recording.checksums import CheckedWriter
from flexx2_sim_ros.recording.reader import RecordingReader
import numpy as np
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
_JAZZY: Literal[9] = 9  # version of metadata.yaml
# The QoS of the driver and `flexx2_camera`, for topics whose QoS is not known.
_FOREVER = QosTime(9223372036, 854775807)
_OFFER = Qos(
    QosHistory.KEEP_LAST,
    10,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    False,
)
_LATEST = (1 << 31) * 1_000_000_000
_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
# Types that images carry exactly; stacks of other types are stored as arrays.
_CARRIED_BY_IMAGES = {
    'depth': ('f4',),
    'clean_depth': ('f4', 'f8'),
    'reflectivity': ('f4',),
    'amplitude': ('u1', 'u2'),
}


class BagWriter:
    """
    A bag that is being written, a folder; all calls must come from one thread, as SQLite requires.

    ``storage`` is ``mcap`` or ``sqlite3``, ``compression`` ``none``, or ``zstd`` for the chunks of
    MCAP files. ``offers`` is the QoS of each topic's publishers, for programs that play the bag;
    to be set before the topic's first message. Default: reliable and volatile, as the driver.
    Raises InputError when the name is taken, the folder cannot be made, or the storage has no
    compression.
    """

    def __init__(self, path: str | Path, storage: str = 'mcap', compression: str = 'none') -> None:
        """Check the path; the folder is made later."""
        if compression != 'none' and storage != 'mcap':
            raise InputError(
                f'--compression: must be none with --storage {storage}, got {compression}'
            )
        check_new(Path(path))
        self.path = Path(path)
        with named(path):
            self._writer = CheckedWriter(
                self.path, version=_JAZZY, storage_plugin=STORAGES[storage]
            )
        if compression == 'zstd':
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self.offers: dict[str, list[Qos]] = {}
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> 'BagWriter':
        """Make the folder and the file."""
        with named(self.path):
            try:
                self._writer.open()
            except WriterError as error:
                raise InputError(f'{self.path}: cannot be written: {error}') from error
        return self

    def write(self, topic: str, kind: str, time: int, data: bytes) -> None:
        """
        Add a message, CDR, of a type such as ``sensor_msgs/msg/Image``.

        ``time`` is when it was received, nanoseconds; not before the last message.
        """
        connection = self._connections.get(topic)
        if connection is None:
            connection = self._connections[topic] = self._writer.add_connection(
                topic,
                kind,
                typestore=messages.typestore(),
                offered_qos_profiles=self.offers.get(topic, [_OFFER]),
            )
        self._writer.write(connection, time, data)

    def note(self, key: str, value: str) -> None:
        """Add a remark to the bag's ``metadata.yaml``, as custom data."""
        self._writer.set_custom_data(key, value)

    def flush(self) -> None:
        """Flush to the file, so that messages survive a crash of this process."""
        storage = self._writer.storage
        if isinstance(storage, Sqlite3Writer):
            storage.conn.commit()
        elif isinstance(storage, McapWriter):
            if storage.chunk.msgs:
                storage.close_chunk()
            storage.bio.flush()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, with index and metadata if there was no error."""
        self._writer.__exit__(kind, error, trace)


def check_new(path: Path) -> None:
    """Raise `InputError` when the path to write to exists."""
    with named(path), suppress(FileNotFoundError):
        path.lstat()
        raise InputError(
            f'{path}: must be a new name, got one that exists: bags are not overwritten'
        )


def check_bag_name(path: Path, others: str = '') -> None:
    """
    Raise InputError when a bag's folder is named like a file: ``walk.npz`` could not be read.

    ``others`` is what else the name could be, for the error.
    """
    # `wall_1.5m` and `walk_2026.01.31` are folders.
    if path.suffix[1:2].isalpha():
        unwritten = ': bags of ROS 1 are only read' if path.suffix.lower() == '.bag' else ''
        raise InputError(
            f'{shown_path(path)}: must be {others}a folder whose name has no ending, got '
            f'{shown(path.suffix)}{unwritten}'
        )


def write_bag(
    reader: RecordingReader,
    path: Path,
    storage: str,
    camera: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """
    Write a recording as a bag on the topics of `flexx2_camera`.

    Images are stored as messages, and all other arrays on the topic ``/<camera>/recording``, so
    that `open_recording` returns every key exactly. A message has the time at which the frame was
    received, if the recording has it, else its stamp. The bag gets its name when it is complete.

    ``path`` is the folder, or a single file if the name ends in ``.mcap`` or ``.db3``, which has
    priority over ``storage``, ``mcap`` or ``sqlite3``. ``camera`` is the camera's namespace; by
    default the recording's name, else ``camera``. ``progress`` is called with the fraction of the
    frames that are written. Raises InputError when messages cannot have the recording's stamps,
    the name is not a ROS name, the path exists, or it cannot be written.
    """
    name = camera or str(reader.arrays.get('camera', 'camera'))
    if not _NAME.fullmatch(name):
        raise InputError(
            f'--camera: must be letters, digits and _, as in front_left, got {shown(name)}'
        )
    for key, times in (('stamp', reader.stamp_ns), ('received', _arrivals(reader))):
        low, high = int(times.min()), int(times.max())
        if low < 0 or high >= _LATEST:
            raise InputError(
                f'{reader.path}: {key}: must be 0 to 2147483648 s, the range of messages, got '
                f'{low / 1e9:g} to {high / 1e9:g} s'
            )
    check_new(path)
    single = path.suffix in SUFFIXES
    with whole(path) as part:
        # The writer makes a folder. For a single file, only the file in it is kept.
        folder = part.with_name('bag') if single else part
        where, frames = topics_of(name), 0
        with BagWriter(folder, SUFFIXES.get(path.suffix, storage)) as writer:
            for topic, kind, time, data in _messages(reader, where):
                writer.write(topic, kind, time, data)
                if topic == where.depth:
                    frames += 1
                    progress(frames / len(reader.stamp))
        if single:
            (folder / f'{folder.name}{path.suffix}').rename(part)


def _messages(
    reader: RecordingReader, where: CameraTopics
) -> Iterator[tuple[str, str, int, bytes]]:
    # A bag is read in order of time: a time that goes back would reorder the frames.
    times = np.maximum.accumulate(_arrivals(reader)).tolist()
    start = times[0]
    for key, array in _carried(reader).items():
        yield where.carried, messages.BYTES, start, messages.encode_bytes(key, array)
    if reader.usecase is not None:
        yield (
            EVENTS,
            messages.PARAMETER_EVENT,
            start,
            messages.encode_text_parameter(start, where.node, 'usecase', reader.usecase),
        )
    given = reader.arrays.get('frame_id')
    frame_id = f'{where.name}_optical_frame' if given is None else str(given)
    images = {
        topic: _images(reader, key)
        for topic, key in (
            (where.clean, 'clean_depth'),
            (where.reflectivity, 'reflectivity'),
            (where.depth, 'depth'),
            (where.gray, 'amplitude'),
        )
        if key in reader.layouts or key in reader.arrays
    }
    infos = [where.info, *([where.clean_info] if where.clean in images else [])]
    for stamp, time in zip(reader.stamp_ns.tolist(), times, strict=True):
        info = messages.encode_camera_info(
            stamp, frame_id, reader.shape[1:], reader.K, np.array(reader.distortion)
        )
        for topic in infos:
            yield topic, messages.CAMERA_INFO, time, info
        for topic, source in images.items():
            yield topic, messages.IMAGE, time, messages.encode_image(stamp, frame_id, next(source))


def _arrivals(reader: RecordingReader) -> np.ndarray:
    # (T,) nanoseconds; where they are not known, a frame arrives at its stamp.
    received = reader.received_ns
    return reader.stamp_ns if received is None else received


def _carried(reader: RecordingReader) -> dict[str, bytes]:
    # Every key: empty where images carry it, else the array as .npy.
    carried = {}
    for key, layout in reader.layouts.items():
        exact = layout.dtype.str[1:] in _CARRIED_BY_IMAGES[key]
        carried[key] = b'' if exact else _npy(np.stack(list(reader.frames(key))))
    return carried | {key: _npy(array) for key, array in reader.arrays.items()}


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _images(reader: RecordingReader, key: str) -> Iterator[np.ndarray]:
    # One image per frame; a single image for all frames is repeated.
    if key in reader.layouts:
        source = reader.frames(key)
    else:
        array = reader.arrays[key]
        source = iter(array if array.ndim == 3 else [array] * len(reader.stamp))
    for image in source:
        exact = image.dtype.str[1:] in _CARRIED_BY_IMAGES[key]
        if key == 'amplitude' and not exact:
            image = np.clip(np.nan_to_num(image), 0, 65535).astype(np.uint16)
        yield image if exact or key == 'amplitude' else image.astype(np.float32)
