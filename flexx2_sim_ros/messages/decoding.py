"""
Decode messages into arrays and values.

Nothing here imports ROS: the functions take messages (or anything with their fields) and raise
`InputError` for messages that cannot be used.
"""

from collections.abc import Iterable
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.profiles.intrinsics import DISTORTION_MODELS, full_distortion
import numpy as np

# dtype kind and size, and metres a unit (REP-118: 32FC1 in metres, 16UC1 in millimetres).
_ENCODINGS = {
    '32FC1': ('f4', 1.0),
    '64FC1': ('f8', 1.0),
    '16UC1': ('u2', 0.001),
    'mono16': ('u2', 1.0),
    '8UC1': ('u1', 1.0),
    'mono8': ('u1', 1.0),
}
NO_DEPTH = 65535  # of 16 bits: what some drivers write where there is no depth
_NANOSECONDS = 1_000_000_000
_LARGEST_SIDE = 1 << 14
_FISHEYES = ('equidistant', 'fisheye', 'equi', 'kannala_brandt', 'kannala_brandt4')
# As plumb_bob: of librealsense ("inverse" and "modified" are others), and of Kalibr.
_PLUMB_BOBS = ('brown_conrady', 'radtan')


def stamp_nanoseconds(stamp: Any) -> int:
    """Return a ``builtin_interfaces/Time`` as whole nanoseconds."""
    return int(stamp.sec) * _NANOSECONDS + int(stamp.nanosec)


def check_stamp(stamp: Any, field: str) -> None:
    """Refuse a ``builtin_interfaces/Time`` that is out of range."""
    if not 0 <= stamp.nanosec < _NANOSECONDS:
        raise InputError(
            f'{field}: header.stamp: must be less than {_NANOSECONDS}, got nanosec {stamp.nanosec}'
        )


def decode_image(message: Any, field: str, encodings: tuple[str, ...]) -> np.ndarray:
    """
    Decode a single-channel ``sensor_msgs/Image`` to (height, width) float32, C-contiguous.

    It is metres for depth (16UC1 is in millimetres, and its largest value becomes NaN: no depth),
    and may share the message's memory. Rows may be padded, bytes of either order. ``field`` is
    what to call the message in errors, e.g. its topic; ``encodings`` are which of 32FC1, 64FC1 and
    16UC1 to accept. Raises InputError when encoding, size, step or data length do not fit.
    """
    raw = image_pixels(message, field, encodings)
    _, unit = _ENCODINGS[message.encoding]
    # A double beyond the range of float32 becomes infinite: no return.
    with np.errstate(over='ignore', invalid='ignore'):
        image = np.ascontiguousarray(raw, dtype=np.float32)
    if unit == 1.0:
        return image
    return np.where(image == NO_DEPTH, np.float32(np.nan), image * np.float32(unit))


def image_pixels(message: Any, field: str, encodings: tuple[str, ...]) -> np.ndarray:
    """
    Return the pixels of a single-channel ``sensor_msgs/Image`` without conversion.

    They are (height, width) of the encoding's dtype and the message's byte order, a view of the
    message's memory. ``encodings`` are which of 32FC1, 64FC1, 16UC1, mono16, 8UC1 and mono8 to
    accept; the rest is as for `decode_image`.
    """
    if message.encoding not in encodings:
        raise InputError(
            f'{field}: encoding: must be {" or ".join(encodings)}, got {shown(message.encoding)}'
        )
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not (1 <= height <= _LARGEST_SIDE and 1 <= width <= _LARGEST_SIDE):
        raise InputError(
            f'{field}: size: must be 1 x 1 to {_LARGEST_SIDE} x {_LARGEST_SIDE} pixels, got '
            f'{width} x {height}'
        )
    kind, _ = _ENCODINGS[message.encoding]
    dtype = np.dtype(('>' if message.is_bigendian else '<') + kind)
    if step < width * dtype.itemsize:
        raise InputError(
            f'{field}: step: must be at least {width * dtype.itemsize} bytes for {width} '
            f'pixels of {message.encoding}, got {step}'
        )
    if len(message.data) != step * height:
        raise InputError(
            f'{field}: data: must be {step * height} bytes ({height} rows of step {step}), '
            f'got {len(message.data)}'
        )
    return np.ndarray((height, width), dtype, message.data, strides=(step, dtype.itemsize))


def decode_distortion(
    model: str, coefficients: Iterable[float], field: str = 'camera_info'
) -> tuple[float, ...]:
    """
    Return the distortion of a camera info or a calibration file, as `Intrinsics.distortion`.

    ``model`` is ``plumb_bob`` (or another name of it) or ``rational_polynomial``; any other if all
    coefficients are 0: then five zeros are returned. Zeros at the end of the coefficients may be
    left out. ``field`` is what to call the message or file in errors. Raises InputError for
    another model, or too many coefficients.
    """
    given = [float(value) for value in coefficients]
    if _simple(model) in _PLUMB_BOBS:
        model = 'plumb_bob'
    if any(given) and model not in DISTORTION_MODELS.values():
        raise InputError(
            f'{field}: distortion_model: must be {" or ".join(DISTORTION_MODELS.values())}, or no '
            f'distortion, got {shown(model)} with coefficients {shown(given)}'
        )
    while given and not given[-1]:  # Zeros at the end are no distortion, however many.
        given.pop()
    most = max((size for size, name in DISTORTION_MODELS.items() if name == model), default=0)
    if len(given) > most:
        raise InputError(
            f'{field}: distortion: must have at most {most} coefficients ({model}), got '
            f'{len(given)}'
        )
    return full_distortion(given)


def is_fisheye(model: str) -> bool:
    """Say whether a distortion model is that of a fisheye lens."""
    return _simple(model) in _FISHEYES


def _simple(model: str) -> str:
    return model.strip().lower().replace(' ', '_').replace('-', '_')


def little_endian_bytes(array: np.ndarray) -> memoryview:
    """Return an array's bytes in little-endian order, without a copy where possible."""
    if sys.byteorder == 'big':
        array = array.astype(array.dtype.newbyteorder('<'))
    return np.ascontiguousarray(array).data.cast('B')
