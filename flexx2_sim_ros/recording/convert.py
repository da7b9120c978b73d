"""Convert recordings from one file format to another."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
import itertools
from pathlib import Path

from flexx2_sim_ros.atomic import check_distinct, output_folder
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording.bag_writer import check_bag_name, SUFFIXES, write_bag
from flexx2_sim_ros.recording.calibration import WAY_OUT
from flexx2_sim_ros.recording.corrections import complete, Given
from flexx2_sim_ros.recording.image_folders import has_images, ImageRecording, mask_beside, views
from flexx2_sim_ros.recording.lerobot import Dataset, Episode, is_dataset
from flexx2_sim_ros.recording.npz import RecordingWriter
from flexx2_sim_ros.recording.opening import open_recording, recording_cameras
from flexx2_sim_ros.recording.other_archive import ARCHIVES, OtherArchive
from flexx2_sim_ros.recording.reader import RecordingReader
from flexx2_sim_ros.recording.tidying import tidy
import numpy as np

_CHUNK = 64
NOTHING = Given()

Progress = Callable[[str, float], None]


def convert(
    source: str | Path,
    target: str | Path,
    camera: str | None = None,
    storage: str = 'mcap',
    given: Given = NOTHING,
    progress: Progress = lambda text, share: None,
    processed: Callable[[RecordingReader], RecordingReader] = lambda reader: reader,
) -> list[tuple[RecordingReader, Path]]:
    """
    Write a recording in another format, without loss; return what was read and written.

    * `source`: as for `open_recording`, or what `ImageRecording`, `OtherArchive` (HDF5) or
      `Dataset` reads.
    * `target`: an ``.npz`` file (replaced if it exists), a ``.mcap`` or ``.db3`` file, or a folder
      for a bag. From a bag with several cameras, if none is chosen, ``out.npz`` becomes
      ``out_<camera>.npz`` for each.
    * `camera`: which one of the bag or data set; for another source, its name in the bag.
    * `storage`: ``mcap`` or ``sqlite3``, where the target is a folder.
    * `progress`: called with what is being done, and the fraction of it that is done.
    * `processed`: returns what is written of a recording.

    Raises InputError as what reads and writes, and `complete`.
    """
    source, target = Path(source), Path(target)
    check_distinct(source, target)
    if target.suffix not in ('.npz', *SUFFIXES):
        check_bag_name(target, 'an .npz, .mcap or .db3 file, or ')
    dataset = is_dataset(source)
    images = not dataset and has_images(source)
    lens = None if images or dataset else given.lens
    archive = source.suffix in ARCHIVES
    cameras = (
        []
        if images or archive or dataset
        else recording_cameras(source, given.infrared, lens is not None)
    )
    if camera is not None and target.suffix == '.npz' and (images or archive):
        raise InputError(
            f'--camera: must be left out where neither A nor B is a bag, got {shown(camera)}'
        )
    if camera is None and lens is not None and len(cameras) > 1:
        raise InputError(
            f'{given.of_lens[0]}: must come with --camera for a bag with several cameras '
            f'({", ".join(cameras)}), got none'
        )
    if camera is None and given.clean is None and len(cameras) > 1 and target.suffix == '.npz':
        paths = _path_by_camera(target, cameras)
        return [
            pair
            for name, path in paths.items()
            for pair in convert(source, path, name, storage, given, progress, processed)
        ]
    progress(f'reading {source.name}', 0.0)
    reader = complete(*_open(source, camera, given, images))
    _check_lens(reader)
    reader = processed(reader)
    written = partial(progress, f'writing {target.name}')
    if target.suffix == '.npz':
        write_npz(reader, target, written)
    else:
        # In a bag it selects a camera, also by a topic; a name has no slash at its start.
        from_bag = not images and not archive
        name = camera.strip('/') if camera and from_bag else camera
        name = None if dataset else name
        write_bag(reader, target, storage, name, written)
    return [(reader, target)]


def convert_views(
    source: Path,
    target: Path,
    given: Given,
    progress: Progress,
    processed: Callable[[RecordingReader], RecordingReader],
    camera: str | None = None,
) -> list[tuple[RecordingReader, Path]]:
    """
    Write each view in a folder, or episode of a data set, as a recording of its own.

    ``source`` is a folder of images, or of such folders (see `views`), or a LeRobot data set. The
    folder ``target`` gets an ``.npz`` file of the name of each. The rest, errors too, is as for
    `convert`.
    """
    found: dict[str, Callable[[], tuple[RecordingReader, Given]]]
    if is_dataset(source):
        if given.episode is not None:
            raise InputError(f'--episode: must be left out with --views, got {given.episode}')
        dataset = Dataset(source, camera)
        found = {
            f'episode_{one:06d}': partial(_episode, dataset, replace(given, episode=one))
            for one in dataset.episodes
        }
    else:
        found = {
            name: partial(_open, folder, None, given, images=True, view=file)
            for name, (folder, file) in views(source).items()
        }
    if not found:
        raise InputError(
            f'--views: must come with a folder of images or a data set, got {shown_path(source)}'
        )
    out = []
    for number, (name, opened) in enumerate(found.items()):
        progress(f'writing {name}.npz', number / len(found))
        reader = complete(*opened())
        _check_lens(reader)
        path = output_folder(target) / f'{name}.npz'
        write_npz(processed(reader), path)
        out.append((reader, path))
    return out


def _open(
    source: Path, camera: str | None, given: Given, images: bool, view: Path | None = None
) -> tuple[RecordingReader, Given]:
    dataset = is_dataset(source)
    for option in ('clean', 'infrared'):
        value = getattr(given, option)
        if value is not None and (images or dataset or source.suffix in ARCHIVES):
            raise InputError(f'--{option}: must be left out where A is no bag, got {shown(value)}')
    if dataset:
        return _episode(Dataset(source, camera), given)
    if given.episode is not None:
        raise InputError(f'--episode: must come with a LeRobot data set, got {shown_path(source)}')
    if images:
        if given.keys:
            raise InputError('--key: must be left out for images, got some')
        return tidy(ImageRecording(source, given, view), given.unit is None), replace(
            given, mask=given.mask or mask_beside(source)
        )
    if source.suffix in ARCHIVES:
        if given.of_files or given.of_lens or source.suffix != '.npz':
            return tidy(OtherArchive(source, given), given.unit is None), given
        return open_recording(source), given
    if given.of_files:
        raise InputError(
            f'{given.of_files[0]}: must be left out for a bag, whose messages say it, got some'
        )
    return open_recording(
        source,
        camera,
        clean=given.clean,
        infrared=given.infrared,
        lens=given.lens,
        rectified=given.rectified,
    ), given


def _episode(dataset: Dataset, given: Given) -> tuple[RecordingReader, Given]:
    if given.keys:
        raise InputError('--key: must be left out for a LeRobot data set, got some')
    reader = Episode(dataset, given)
    return tidy(reader, given.unit is None and dataset.depth.kind != 'video'), given


def _check_lens(reader: RecordingReader) -> None:
    try:
        Intrinsics.from_matrix(reader.K, *reader.shape[:0:-1], reader.distortion)
    except InputError as error:
        raise InputError(f'{reader.path}: {error}; {WAY_OUT}') from error


def _path_by_camera(target: Path, cameras: list[str]) -> dict[str, Path]:
    cameras_by_path: dict[Path, list[str]] = {}
    for name in cameras:
        path = target.with_stem(f'{target.stem}_{name.replace("/", "_")}')
        cameras_by_path.setdefault(path, []).append(name)
    for path, names in cameras_by_path.items():
        if len(names) > 1:
            raise InputError(
                f'--camera: must be one of {", ".join(names)}, whose file would be {path} each, '
                'got none'
            )
    return {names[0]: path for path, names in cameras_by_path.items()}


def write_npz(
    reader: RecordingReader, path: Path, progress: Callable[[float], None] = lambda share: None
) -> None:
    """
    Write a recording as a NumPy archive, which appears when it is complete.

    It replaces a file of that name. ``progress`` is called with the fraction of all images that
    are written.
    """
    done, total = itertools.count(1), len(reader.layouts) * len(reader.stamp)

    def images(key: str) -> Iterator[np.ndarray]:
        for image in reader.frames(key):
            yield image
            progress(next(done) / total)

    with RecordingWriter(path, *reader.shape) as writer:
        for block in _blocks(images('depth')):
            writer.add_depth(block)
        for key, layout in reader.layouts.items():
            if key != 'depth':
                writer.add_frames(key, layout.dtype, images(key))
        for key, array in reader.arrays.items():
            writer.add_array(key, array)


def _blocks(frames: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    while block := list(itertools.islice(frames, _CHUNK)):
        yield np.stack(block)
