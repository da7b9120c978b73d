"""Convert recordings from one file format to another."""

from collections.abc import Iterator
import itertools
from pathlib import Path

from flexx2_sim_ros.atomic import check_distinct
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.bag_writer import write_bag
from flexx2_sim_ros.recording.npz import RecordingWriter
from flexx2_sim_ros.recording.opening import open_recording, recording_cameras
from flexx2_sim_ros.recording.reader import RecordingReader
import numpy as np

_CHUNK = 64


def convert(
    source: str | Path, target: str | Path, camera: str | None = None, storage: str = 'mcap'
) -> list[tuple[RecordingReader, Path]]:
    """
    Write a recording in another format, without loss and in bounded memory.

    Parameters
    ----------
    source : str or pathlib.Path
        As for `open_recording`.
    target : str or pathlib.Path
        An ``.npz`` file (replaced if it exists), a ``.mcap`` or ``.db3`` file, or a folder for a
        bag. From a bag with several cameras, if none is chosen, ``out.npz`` becomes
        ``out_<camera>.npz`` for each.
    camera : str, optional
        Which camera of the bag; for an ``.npz`` source, its name in the bag.
    storage : str
        ``mcap`` or ``sqlite3``, if the target is a folder.

    Returns
    -------
    list of (RecordingReader, pathlib.Path)
        What was read and where it was written.

    Raises
    ------
    InputError
        As `open_recording` and `write_bag`.

    """
    source, target = Path(source), Path(target)
    check_distinct(source, target)
    cameras = recording_cameras(source)
    if camera is None and len(cameras) > 1 and target.suffix == '.npz':
        paths = _path_by_camera(target, cameras)
        return [
            pair for name, path in paths.items() for pair in convert(source, path, name, storage)
        ]
    reader = open_recording(source, None if source.suffix == '.npz' else camera)
    if target.suffix == '.npz':
        write_npz(reader, target)
    else:
        write_bag(reader, target, storage, camera)
    return [(reader, target)]


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


def write_npz(reader: RecordingReader, path: Path) -> None:
    """
    Write a recording as a NumPy archive.

    Parameters
    ----------
    reader : RecordingReader
        What to write.
    path : pathlib.Path
        The file; it appears when it is complete, and replaces one of that name.

    """
    with RecordingWriter(path, *reader.shape) as writer:
        for block in _blocks(reader.frames('depth')):
            writer.add_depth(block)
        for key, layout in reader.layouts.items():
            if key != 'depth':
                writer.add_frames(key, layout.dtype, reader.frames(key))
        for key, array in reader.arrays.items():
            writer.add_array(key, array)


def _blocks(frames: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    while block := list(itertools.islice(frames, _CHUNK)):
        yield np.stack(block)
