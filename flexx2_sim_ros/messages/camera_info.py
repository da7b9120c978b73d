"""
What a camera info says of the pixels of an image.

By ``sensor_msgs/CameraInfo``, size, K and P are those of the full sensor, binning and region of
interest say which part of it the image is, and a rectified image has P and no distortion. Drivers
differ from this; what is taken otherwise is said in notes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.messages.compressed_depth import SUFFIX
from flexx2_sim_ros.messages.decoding import decode_distortion, is_fisheye
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

_RECTIFIED = 'image_rect'  # what image_proc publishes; image_rect_raw is the sensor's own image
# Of a sensor's diagonal: no lens is so far off its middle. Assumed; lenses are within 0.03.
_OFF_CENTRE = 0.06
_AS_IMAGE = 'K: taken for that of the image: binning and roi do not fit it'


@dataclass(frozen=True)
class Region:
    """The fields of a ``sensor_msgs/RegionOfInterest``; zeros for the whole sensor."""

    x_offset: int = 0
    y_offset: int = 0
    height: int = 0
    width: int = 0


@dataclass(frozen=True)
class CameraFields:
    """The fields of a ``sensor_msgs/CameraInfo`` that say what the camera is."""

    height: int
    width: int
    k: Sequence[float]
    d: Sequence[float] = ()
    distortion_model: str = 'plumb_bob'
    p: Sequence[float] = (0.0,) * 12
    binning_x: int = 0
    binning_y: int = 0
    roi: Region = Region()


def is_rectified(topic: str) -> bool:
    """Say whether the name of an image's topic says that it is rectified."""
    return topic.removesuffix(SUFFIX).rpartition('/')[2] == _RECTIFIED


def decode_camera_info(
    message: Any,
    field: str = 'camera_info',
    size: tuple[int, int] | None = None,
    rectified: bool = False,
    notes: list[str] | None = None,
) -> Intrinsics:
    """
    Decode a ``sensor_msgs/CameraInfo``, or `CameraFields`, as the intrinsics of an image.

    ``size``, height and width of the image, tells whether the camera info is that of the full
    sensor. Where it does not fit, the result has the size in the message. ``field`` is what to
    call the message in errors. What was taken otherwise than the fields say is added to ``notes``.
    Raises InputError when it cannot be a pinhole camera with plumb_bob or rational_polynomial
    distortion.
    """
    said: list[str] = []
    try:
        matrix, distortion = _pinhole(message, field, rectified, said)
        own = int(message.height), int(message.width)
        matrix, own = _of_image(message, matrix, own, size, said)
        camera = Intrinsics.from_matrix(matrix, own[1], own[0], distortion)
    except InputError as error:
        text = str(error)
        if rectified and _projection(message).any():
            text = text.replace('K: ', 'P: ', 1)
        raise InputError(text if text.startswith(field) else f'{field}: {text}') from error
    if notes is not None:
        notes.extend(f'{field}: {note}' for note in said)
    return camera


def image_sizes(message: Any) -> tuple[tuple[int, int], ...]:
    """Return (height, width) of the images that a camera info can be of."""
    own = int(message.height), int(message.width)
    part, fits = _part(message, own)
    return (own, part) if fits else (own,)


def with_size(message: Any, size: tuple[int, int]) -> Any:
    """Return a camera info whose driver leaves the size out with that of the image."""
    if message.height and message.width:
        return message
    return replace(message, height=size[0], width=size[1])


def size_words(message: Any) -> str:
    """Return the size in a camera info, with its binning and region, as words."""
    words = f'{message.width} x {message.height}'
    if max(message.binning_x, message.binning_y) > 1:
        words += f' with binning {message.binning_x} x {message.binning_y}'
    roi = message.roi
    if roi.x_offset or roi.y_offset or roi.width or roi.height:
        words += f' with roi {roi.width} x {roi.height} at {roi.x_offset}, {roi.y_offset}'
    return words


