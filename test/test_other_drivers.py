"""Bags of other cameras' drivers become recordings."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, recording_cameras
from made_bags import DISTORTION, IMAGE, MATRIX, write
from made_driver_bags import (
    azure_kinect,
    COLOUR_MATRIX,
    depths,
    millimetres,
    pico_flexx,
    RATIONAL,
    realsense,
    ros1_bag,
    stamps,
    with_frame,
)
import numpy as np
from programs import convert, converted, refusal
import pytest


@pytest.mark.parametrize('ros', [1, 2])
@pytest.mark.parametrize(
    ('driver', 'distortion', 'bits'),
    [(pico_flexx, DISTORTION, 16), (realsense, None, 8), (azure_kinect, RATIONAL, 16)],
)
def test_a_drivers_bag_becomes_a_recording(driver, distortion, bits, ros, tmp_path):
    name, writer = ('a.bag', ros1_bag) if ros == 1 else ('a', write)
    bag = writer(tmp_path / name, driver())
    found = converted(bag, '--usecase', 'my_mode')
    expected = np.where(depths() > 0, depths(), np.nan)
    np.testing.assert_allclose(found.depth, expected, rtol=1e-6)
    np.testing.assert_array_equal(found.K, MATRIX)
    assert found.stamp_ns.tolist() == stamps()
    assert found.usecase == 'my_mode'
    raw = millimetres(depths())
    np.testing.assert_array_equal(found.amplitude, raw if bits == 16 else raw // 16)
    assert found.amplitude.dtype.itemsize * 8 == bits
    if distortion is None:
        assert 'distortion' not in found.extra
    else:
        np.testing.assert_array_equal(found.extra['distortion'], distortion)
    # And back: the lens is in the camera info under its own name.
    assert convert(tmp_path / f'{name}.npz', tmp_path / 'back') == 0
    np.testing.assert_array_equal(converted(tmp_path / 'back').depth, found.depth)


def test_broken_bags_of_ros_1(tmp_path):
    whole = ros1_bag(tmp_path / 'a.bag', pico_flexx()).read_bytes()
    for name, content in (
        ('empty', b''),
        ('text', b'text' * 500),
        ('cut off', whole[: len(whole) // 2]),
        ('head', whole[:4000]),
    ):
        path = tmp_path / f'{name}.bag'
        path.write_bytes(content)
        with pytest.raises(InputError, match='closed and indexed ROS 1 bag'):
            load_recording(path)
    # Images of a size that they do not have.
    lying = [
        with_frame(entry, 'f', width=400) if entry[1] == IMAGE else entry for entry in pico_flexx()
    ]
    with pytest.raises(InputError, match='step: must be at least'):
        load_recording(ros1_bag(tmp_path / 'lying.bag', lying), '/pico_flexx/image_depth')


def test_ros_1_bags_are_not_written(tmp_path, capsys):
    bag = write(tmp_path / 'a', azure_kinect())
    assert 'ROS 1' in refusal(capsys, bag, tmp_path / 'out.bag')
    assert not (tmp_path / 'out.bag').exists()


def test_depth_in_the_pixels_of_colour_is_no_second_camera(tmp_path):
    for driver, copy in (
        (realsense, '/camera/camera/aligned_depth_to_color/image_raw'),
        (azure_kinect, '/depth_to_rgb/image_raw'),
    ):
        bag = write(tmp_path / driver.__name__, driver())
        assert len(recording_cameras(bag)) == 1
        np.testing.assert_array_equal(load_recording(bag, copy).K, COLOUR_MATRIX)
        # A bag that has the copy alone can be read, too.
        alone = [entry for entry in driver() if 'rgb' in entry[0] or 'color' in entry[0]]
        assert recording_cameras(write(tmp_path / f'{driver.__name__}2', alone)) == [copy[1:]]
