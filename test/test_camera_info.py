"""What a camera info says of an image: binning, regions, rectified images and empty matrices."""

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import (
    CameraFields,
    decode_camera_info,
    is_rectified,
    Region,
)
from hypothesis import given
from hypothesis import strategies as st
import pytest

SIZE = 172, 224
K = [210.6, 0.0, 113.0, 0.0, 212.9, 84.0, 0.0, 0.0, 1.0]
OWN = Intrinsics(224, 172, 210.6, 212.9, 113.0, 84.0)


def fields(**changes):
    return CameraFields(**{'height': 172, 'width': 224, 'k': K, **changes})


@given(
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(0, 60),
    st.integers(0, 60),
    st.floats(-10, 10),
    st.floats(-10, 10),
)
def test_a_point_of_the_sensor_is_where_binning_and_region_move_it(
    across, down, left, top, off_x, off_y
):
    """Assert it of a corner of the sensor's pixels, which binning and regions only move."""
    height, width = 172 * down + 2 * top, 224 * across + 2 * left
    fx, fy = 210.6 * across, 212.9 * down
    cx, cy = (width - 1) / 2 + off_x, (height - 1) / 2 + off_y
    region = Region(left, top, 172 * down, 224 * across) if left or top else Region()
    message = fields(
        height=height,
        width=width,
        k=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        binning_x=across,
        binning_y=down,
        roi=region,
    )
    camera = decode_camera_info(message, size=SIZE)
    assert (camera.height, camera.width) == SIZE
    # Corners of pixels are whole numbers here.
    for x, y in ((0.1, 0.2), (-0.3, 0.05)):
        u, v = fx * x + cx + 0.5, fy * y + cy + 0.5
        moved = (u - left) / across, (v - top) / down
        seen = camera.fx * x + camera.cx + 0.5, camera.fy * y + camera.cy + 0.5
        assert seen == pytest.approx(moved)


@pytest.mark.parametrize(
    'message',
    [
        fields(binning_x=2, binning_y=2),
        fields(height=344, width=448, binning_x=2, binning_y=2),
        fields(roi=Region(60, 40, 172, 224)),
        fields(height=344, width=448, roi=Region(112, 86, 172, 224)),
        fields(height=344, width=448, binning_x=2, binning_y=2, roi=Region(0, 0, 344, 448)),
        fields(roi=Region(0, 0, 172, 224)),
        fields(binning_x=1, binning_y=1),
    ],
)
def test_a_matrix_of_the_image_beside_binning_and_region_is_left(message):
    """Assert it where the driver has forgotten that these are of the full sensor."""
    notes = []
    assert decode_camera_info(message, size=SIZE, notes=notes) == OWN
    whole = message.binning_x <= 1 and not message.roi.x_offset
    assert bool(notes) != whole


def test_another_size_stays_another_size():
    message = fields(height=480, width=640, binning_x=3, binning_y=3)
    camera = decode_camera_info(message, size=SIZE)
    assert (camera.height, camera.width) == (480, 640)
    # Without an image, it is that of the part.
    assert decode_camera_info(message).width == 213
    with pytest.raises(InputError, match='image size: must be'):
        decode_camera_info(fields(height=0, width=0), size=SIZE)


@pytest.mark.parametrize('model', ['equidistant', 'fisheye', 'equi'])
def test_a_fisheye_without_coefficients_is_taken_with_a_note(model):
    notes = []
    message = fields(distortion_model=model, d=[0.0] * 4)
    assert decode_camera_info(message, notes=notes) == OWN
    assert model in notes[0]


@pytest.mark.parametrize(
    ('topic', 'rectified'),
    [
        ('/camera/depth/image_rect', True),
        ('/image_rect', True),
        ('/depth/image_rect/compressedDepth', True),
        ('/camera/depth/image_rect_raw', False),
        ('/camera/depth/image_rect_color', False),
        ('/image_rect/image_raw', False),
        ('/camera/depth/my_image_rect', False),
    ],
)
def test_only_the_exact_name_says_that_an_image_is_rectified(topic, rectified):
    assert is_rectified(topic) == rectified