def _pinhole(
    message: Any, field: str, rectified: bool, notes: list[str]
) -> tuple[np.ndarray, tuple[float, ...]]:
    # The matrix and the distortion of the image's lens.
    matrix = np.array(message.k, np.float64)
    distorted = any(message.d)
    if rectified:
        projection = _projection(message)
        if projection.any():
            return projection, ()
        if distorted:
            raise InputError('P: must be the matrix of the rectified image, got zeros')
    if matrix[0] in (0.0, 1.0) and not distorted:
        unit = np.array_equal(matrix, np.eye(3).ravel())
        projection = _projection(message)
        if (unit or not matrix.any()) and projection.any():
            kind = 'the unit matrix is' if unit else 'zeros are'
            notes.append(f'K: {kind} no calibration: P is used')
            return projection, ()
    if is_fisheye(message.distortion_model):
        notes.append(
            f'distortion_model: {shown(message.distortion_model)} without coefficients: taken for '
            'a lens without distortion'
        )
    return matrix, decode_distortion(message.distortion_model, message.d, field)


def _projection(message: Any) -> np.ndarray:
    # K of the rectified image; zeros for none.
    projection = np.array(message.p, np.float64)
    return projection.reshape(3, 4)[:, :3] if projection.size == 12 else np.zeros((3, 3))


def _is_whole(message: Any) -> bool:
    roi = message.roi
    return max(message.binning_x, message.binning_y) <= 1 and not (
        roi.x_offset or roi.y_offset or roi.width or roi.height
    )


def _part(message: Any, own: tuple[int, int]) -> tuple[tuple[int, int], bool]:
    # (height, width) of the part of a sensor, and whether it is another image than the sensor's.
    offset, binning = _offset(message), _binning(message)
    roi = message.roi
    region = np.array([roi.height or own[0], roi.width or own[1]])
    part = tuple(int(side) for side in region // binning)
    inside = bool((offset + region <= own).all()) and min(part) > 0
    return (part[0], part[1]), inside and part != own


def _offset(message: Any) -> np.ndarray:
    return np.array([message.roi.y_offset, message.roi.x_offset], np.int64)


def _binning(message: Any) -> np.ndarray:
    return np.array([max(message.binning_y, 1), max(message.binning_x, 1)], np.int64)


def _of_image(
    message: Any,
    matrix: np.ndarray,
    own: tuple[int, int],
    size: tuple[int, int] | None,
    notes: list[str],
) -> tuple[np.ndarray, tuple[int, int]]:
    # The matrix of the image, and its size. The size says whether that of the message is the
    # sensor's or the image's; so does the principal point for K, as it is near the middle of the
    # sensor. In doubt, the fields mean what they should.
    if _is_whole(message):
        return matrix, own
    part, fits = _part(message, own)
    binning, offset = _binning(message), _offset(message)
    if fits and size in (None, part):
        sensor = np.array(own)
    elif size == own and (binning > 1).any() and not offset.any():
        part, sensor = own, np.array(own) * binning
    else:
        if size == own and (offset.any() or part != own):
            notes.append(_AS_IMAGE)
        return matrix, own
    moved = np.reshape(matrix, (3, 3)).copy()
    centre = moved[1::-1, 2]
    as_sensor = np.linalg.norm(centre - (sensor - 1) / 2)
    as_image = np.linalg.norm((centre + 0.5) * binning - 0.5 + offset - (sensor - 1) / 2)
    if as_sensor > _OFF_CENTRE * np.linalg.norm(sensor) and as_image < as_sensor / 3:
        notes.append(_AS_IMAGE)
        return matrix, part
    notes.append('K: of the full sensor: converted to the image by binning and roi')
    moved[0, :2] /= binning[1]
    moved[1, :2] /= binning[0]
    moved[1::-1, 2] = (centre - offset + 0.5) / binning - 0.5
    return moved, part
