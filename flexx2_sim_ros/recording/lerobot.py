"""Episodes of LeRobot data sets (v2 and v3) that have depth, as recordings."""

from collections.abc import Iterator
from dataclasses import dataclass, field
import json
from pathlib import Path
import re
from typing import Any

from flexx2_sim_ros.config_file import is_regular_file, read_bytes
from flexx2_sim_ros.errors import InputError, one_sentence, shown, shown_path, unquoted
from flexx2_sim_ros.png import decode_gray, MOST_PIXELS, read_gray
from flexx2_sim_ros.recording.corrections import Given, in_metres, MILLIMETRE
from flexx2_sim_ros.recording.depth_video import Coding, coding_of, depth_frames
from flexx2_sim_ros.recording.parquet import open_table
from flexx2_sim_ros.recording.reader import Content, Layout, RecordingReader
import numpy as np

_INFO = Path('meta') / 'info.json'
_MOST_BYTES = 4 << 20  # of that file; assumed
_MOST_EPISODES = 100_000  # in one table; assumed
_BITS = (16, 32)
_NUMBERS = re.compile('u?int(8|16|32|64)|float(16|32|64)')
_UNITS = {'m': 1.0, 'mm': MILLIMETRE}


def is_dataset(path: Path) -> bool:
    """Say whether a path is the folder of a LeRobot data set."""
    return is_regular_file(path / _INFO)


@dataclass(frozen=True)
class DepthFeature:
    """
    A feature of the data set that is depth.

    ``kind`` is the ``dtype``: ``image``, ``video``, or that of numbers in the table. ``size`` is
    height and width, ``info`` what the file says of its video and unit.
    """

    key: str
    kind: str
    size: tuple[int, int]
    info: dict[str, Any] = field(repr=False)


@dataclass(frozen=True)
class Place:
    """Where an episode lies: its table, and its video with the second at which it starts."""

    table: Path
    video: Path
    start: float


class Dataset:
    """
    A LeRobot data set, a folder, and its depth feature.

    ``camera`` is the feature: its key, or the last part of it; not needed if only one has depth.
    Raises InputError when ``meta/info.json`` or the tables of episodes cannot be read, or there is
    no such feature.
    """

    def __init__(self, root: Path, camera: str | None = None) -> None:
        """Read what the data set says of itself."""
        self.root, self._name = root, shown_path(root / _INFO)
        with one_sentence(f'{self._name}: cannot be read'):
            info = json.loads(read_bytes(root / _INFO, _MOST_BYTES))
        features = info.get('features') if isinstance(info, dict) else None
        if not isinstance(features, dict):
            raise InputError(f'{self._name}: features: must be a table, got {shown(features)}')
        version = str(info.get('codebase_version'))
        if not version.startswith(('v2.', 'v3.')):
            raise InputError(
                f'{self._name}: codebase_version: must be v2 or v3, got {unquoted(version)}'
            )
        self.depth = self._feature(features, camera)
        self.episodes = dict(sorted(self._v2() if version[1] == '2' else self._v3()))
        if not self.episodes:
            raise InputError(f'{shown_path(root)}: must have episodes, got none')

    def _feature(self, features: dict[str, Any], camera: str | None) -> DepthFeature:
        tables = {key: one for key, one in features.items() if isinstance(one, dict)}
        names = [key for key, one in tables.items() if _is_depth(key, one)]
        if camera is None and not names:
            raise InputError(
                f'{self._name}: features: must have one with depth in its name, or --camera must '
                f'name it, got {unquoted(", ".join(tables))}'
            )
        found = names
        if camera is not None:
            found = [key for key in tables if camera in (key, key.rpartition('.')[2])]
        if len(found) != 1:
            got = 'none' if camera is None else shown(camera)
            raise InputError(
                f'--camera: must be one of {unquoted(", ".join(names or tables), 300)}, got {got}'
            )
        key = found[0]
        where, kind = f'{self._name}: {unquoted(key)}', tables[key].get('dtype')
        if not isinstance(kind, str) or not (
            kind in ('image', 'video') or _NUMBERS.fullmatch(kind)
        ):
            raise InputError(f'{where}: dtype: must be image, video or numbers, got {shown(kind)}')
        if Path(key).name != key:
            raise InputError(f'{self._name}: features: must be names, got {shown(key)}')
        return DepthFeature(key, kind, _size(where, tables[key].get('shape')), _info(tables[key]))

    def _v2(self) -> Iterator[tuple[int, Place]]:
        for table in self.root.glob('data/chunk-*/episode_*.parquet'):
            if (digits := table.stem.removeprefix('episode_')).isdecimal():
                folder = self.root / 'videos' / table.parent.name / self.depth.key
                yield int(digits), Place(table, folder / f'{table.stem}.mp4', 0.0)

    def _v3(self) -> Iterator[tuple[int, Place]]:
        video = f'videos/{self.depth.key}/'
        ends = ('chunk_index', 'file_index')
        columns = ['episode_index', *(f'data/{end}' for end in ends)]
        if self.depth.kind == 'video':
            columns += [*(f'{video}{end}' for end in ends), f'{video}from_timestamp']
        for path in sorted(self.root.glob('meta/episodes/chunk-*/file-*.parquet')):
            with open_table(path, columns, _MOST_EPISODES) as file:
                for row in file.read(columns).to_pylist():
                    number, chunk, one, *of_video = (row[name] for name in columns)
                    in_video, at, start = of_video or (0, 0, 0.0)
                    yield (
                        int(number),
                        Place(
                            self.root / 'data' / f'chunk-{chunk:03d}' / f'file-{one:03d}.parquet',
                            self.root / video / f'chunk-{in_video:03d}' / f'file-{at:03d}.mp4',
                            float(start),
                        ),
                    )


