"""Find recordings, and open one of any file format; those in NumPy archives are read here."""

from collections.abc import Iterator
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.calibration import Calibration
from flexx2_sim_ros.recording.corrections import in_metres
from flexx2_sim_ros.recording.reader import Content, Layout, Recording, RecordingReader, STACKS
from flexx2_sim_ros.recording.tidying import tidy
import numpy as np

_ROS2_FILES = ('.mcap', '.db3')
BAG_FILES = (*_ROS2_FILES, '.bag')


def find_recordings(folder: str | Path) -> list[Path]:
    """
    List the recordings in a folder: ``.npz`` files and bags (folders, or files of bags).

    Files of bags end in ``.mcap``, ``.db3`` or ``.bag``. Recordings are sorted by name; at least
    one. Unreadable folders are included, so that opening them gives the reason; hidden files are
    not. Raises InputError when there is no such folder or no recording in it, or it cannot be
    read.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            got = 'a file' if folder.exists() else 'none'
            raise InputError(
                f'{folder}: must be a folder with recordings (.npz or bags), got {got}'
            )
        found = sorted(
            path
            for path in folder.iterdir()
            if not path.name.startswith('.')
            and (path.suffix in ('.npz', *BAG_FILES) or is_bag(path))
        )
    except OSError as error:
        raise InputError(f'{folder}: cannot be read: {error}') from error
    if not found:
        raise InputError(f'{folder}: must have recordings (.npz files or bags), got none')
    return found


def has_bag_files(folder: Path) -> bool:
    """Return whether a folder has files of a rosbag2 bag, also compressed ones."""
    return any(file.name.removesuffix('.zstd').endswith(_ROS2_FILES) for file in folder.iterdir())


def is_bag(path: Path) -> bool:
    """Return whether a path is a folder that is a rosbag2 bag or cannot be read."""
    if not path.is_dir():
        return False
    try:
        return any(p.suffix in _ROS2_FILES or p.name == 'metadata.yaml' for p in path.iterdir())
    except OSError:
        return True


class NpzRecording(RecordingReader):
    """
    An ``.npz`` recording; nothing in the file is unpickled.

    ``profile`` is as for `open_recording`. Raises InputError when the file cannot be read, or is
    not a recording.
    """

    def __init__(self, path: Path, profile: Profile | None = None) -> None:
        """Read everything except the stacks."""
        # Stacks whose frames are not contiguous.
        self._loaded: dict[str, np.ndarray] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._whole = False  # Whether depth is whole millimetres in the file.
        content = self._read(path)
        if 'depth' not in content.layouts or 0 in self._shapes['depth']:
            raise InputError(
                f'{path}: depth: must be (T, H, W) float32, not empty, '
                f'got {self._found_depth(content)}'
            )
        content.frames = self._shapes['depth'][0]
        depth = content.layouts['depth']
        if depth.dtype != np.float32:
            self._whole = depth.dtype.kind in 'iu'
            how = 'taken for millimetres, 0 for invalid' if self._whole else 'rounded to float32'
            content.notes.append(f'{path}: depth: {depth.dtype} is {how}')
            content.layouts['depth'] = Layout(np.dtype(np.float32), depth.shape)
        super().__init__(path, None, content, profile)
        for key, shape in self._shapes.items():
            if shape != self.shape:
                raise InputError(
                    f'{path}: {key}: must have shape {self.shape}, one image for each of '
                    f'stamp, got {shape}'
                )

    def _read(self, path: Path) -> Content:
        content = Content({}, {})
        with open_npz(path) as archive:
            for key, header in archive.headers.items():
                if key in STACKS and len(header.shape) == 3 and header.dtype.kind in 'fiu':
                    self._shapes[key] = header.shape
                    content.layouts[key] = Layout(header.dtype.newbyteorder('='), header.shape[1:])
                    if header.fortran:
                        self._loaded[key] = archive.read(key)
                elif key == 'depth' and len(header.shape) == 2 and header.dtype.kind in 'fiu':
                    self._loaded[key] = archive.read(key)[None]  # A single frame.
                    self._shapes[key] = (1, *header.shape)
                    content.layouts[key] = Layout(header.dtype.newbyteorder('='), header.shape)
                else:
                    content.arrays[key] = archive.read(key)
        return content

    def _found_depth(self, content: Content) -> str:
        if 'depth' in self._shapes:
            return f'shape {self._shapes["depth"]}'
        if 'depth' in content.arrays:
            found = content.arrays['depth']
            return f'shape {found.shape} of {found.dtype}'
        return f'none; the file has {", ".join(content.arrays) or "nothing"}'

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        dtype = self.layouts[key].dtype
        for image in self._stored(key):
            if key == 'depth' and self._whole:
                yield in_metres(image)
            else:
                yield image.astype(dtype, copy=False)

    def _stored(self, key: str) -> Iterator[np.ndarray]:
        if key in self._loaded:
            yield from self._loaded[key]
            return
        with open_npz(self.path) as archive:
            header = archive.headers.get(key)
            if header is None or header.shape != self._shapes[key]:
                raise InputError(f'{self.path}: {key}: has changed since the file was opened')
            yield from archive.images(key)


def open_recording(
    path: str | Path,
    camera: str | None = None,
    profile: Profile | None = None,
    clean: str | None = None,
    infrared: str | None = None,
    lens: Calibration | None = None,
    rectified: bool | None = None,
) -> RecordingReader:
    """
    Open a recording without reading all its frames.

    Frames are sorted by stamp, and repeated ones left out; depth is in metres (`tidy`).

    Parameters
    ----------
    path : str or pathlib.Path
        An ``.npz`` recording, or a bag: a folder, or a single ``.mcap`` or ``.db3`` file, or a
        ``.bag`` file of ROS 1, of this package's nodes or of a camera's driver (pmd-royale-ros,
        pico_flexx_driver, realsense-ros, Azure Kinect). A bag that was cut off is read as far as
        it is whole; `RecordingReader.notes` says how far that is.
    camera : str, optional
        Which camera of a bag that has several: its name (`recording_cameras` lists them) or the
        topic of any depth image, with its camera_info beside it.
    profile : Profile, optional
        The camera whose modes give the rate of a file without stamps. Default: the Flexx2.
    clean : str, optional
        The topic of a bag's clean depth images, if it is not ``clean/depth_image``.
    infrared : str, optional
        The topic of the camera's infrared image in a bag, where the bag does not tell.
    lens : Calibration, optional
        The lens of a bag's camera, instead of that of its camera info.
    rectified : bool, optional
        Whether the depth images of a bag are rectified; left out, those of a topic ``image_rect``
        are.

    Raises
    ------
    InputError
        When there is no such file, or it is not a recording; the message names file and field.

    """
    path = Path(path)
    try:
        if path.suffix == '.npz':
            return tidy(NpzRecording(path, profile))
        # Bags need the library rosbags, .npz files do not.
        from flexx2_sim_ros.recording.bags import BagRecording

        return tidy(BagRecording(path, camera, profile, clean, infrared, lens, rectified))
    except OSError as error:
        raise InputError(f'{path}: cannot be read: {error.strerror or error}') from error


def load_recording(path: str | Path, camera: str | None = None) -> Recording:
    """
    Read a whole recording into memory; for long ones, use ``open_recording(path).chunks()``.

    Parameters
    ----------
    path, camera
        As for `open_recording`.

    Raises
    ------
    InputError
        As `open_recording`, and when a frame cannot be read.

    """
    return open_recording(path, camera).load()


def recording_cameras(
    path: str | Path, infrared: str | None = None, lens: bool = False
) -> list[str]:
    """
    Return the names of a bag's cameras; an empty list for an ``.npz``, which has one.

    With `lens`, depth images need no camera info.
    """
    if Path(path).suffix == '.npz':
        return []
    from flexx2_sim_ros.recording.bag_choice import survey_bag
    from flexx2_sim_ros.recording.bag_files import Bag

    return list(survey_bag(Bag(path), infrared, lens=lens).cameras)
