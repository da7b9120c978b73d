"""Messages of a bag: decoded and encoded without ROS."""

from functools import cache
import struct
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.messages.compressed_depth import decompress, SUFFIX
from flexx2_sim_ros.profiles.intrinsics import DISTORTION_MODELS
import numpy as np
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
POINT_CLOUD = 'sensor_msgs/msg/PointCloud2'
PARAMETER_EVENT = 'rcl_interfaces/msg/ParameterEvent'
BYTES = 'std_msgs/msg/UInt8MultiArray'
# Types of cameras and robots that begin with a std_msgs/Header.
STAMPED = frozenset(
    {
        IMAGE,
        COMPRESSED,
        CAMERA_INFO,
        POINT_CLOUD,
        'sensor_msgs/msg/JointState',
        'nav_msgs/msg/Odometry',
        'sensor_msgs/msg/Imu',
        'diagnostic_msgs/msg/DiagnosticArray',
    }
)

_NANOSECONDS = 1_000_000_000
_STRING_PARAMETER = 4
_PIXELS = {'f4': '32FC1', 'f8': '64FC1', 'u1': 'mono8', 'u2': 'mono16'}


@cache
def typestore() -> Typestore:
    """Return the message definitions of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def decode(kind: str, data: bytes, where: str) -> Any:
    """
    Return the values of a serialized message, CDR, of a type such as ``sensor_msgs/msg/Image``.

    ``where`` is what to call it in errors. Raises InputError when it is not of that type.
    """
    try:
        return typestore().deserialize_cdr(data, kind)
    except Exception as error:  # Wrong bytes can raise any error.
        raise InputError(f'{where}: cannot be decoded as {kind}: {shown(error)}') from error


def has_depth_pixels(topic: str, kind: str) -> bool:
    """Say whether messages of a topic are images that `decode_pixels` reads."""
    return kind == IMAGE or (kind == COMPRESSED and topic.endswith(SUFFIX))


def decode_pixels(kind: str, data: bytes, where: str) -> Any:
    """Return an image, also a compressed one; see `decode` and `decompress`."""
    message = decode(kind, data, where)
    return decompress(message, where) if kind == COMPRESSED else message


def header_stamp(data: bytes, where: str) -> int:
    """
    Return the stamp (nanoseconds) of a message that begins with a header, without decoding it.

    Raises InputError when there is no such stamp.
    """
    if len(data) >= 12:
        sec, nanosec = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, 4)
        if nanosec < _NANOSECONDS:
            return int(sec) * _NANOSECONDS + int(nanosec)
    raise InputError(
        f'{where}: header.stamp: must be in a message that begins with a std_msgs/Header, got '
        f'{bytes(data[:12])!r}'
    )


def encode(kind: str, message: Any) -> bytes:
    """Return a message's bytes."""
    return bytes(typestore().serialize_cdr(message, kind))


def _make(kind: str, *values: Any) -> Any:
    return typestore().types[kind](*values)


def _header(stamp: int, frame_id: str) -> Any:
    return _make('std_msgs/msg/Header', _time(stamp), frame_id)


def _time(stamp: int) -> Any:
    return _make('builtin_interfaces/msg/Time', *divmod(stamp, _NANOSECONDS))


def encode_image(stamp: int, frame_id: str, pixels: np.ndarray) -> bytes:
    """Return an (H, W) array of float32, float64, uint8 or uint16 as a ``sensor_msgs/Image``."""
    kind = pixels.dtype.str[1:]
    rows = np.ascontiguousarray(pixels, dtype=f'<{kind}')
    height, width = rows.shape
    return encode(
        IMAGE,
        _make(
            IMAGE,
            _header(stamp, frame_id),
            height,
            width,
            _PIXELS[kind],
            0,
            width * rows.itemsize,
            rows.view(np.uint8).reshape(-1),
        ),
    )


def encode_camera_info(
    stamp: int, frame_id: str, size: tuple[int, int], matrix: np.ndarray, distortion: np.ndarray
) -> bytes:
    """Return a ``sensor_msgs/CameraInfo`` for (height, width) images: R = I, P = [K | 0]."""
    no_region = _make('sensor_msgs/msg/RegionOfInterest', 0, 0, 0, 0, False)
    projection = np.hstack([matrix, np.zeros((3, 1))])
    return encode(
        CAMERA_INFO,
        _make(
            CAMERA_INFO,
            _header(stamp, frame_id),
            *size,
            DISTORTION_MODELS[len(distortion)],
            distortion,
            matrix.ravel(),
            np.eye(3).ravel(),
            projection.ravel(),
            0,
            0,
            no_region,
        ),
    )


def encode_text_parameter(stamp: int, node: str, name: str, text: str) -> bytes:
    """Return the ``rcl_interfaces/ParameterEvent`` of a node that starts with a text."""
    value = _make(
        'rcl_interfaces/msg/ParameterValue',
        _STRING_PARAMETER,
        False,
        0,
        0.0,
        text,
        np.zeros(0, np.uint8),
        np.zeros(0, bool),
        np.zeros(0, np.int64),
        np.zeros(0),
        [],
    )
    parameter = _make('rcl_interfaces/msg/Parameter', name, value)
    return encode(PARAMETER_EVENT, _make(PARAMETER_EVENT, _time(stamp), node, [parameter], [], []))


def decode_text_parameters(data: bytes, where: str) -> tuple[str, dict[str, tuple[str, bool]]]:
    """Return a ``ParameterEvent``'s node, and its texts by name: each, and if it is a change."""
    event = decode(PARAMETER_EVENT, data, where)
    found: dict[str, tuple[str, bool]] = {}
    for changed, parameters in ((False, event.new_parameters), (True, event.changed_parameters)):
        for parameter in parameters:
            if parameter.value.type == _STRING_PARAMETER:
                found.setdefault(parameter.name, (parameter.value.string_value, changed))
    return event.node, found


def encode_bytes(label: str, content: bytes) -> bytes:
    """Return bytes with a label as a ``std_msgs/UInt8MultiArray``."""
    if len(content) >= 1 << 32:
        raise InputError(
            f'{label}: must be less than 4 GiB, the limit of a message in a bag, got '
            f'{len(content)} bytes'
        )
    dimension = _make('std_msgs/msg/MultiArrayDimension', label, len(content), len(content))
    layout = _make('std_msgs/msg/MultiArrayLayout', [dimension], 0)
    return encode(BYTES, _make(BYTES, layout, np.frombuffer(content, np.uint8)))


def decode_bytes(data: bytes, where: str) -> tuple[str, bytes]:
    """Return the label and the bytes of what `encode_bytes` made."""
    message = decode(BYTES, data, where)
    if len(message.layout.dim) != 1:
        raise InputError(
            f'{where}: layout.dim: must have one entry with a label, got {len(message.layout.dim)}'
        )
    return message.layout.dim[0].label, message.data.tobytes()