class Episode(RecordingReader):
    """
    The depth of an episode, read image by image; needs pyarrow, and PyAV for videos.

    Of `given` the episode (needed unless there is only one), lens and unit (else as the data set
    says, else millimetres for whole numbers and metres) are used. Raises InputError when there is
    no such episode, no lens for it, or it cannot be read.
    """

    def __init__(self, dataset: Dataset, given: Given) -> None:
        """Read the stamps."""
        depth, known = dataset.depth, dataset.episodes
        number = (
            given.episode if given.episode is not None or len(known) > 1 else next(iter(known))
        )
        if number not in known:
            raise InputError(
                f'--episode: must be one of the {len(known)} from {min(known)} to {max(known)} '
                f'(or --views for all), got {"none" if number is None else number}'
            )
        if given.lens is None:
            raise InputError(
                '--intrinsics: must come with a LeRobot data set, which has no lens (or '
                '--calibration), got none'
            )
        self._dataset, self._number, self._place = dataset, number, known[number]
        notes: list[str] = []
        self._coding: Coding | None = None
        self._unit = given.unit or _UNITS.get(str(depth.info.get('depth_unit')))
        if depth.kind == 'video':
            self._coding = self._of_video(given, notes)
        lens = given.lens.intrinsics(depth.size, bool(given.rectified), notes)
        self._groups, stamps = self._rows()
        arrays = {
            'K': lens.matrix,
            'stamp': stamps,
            'camera': np.array(re.sub(r'\W', '_', depth.key.rpartition('.')[2], flags=re.ASCII)),
        }
        if any(lens.distortion):
            arrays['distortion'] = np.array(lens.distortion)
        layouts = {'depth': Layout(np.dtype(np.float32), depth.size)}
        super().__init__(dataset.root, depth.key, Content(layouts, arrays, notes))

    def _of_video(self, given: Given, notes: list[str]) -> Coding:
        where = f'{shown_path(self._dataset.root)}: {unquoted(self._dataset.depth.key)}'
        if given.unit is not None:
            raise InputError('--unit: must be left out for a video, which is in metres, got some')
        info = self._dataset.depth.info
        coding = coding_of(where, info)
        notes.append(
            f'{where}: a video of 12 bits: depth is in steps of {1000 * coding.step(1.0):.2g} mm '
            'at 1 m, and the nearest and farthest codes are invalid'
        )
        if 'lossless=1' not in str(info.get('video.extra_options')):
            notes.append(
                f'{where}: the video may be with loss, which looks like noise or a filter'
            )
        return coding

    def _rows(self) -> tuple[list[tuple[int, np.ndarray]], np.ndarray]:
        # The groups of rows that have some of the episode, which rows these are, and all stamps.
        columns, stamps = ['episode_index', 'timestamp'], []
        groups = []
        with open_table(self._place.table, columns) as file:
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, columns)
                own = table['episode_index'].to_numpy() == self._number
                if own.any():
                    groups.append((group, own))
                    stamps.append(table['timestamp'].to_numpy()[own].astype(np.float64))
        if not groups:
            raise InputError(
                f'{shown_path(self._place.table)}: must have episode {self._number}, got others'
            )
        return groups, np.concatenate(stamps)

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        depth = self._dataset.depth
        if self._coding is not None:
            times = self._place.start + self.arrays['stamp']
            yield from depth_frames(self._place.video, self._coding, times, depth.size)
            return
        for number, cell in enumerate(self._cells()):
            where = f'{shown_path(self._place.table)}: {unquoted(depth.key)}: image {number}'
            image = self._image(cell, number, where) if depth.kind == 'image' else _numbers(cell)
            if image.dtype.kind not in 'fiu' or image.size != np.prod(depth.size):
                raise InputError(
                    f'{where}: must be {depth.size[1]} x {depth.size[0]} numbers, got '
                    f'{image.size} of {image.dtype}'
                )
            yield in_metres(image.reshape(depth.size), self._unit)

    def _cells(self) -> Iterator[Any]:
        # What the table has in the episode's rows, each as an array of one value.
        key, path = self._dataset.depth.key, self._place.table
        with open_table(path, [key]) as file:
            for group, own in self._groups:
                batches = file.iter_batches(1, [group], [key])
                for wanted, batch in zip(own, batches, strict=True):
                    if wanted:
                        yield batch.column(batch.schema.get_field_index(key))

    def _image(self, cell: Any, number: int, where: str) -> np.ndarray:
        value = cell[0].as_py()
        content = value.get('bytes') if isinstance(value, dict) else value
        if isinstance(content, bytes):
            image = decode_gray(content, where, _BITS)
        else:
            image = read_gray(self._file(number, where), _BITS)
        if image.shape != self._dataset.depth.size:
            height, width = self._dataset.depth.size
            raise InputError(
                f'{where}: must be {width} x {height} pixels as in {_INFO}, got '
                f'{image.shape[1]} x {image.shape[0]}'
            )
        return image

    def _file(self, number: int, where: str) -> Path:
        folder = self._dataset.root / 'images' / self._dataset.depth.key
        for sign in '_-':  # v2, v3
            for end in ('png', 'tiff'):
                name = f'episode{sign}{self._number:06d}/frame{sign}{number:06d}.{end}'
                if (folder / name).is_file():
                    return folder / name
        raise InputError(f'{where}: must be an image, or {folder / name} a file, got neither')


