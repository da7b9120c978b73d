"""Open a recording of any file format."""

from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.calibration import Calibration
from flexx2_sim_ros.recording.npz_recording import NpzRecording
from flexx2_sim_ros.recording.reader import Recording, RecordingReader
from flexx2_sim_ros.recording.tidying import tidy


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

    Returns
    -------
    RecordingReader

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
    Read a whole recording into memory.

    For long recordings, use ``open_recording(path).chunks()``.

    Parameters
    ----------
    path, camera
        As for `open_recording`.

    Returns
    -------
    Recording

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
