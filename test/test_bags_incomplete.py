"""Bags in which some frames lack an image, or something changes after the last frame."""

from flexx2_sim_ros.characterize.measurement import measure
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.observation import gray_images
from made_bags import camera_entries, image, info, SECOND, usecase, write
import numpy as np

COUNT, SHAPE = 6, (43, 56)
TRUE = 0.8
CLEAN, REFLECTIVITY = '/front/clean/depth_image', '/front/clean/reflectivity'
NODE = '/front/flexx2_camera'


def wall(moving):
    """Return (T, H, W) float32 metres of a wall, which comes nearer if the camera moves."""
    metres = 2.0 - 0.05 * moving * np.arange(COUNT, dtype=np.float32)
    return np.broadcast_to(metres[:, None, None], (COUNT, *SHAPE)).astype(np.float32)


def campaign_of(entries, folder):
    """Return what a diagnosis reads of a bag."""
    found = check(write(folder / 'bag', entries), None)
    assert isinstance(found, Found), found
    return read(found, None)


def without(entries, topic, frames):
    """Return entries without some images of a topic."""
    seen = -1
    left = []
    for entry in entries:
        seen += entry[0] == topic
        if entry[0] != topic or seen not in frames:
            left.append(entry)
    return left


def bright(entries):
    """Return entries with a reflectivity that is the same everywhere."""
    image_of = np.full(SHAPE, TRUE, np.float32)
    return [
        image(REFLECTIVITY, one[2], image_of) if one[0] == REFLECTIVITY else one for one in entries
    ]


def test_a_still_scene_needs_one_clean_image(tmp_path):
    entries = bright(camera_entries('front', wall(False) + 0.001, wall(False)))
    for topic in (CLEAN, REFLECTIVITY):
        entries = without(entries, topic, {0, 1, 3})
    data = campaign_of(entries, tmp_path)
    assert data.clean.shape == SHAPE
    assert data.truth.known is None
    np.testing.assert_allclose(data.reflectivity, TRUE, rtol=1e-6)


def test_ground_truth_of_a_moving_camera_is_unknown_where_its_image_is_missing(tmp_path):
    entries = camera_entries('front', wall(True), wall(True))
    entries = without(without(entries, CLEAN, {0}), REFLECTIVITY, {4})
    data = campaign_of(entries, tmp_path)
    assert data.clean.shape == (COUNT, *SHAPE)
    known = data.truth.known.reshape(COUNT, -1)
    assert known.all(axis=1).tolist() == [False, True, True, True, False, True]
    assert not known[[0, 4]].any()


def test_a_measurement_of_the_noise_uses_all_depth(tmp_path):
    noise = 0.004 * np.random.default_rng(1).standard_normal((COUNT, *SHAPE))
    seen = (wall(False) + 0.01 + noise).astype(np.float32)
    entries = without(camera_entries('front', seen, wall(False)), CLEAN, {0, 2})
    found = measure(write(tmp_path / 'bag', entries))
    assert found.pixels.invalid == 0
    assert found.bias_of == 'clean depth'
    assert abs(found.bias - 0.01) < 0.001


def test_missing_gray_images_do_not_darken_the_others(tmp_path):
    entries = []
    for index, frame in enumerate(wall(False)):
        stamp = SECOND + index * SECOND // 30
        entries += [
            image(f'{NODE}/depth_image_0', stamp, frame),
            info(f'{NODE}/camera_info', stamp, SHAPE),
        ]
        if index % 2:
            gray = np.full(SHAPE, 200, np.uint8)
            gray[0, 0] = 250
            entries.append(image(f'{NODE}/gray_image_0', stamp, gray, 'mono8'))
    reader = open_recording(write(tmp_path / 'bag', entries))
    (gray,) = gray_images(reader, moving=False)
    assert gray[5, 5] == 200


def test_what_changes_after_the_last_frame_does_not_matter(tmp_path):
    entries = camera_entries('front', wall(False), wall(False))
    after = SECOND * 10
    late = info(f'{NODE}/camera_info', after, SHAPE)
    late[3].k[0] += 1
    entries += [usecase(NODE, after, 'Mode_9_15fps', changed=True), late]
    reader = open_recording(write(tmp_path / 'bag', entries))
    assert reader.usecase == 'Mode_5_60fps'
    assert reader.changes == []
