"""Messages as arrays: everything that can be decoded is, and nothing else gets through."""

from array import array
from types import SimpleNamespace

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import CameraFields, decode_camera_info
from flexx2_sim_ros.messages.decoding import (
    check_stamp,
    decode_image,
    little_endian_bytes,
    stamp_nanoseconds,
)
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

ENCODINGS = ('32FC1', '64FC1', '16UC1')
SIZES = {'32FC1': 4, '64FC1': 8, '16UC1': 2}
BYTE = st.integers(0, 255)
UINT32 = st.integers(0, 2**32 - 1)
SMALL = st.integers(0, 12)


@st.composite
def images(draw):
    """Return an image message, some of whose fields may be anything."""
    encoding = draw(st.sampled_from([*ENCODINGS, 'mono8', 'bgr8', '', '32fc1', '32FC3']))
    height, width = draw(SMALL), draw(SMALL)
    step = width * SIZES.get(encoding, 1) + draw(st.sampled_from([0, 0, 1, 3, 8]))
    length = height * step
    if draw(st.booleans()):
        field = draw(st.sampled_from(['height', 'width', 'step', 'length']))
        value = draw(SMALL | UINT32)
        height = value if field == 'height' else height
        width = value if field == 'width' else width
        step = value if field == 'step' else step
        length = value % 4096 if field == 'length' else length
    data = draw(st.binary(min_size=length, max_size=length))
    return SimpleNamespace(
        height=height,
        width=width,
        encoding=encoding,
        step=step,
        is_bigendian=draw(BYTE),
        data=array('B', data),
    )


@given(images(), st.sampled_from([ENCODINGS, ('32FC1',)]))
def test_any_image_is_decoded_or_refused(message, encodings):
    try:
        image = decode_image(message, 'topic', encodings)
    except InputError as error:
        text = str(error)
        topic, field, _ = text.split(': ', 2)
        assert (topic, field) in [('topic', name) for name in ('encoding', 'size', 'step', 'data')]
        assert ', got ' in text
        assert 'must ' in text
        return
    assert message.encoding in encodings
    assert image.dtype == np.float32
    assert image.shape == (message.height, message.width)
    assert image.flags.c_contiguous
    size = SIZES[message.encoding]
    kind = {2: 'u2', 4: 'f4', 8: 'f8'}[size]
    order = '>' if message.is_bigendian else '<'
    raw = bytes(message.data)
    for y in range(message.height):
        start = y * message.step
        row = np.frombuffer(raw[start : start + message.width * size], order + kind)
        with np.errstate(over='ignore', invalid='ignore'):
            expected = row.astype(np.float32) * np.float32(0.001 if size == 2 else 1.0)
        np.testing.assert_array_equal(image[y], expected)


NUMBERS = st.floats() | st.sampled_from([0.0, 1.0, 211.0, np.nan])
GOOD_K = [211.0, 0.0, 111.5, 0.0, 213.0, 85.5, 0.0, 0.0, 1.0]
INFOS = st.builds(
    CameraFields,
    width=UINT32,
    height=UINT32,
    k=st.lists(NUMBERS, min_size=9, max_size=9) | st.just(GOOD_K),
    d=st.lists(NUMBERS, max_size=14),
    distortion_model=st.sampled_from(['plumb_bob', 'rational_polynomial', 'equidistant', '']),
)


@given(INFOS)
def test_any_camera_info_is_decoded_or_refused(message):
    try:
        camera = decode_camera_info(message, 'topic')
    except InputError as error:
        text = str(error)
        topic, field, _ = text.split(': ', 2)
        fields = 'K', 'size', 'image size', 'distortion', 'distortion_model'
        assert (topic, field) in [('topic', name) for name in fields]
        assert 'must ' in text
        return
    assert isinstance(camera, Intrinsics)
    assert camera.matrix.ravel().tolist() == message.k
    assert (camera.width, camera.height) == (message.width, message.height)
    assert camera.fx > 0
    assert camera.fy > 0
    most = len(camera.distortion)
    assert list(camera.distortion) == [*message.d, *[0.0] * most][:most]
    assert not any(message.d[most:])
    assert not any(message.d) or message.distortion_model in ('plumb_bob', 'rational_polynomial')


def _info(**fields):
    return CameraFields(**{'width': 224, 'height': 172, 'k': GOOD_K, **fields})


def test_camera_infos_of_pinholes():
    """Assert that what stands for no distortion is taken, and a fisheye's is not."""
    plain = Intrinsics(224, 172, 211.0, 213.0, 111.5, 85.5)
    assert decode_camera_info(_info()) == plain
    assert decode_camera_info(_info(d=[0.0] * 4)) == plain
    assert decode_camera_info(_info(d=[0.0] * 8, distortion_model='rational_polynomial')) == plain
    assert decode_camera_info(_info(distortion_model='')) == plain
    bent = decode_camera_info(_info(d=[0.1, -0.2, 0.01, 0.02, 0.3]))
    assert bent.distortion == (0.1, -0.2, 0.01, 0.02, 0.3)
    assert bent.distortion_model == 'plumb_bob'
    eight = (0.1, -0.2, 0.01, 0.02, 0.3, 0.4, 0.5, 0.6)
    rational = decode_camera_info(_info(d=eight, distortion_model='rational_polynomial'))
    assert rational.distortion == eight
    assert rational.distortion_model == 'rational_polynomial'
    with pytest.raises(InputError, match='at most 8 coefficients .rational_polynomial., got 12'):
        decode_camera_info(_info(d=[0.1] * 12, distortion_model='rational_polynomial'))
    for model in ('equidistant', 'Inverse Brown Conrady', 'Modified Brown Conrady'):
        with pytest.raises(
            InputError, match=f'distortion_model: must be plumb_bob.*, got .{model}'
        ):
            decode_camera_info(_info(d=[0.1] * 4, distortion_model=model))
        assert decode_camera_info(_info(d=[0.0] * 4, distortion_model=model)) == plain
    five = [0.1, -0.2, 0.01, 0.02, 0.3]
    assert decode_camera_info(_info(d=five, distortion_model='Brown Conrady')) == bent


@pytest.mark.parametrize(
    ('model', 'coefficients', 'kept'),
    [('plumb_bob', 5, 8), ('rational_polynomial', 8, 12), ('rational_polynomial', 8, 14)],
)
def test_zeros_at_the_end_are_no_distortion(model, coefficients, kept):
    given = [0.1 * (i + 1) for i in range(coefficients)]
    zeros = [0.0] * (kept - coefficients)
    assert decode_camera_info(_info(d=[*given, *zeros], distortion_model=model)).distortion == (
        tuple(given)
    )


@given(st.integers(-(2**31), 2**31 - 1), UINT32)
def test_stamps(sec, nanosec):
    stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
    assert stamp_nanoseconds(stamp) == sec * 10**9 + nanosec
    if nanosec < 10**9:
        check_stamp(stamp, 'topic')
    else:
        with pytest.raises(
            InputError, match=f'topic: header.stamp: must be .*, got nanosec {nanosec}'
        ):
            check_stamp(stamp, 'topic')


def test_bytes_are_little_endian():
    frame = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert bytes(little_endian_bytes(frame)) == frame.astype('<f4').tobytes()
    assert bytes(little_endian_bytes(frame[:, ::2])) == frame[:, ::2].astype('<f4').tobytes()
