"""Images and camera infos as ROS messages, and back."""

import numpy as np
from sensor_msgs.msg import CameraInfo, Image

_ENCODINGS = {
    '32FC1': ('f4', 1.0),
    '64FC1': ('f8', 1.0),
    '16UC1': ('u2', 1000.0),
    'mono8': ('u1', 1.0),
}


def nanoseconds(message):
    """Return a stamped message's stamp."""
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def _stamp(message, stamp, frame_id):
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    return message


def image_message(
    array, stamp=0, *, encoding='32FC1', big_endian=False, padding=0, frame_id='optical'
):
    """Encode an (H, W) image of metres; ``padding`` bytes of rubbish end each row."""
    kind, scale = _ENCODINGS[encoding]
    values = array if scale == 1.0 else np.rint(np.nan_to_num(array) * scale)
    pixels = values.astype(np.dtype(('>' if big_endian else '<') + kind))
    rows = (
        np.ascontiguousarray(pixels)
        .view(np.uint8)
        .reshape(len(array), array.shape[1] * pixels.itemsize)
    )
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xA5)
    message = Image(
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=rows.shape[1],
    )
    message.data.frombytes(rows.tobytes())
    return _stamp(message, stamp, frame_id)


def info_message(camera, stamp=0, frame_id='optical'):
    """Describe the camera that clean depth comes from."""
    message = CameraInfo(
        width=camera.width,
        height=camera.height,
        distortion_model='plumb_bob',
        d=list(camera.distortion),
        k=camera.matrix.ravel().tolist(),
    )
    return _stamp(message, stamp, frame_id)


def array_of(message):
    """Return a little-endian 32FC1 or mono8 image's pixels, checking its layout."""
    kind, _ = _ENCODINGS[message.encoding]
    dtype = np.dtype(f'<{kind}')
    assert message.is_bigendian == 0
    assert message.step == message.width * dtype.itemsize
    assert len(message.data) == message.step * message.height
    return np.frombuffer(message.data, dtype).reshape(message.height, message.width)
