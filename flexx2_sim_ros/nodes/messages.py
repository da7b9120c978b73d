"""Frames as messages."""

from typing import Any

from builtin_interfaces.msg import Time
from flexx2_sim_ros.messages.decoding import little_endian_bytes
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

_NANOSECONDS = 1_000_000_000


def time_message(nanoseconds: int) -> Time:
    """Return whole nanoseconds as a ``builtin_interfaces/Time``."""
    sec, nanosec = divmod(nanoseconds, _NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def header(stamp: int, frame_id: str) -> Header:
    """Return a header for a stamp in nanoseconds."""
    return Header(stamp=time_message(stamp), frame_id=frame_id)


def image_message(head: Header, array: np.ndarray, encoding: str) -> Image:
    """Return an (H, W) array as a little-endian image with unpadded rows."""
    message = Image(
        header=head,
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=array.shape[1] * array.itemsize,
    )
    _fill(message, array)
    return message


def cloud_message(
    head: Header, points: np.ndarray, confidence: np.ndarray, *, swapped: bool = False
) -> PointCloud2:
    """
    Return a cloud of x, y, z, conf, one point for each pixel, row by row.

    ``points`` are (H, W, 3) float32 metres, ``confidence`` is (H, W) float32 in 0..1. If
    ``swapped``, width and height are exchanged, as the vendor's driver does; the bytes stay the
    same.
    """
    height, width = confidence.shape[::-1] if swapped else confidence.shape
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(('x', 'y', 'z', 'conf'))
    ]
    message = PointCloud2(
        header=head,
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        is_dense=False,
        point_step=16,
        row_step=16 * width,
    )
    _fill(message, np.concatenate([points, confidence[..., None]], axis=2, dtype=np.float32))
    return message


def camera_info_message(head: Header, camera: Intrinsics) -> CameraInfo:
    """Return the camera info: R = I, P = [K | 0]."""
    k = camera.matrix
    p = np.hstack([k, np.zeros((3, 1))])
    return CameraInfo(
        header=head,
        height=camera.height,
        width=camera.width,
        distortion_model=camera.distortion_model,
        d=list(camera.distortion),
        k=k.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=p.ravel().tolist(),
    )


def transform(
    stamp: int, frames: tuple[str, str], position: np.ndarray, turn: np.ndarray
) -> TransformStamped:
    """
    Return the pose of the second frame in the first; ``stamp`` is in nanoseconds.

    ``position`` is (3,) metres, ``turn`` a (4,) quaternion (w, x, y, z).
    """
    return TransformStamped(
        header=header(stamp, frames[0]),
        child_frame_id=frames[1],
        transform=Transform(translation=Vector3(**xyz(position)), rotation=quaternion(turn)),
    )


def xyz(values: np.ndarray) -> dict[str, float]:
    """Return three numbers as the fields of a point or a vector."""
    x, y, z = map(float, values)
    return {'x': x, 'y': y, 'z': z}


def quaternion(values: np.ndarray) -> Quaternion:
    """Return four numbers, w first, as a message."""
    w, x, y, z = map(float, values)
    return Quaternion(x=x, y=y, z=z, w=w)


def _fill(message: Any, array: np.ndarray) -> None:
    # Extending the field's own array is the fastest way; assigning an ndarray is 2,000 times
    # slower.
    message.data.frombytes(little_endian_bytes(array))
