"""Cameras on topics of any name: recognised by what they publish, in bags and while recording."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, recording_cameras
from made_bags import (
    camera_entries,
    depths,
    image,
    info,
    make,
    MATRIX,
    same,
    SECOND,
    usecase,
    write,
)
import numpy as np
from programs import convert, converted
import pytest

CLOUDLESS = depths(3, 5, 4, seed=1)


def renamed(depth, name='/front_left/flexx2', infos='/front_left/calibration'):
    """Return what a camera publishes on topics of other names."""
    entries = []
    for index, frame in enumerate(depth):
        stamp = SECOND + index * SECOND // 30
        entries += [image(name, stamp, frame), info(infos, stamp, frame.shape)]
    return entries


def test_a_remapped_camera_is_found_in_a_bag(tmp_path):
    entries = renamed(CLOUDLESS)
    for index, frame in enumerate(CLOUDLESS):
        stamp = SECOND + index * SECOND // 30
        entries += [
            image('/front_left/clean/depth_image', stamp, frame + 1),
            info('/front_left/clean/camera_info', stamp, frame.shape, 2 * MATRIX),
            image('/front_left/gray', stamp, frame.astype('u1'), 'mono8'),
            image('/rgb/image', stamp, np.zeros((9, 9), 'u1'), 'mono8'),
            info('/rgb/camera_info', stamp, (9, 9)),
        ]
    entries.append(usecase('/front_left/my_camera', 1, 'Mode_9_30fps'))
    bag = write(tmp_path / 'bag', entries)
    assert recording_cameras(bag) == ['front_left/flexx2']
    recording = load_recording(bag)
    assert same(recording.depth, CLOUDLESS)
    # Seen by a camera of twice the focal length: its first pixels are every second one.
    np.testing.assert_allclose(recording.clean_depth[:, 0, 0], CLOUDLESS[:, 0, 0] + 1, rtol=1e-6)
    assert same(recording.amplitude, CLOUDLESS.astype('u1'))
    assert same(recording.K, MATRIX)
    assert recording.usecase == 'Mode_9_30fps'
    assert same(converted(bag).depth, CLOUDLESS)


def test_two_remapped_cameras_and_one_of_usual_names(tmp_path):
    other = depths(3, 7, 6, seed=2)
    bag = write(
        tmp_path / 'bag',
        renamed(CLOUDLESS)
        + renamed(other, '/b/depth', '/b/info')
        + camera_entries('left', CLOUDLESS + 2, CLOUDLESS),
    )
    assert sorted(recording_cameras(bag)) == ['b/depth', 'front_left/flexx2', 'left']
    assert same(load_recording(bag, 'b/depth').depth, other)
    assert same(load_recording(bag, '/front_left/flexx2').depth, CLOUDLESS)
    assert same(load_recording(bag, 'left').clean_depth, CLOUDLESS)
    with pytest.raises(InputError, match='--camera.*got several cameras'):
        load_recording(bag)


def test_a_topic_selects_the_camera_of_a_bag_that_becomes_a_bag(tmp_path):
    entries = renamed(CLOUDLESS) + renamed(CLOUDLESS + 1, '/front_left/filtered')
    bag, out = write(tmp_path / 'bag', entries), tmp_path / 'out'
    with pytest.raises(InputError, match='/front_left/flexx2.*/front_left/filtered.*--camera'):
        load_recording(bag)
    assert convert(bag, out, '--camera', '/front_left/filtered') == 0
    assert recording_cameras(out) == ['front_left/filtered']
    assert same(load_recording(out).depth, CLOUDLESS + 1)


def test_a_topic_called_recording_belongs_to_somebody_else(tmp_path):
    entries = renamed(CLOUDLESS)
    text = make('std_msgs/msg/String', 'on')
    entries.append(('/front_left/recording', 'std_msgs/msg/String', 2 * SECOND, text))
    assert same(load_recording(write(tmp_path / 'bag', entries)).depth, CLOUDLESS)


def test_images_that_are_not_clear_are_named_beside_a_camera(tmp_path, capsys):
    entries = renamed(CLOUDLESS) + renamed(CLOUDLESS + 1, '/front_left/filtered')
    usual = camera_entries('left', CLOUDLESS, CLOUDLESS)
    usual += camera_entries('right', CLOUDLESS, CLOUDLESS)
    bag = write(tmp_path / 'bag', entries + usual)
    assert convert(bag, tmp_path / 'out.npz') == 0
    said = ' '.join(capsys.readouterr().err.split())
    assert '/front_left/flexx2, /front_left/filtered: not read' in said


def test_an_image_without_a_camera_info_is_no_camera(tmp_path):
    entries = [entry for entry in renamed(CLOUDLESS) if entry[0].endswith('flexx2')]
    entries.append(info('/front_left/calibration', 1, (50, 40)))
    bag = write(tmp_path / 'bag', entries)
    assert recording_cameras(bag) == []
    with pytest.raises(InputError, match='no camera'):
        load_recording(bag)