def _is_depth(key: str, feature: dict[str, Any]) -> bool:
    info = _info(feature)
    marked = info.get('is_depth_map') or info.get('video.is_depth_map')
    return bool(marked) or 'depth' in key.rpartition('.')[2].lower()


def _info(feature: dict[str, Any]) -> dict[str, Any]:
    parts = (feature.get(name) for name in ('video_info', 'info'))
    return {key: value for part in parts if isinstance(part, dict) for key, value in part.items()}


def _size(where: str, shape: Any) -> tuple[int, int]:
    whole = isinstance(shape, list) and all(type(one) is int and one > 0 for one in shape)
    two = list(shape) if whole else []
    if len(two) == 3 and 1 in (two[0], two[2]):
        two = two[:2] if two[2] == 1 else two[1:]
    if len(two) != 2:
        raise InputError(f'{where}: shape: must be [H, W] or [H, W, 1], got {shown(shape)}')
    if two[0] * two[1] > MOST_PIXELS:
        raise InputError(
            f'{where}: shape: must be at most {MOST_PIXELS} pixels, got {shown(shape)}'
        )
    return two[0], two[1]


def _numbers(cell: Any) -> np.ndarray:
    while hasattr(cell.type, 'value_type'):  # lists of lists
        cell = cell.flatten()
    return np.asarray(cell.to_numpy(zero_copy_only=False))
