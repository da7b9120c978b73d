"""`flexx2 convert`: recordings of all kinds into NumPy archives and bags."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from flexx2_sim_ros.cli.common import call, messages, print_lines, progress_bar
from flexx2_sim_ros.cli.options import number, whole_number
from flexx2_sim_ros.errors import InputError, shown

OPTIONS = """
Convert a recording to another format, without loss. A and B are .npz recordings
or rosbag2 bags: a folder, or a single .mcap or .db3 file. A can also be a .bag
file of ROS 1, a folder of 16-bit PNG or TIFF files or one of them, or an .npz
or HDF5 file of another program, or a LeRobot data set. Bags of pmd-royale-ros,
pico_flexx_driver, realsense-ros and Azure Kinect work without options. A
damaged bag is read up to the damage. From a bag with several cameras, B.npz
becomes B_<camera>.npz for each camera.

source A: recording to read
target B: recording to write: a name that ends in .npz, .mcap or .db3, or a new folder
--camera CAMERA: from a bag: which camera, by its name or by the topic of its depth image; from a
    LeRobot data set: which feature; else to a bag: name of the camera
--episode N: from a LeRobot data set: which episode (--views: all)
--storage mcap|sqlite3: format of a bag in a folder (default %(default)s)
--process FILE: process the depth: a YAML file of stages (docs/recordings.md)
--usecase MODE: the camera's mode, if A does not say
--profile NAME: the camera, which must have the mode: a shipped profile or the path of one
    (default: the mode may be that of any camera)
--calibration FILE: the lens, if A does not say it or is wrong: a file of camera_calibration,
    OpenCV, Open3D, librealsense, Azure Kinect or Kalibr, an echoed camera info, or 3 x 3 numbers
    (default for images: the only YAML file in the folder)
--intrinsics FX FY CX CY: the lens in pixels, without distortion, instead of --calibration
--rectified: depth of A is rectified: it has the projection matrix P of the camera info or
    calibration, and no distortion (default: only for a topic image_rect)
--infrared TOPIC: from a bag: the topic of the infrared image of the camera, if A does not say
--radial: depth of A is measured along the ray of each pixel: convert it to depth along the optical
    axis
--views: A is a folder of images, or of such folders, or a LeRobot data set, and each image, folder
    or episode a recording of its own: B is a folder, which gets an .npz for each
--mask FILE: PNG of the size of the images: the ground truth of its black pixels is unknown
    (default: mask.png in a folder of images)
--clean TOPIC: from a bag: the topic of the clean depth images, if it has another name than
    clean/depth_image
--partial-truth: NaN in clean_depth means unknown ground truth (default: no return)
--unit METRES: for images and other .npz: metres per unit of depth (default 0.001; 1 for
    floating-point numbers)
--rate HZ: frames per second, if A has no stamps (default: that of the mode, or 30)
--key NAME=OTHER: for other .npz and HDF5: read the key NAME from OTHER in A; may be repeated

examples:
  flexx2 convert walk walk.npz --camera front_left
  flexx2 convert pico_flexx.bag wall.npz --usecase MODE_9_5FPS_2000
  flexx2 convert realsense_bag wall.npz --usecase depth
  flexx2 convert images/ wall.npz --usecase NFOV_unbinned_30fps --rate 15
  flexx2 convert boards/ views/ --views --usecase depth_30fps
  flexx2 convert no_camera_info wall.npz --intrinsics 210.6 212.9 111.5 85.5
  flexx2 convert frame.png frame.npz --unit 0.0002 --mask known.png
  flexx2 convert demos.hdf5 a.npz --key depth=data/demo_0/obs/front_depth
  flexx2 convert my_set a.npz --episode 3 --intrinsics 380 380 320 240
  flexx2 convert sdk.npz wall.npz --key depth=depth_mm --key amplitude=ir16
"""
VALUES = {
    'storage': 'mcap',
    'calibration': Path,
    'intrinsics': number(-1e6, 1e6),
    'rectified': {'action': argparse.BooleanOptionalAction},
    'process': Path,
    'mask': Path,
    'unit': number(0, 1000, above=True),
    'rate': number(0, 1e6, above=True),
    'key': {'action': 'append', 'default': []},
    'episode': whole_number(0, 10**9),
}


def _keys(pairs: list[str]) -> dict[str, str]:
    keys: dict[str, str] = {}
    for pair in pairs:
        name, sign, other = pair.partition('=')
        if not (name.isidentifier() and sign and other) or name in keys:
            raise InputError(
                f'--key: must be NAME=OTHER, each NAME once, as depth=depth_mm, got {shown(pair)}'
            )
        keys[name] = other
    return keys


def run(arguments: argparse.Namespace) -> int:
    """Convert with a progress bar, and print what was converted."""
    from flexx2_sim_ros.processing import Chain, load_chain
    from flexx2_sim_ros.processing.processed_recording import ProcessedRecording
    from flexx2_sim_ros.recording.convert import convert, convert_views
    from flexx2_sim_ros.recording.corrections import Given

    given = call(Given, arguments, rate_hz=arguments.rate, keys=_keys(arguments.key))
    chain = Chain(()) if arguments.process is None else load_chain(arguments.process)
    console = messages(soft_wrap=True)
    with progress_bar(console) as progress:
        processed: Callable[[Any], Any] = (
            partial(ProcessedRecording, chain=chain) if chain.stages else lambda one: one
        )
        if arguments.views:
            paths = Path(arguments.source), Path(arguments.target)
            written = convert_views(*paths, given, progress, processed, arguments.camera)
        else:
            written = call(convert, arguments, given=given, progress=progress, processed=processed)
    notes = dict.fromkeys(note for reader, _ in written for note in reader.notes)
    print_lines(console, notes, 'yellow')
    print_lines(console, (_about(*one) for one in written))
    return 0


def _about(reader: Any, path: Path) -> str:
    count, height, width = reader.shape
    camera = f' of {reader.camera}' if reader.camera else ''
    mode = reader.usecase or 'unknown mode'
    return f'{path}: {count} frames{camera}, {width} x {height}, {mode}'
