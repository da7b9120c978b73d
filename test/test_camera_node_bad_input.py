"""Bad input to the camera node: one clear message, and the next good frame comes out."""

from dataclasses import replace

import numpy as np
import pytest
from streams import DEPTH, FLEXX2, GRAY, image_message, info_message, stream

SECOND = 1_000_000_000
WALL = np.full((172, 224), 1.5, np.float32)

pytestmark = pytest.mark.usefixtures('ros')


def good(stamp):
    """Return a wall and its camera info."""
    return {'image': image_message(WALL, stamp), 'info': info_message(FLEXX2, stamp)}


def another_encoding(stamp):
    return good(stamp) | {'image': image_message(WALL, stamp, encoding='mono8')}


def late_nanoseconds(stamp):
    messages = good(stamp)
    for message in messages.values():
        message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 4_000_000_000
    return messages


def another_size(stamp):
    return good(stamp) | {'info': info_message(replace(FLEXX2, width=640, height=480), stamp)}


def check_rejected(seen, count, parts):
    """Assert that the node rejected this many images, said so once, and goes on."""
    frames = seen.published
    seen.spin_until(lambda: seen.camera._statistics.rejected == count)
    seen.spin_until(lambda: seen.logged('input rejected'))
    seen.publish(**good(9 * SECOND))
    seen.spin_until(lambda: len(seen.depths()) == frames + 1)
    (said,) = seen.logged('input rejected')
    assert all(part in said for part in (*parts, ', got ')), said
    assert 'Traceback' not in said
    assert seen.published == frames + 1


@pytest.mark.parametrize(
    ('spoilt', 'parts'),
    [
        (another_encoding, ['clean/depth_image: encoding', "'mono8'", '32FC1 or 64FC1 or 16UC1']),
        (late_nanoseconds, ['clean/depth_image: header.stamp: must be', '4000000000']),
        (another_size, ['clean/camera_info: size', '640 x 480', '224 x 172']),
    ],
)
def test_bad_input(spoilt, parts):
    with stream(DEPTH) as seen:
        assert seen.send(**good(SECOND))
        for index in range(3):
            answered = seen.answered
            seen.publish(**spoilt((2 + index) * SECOND))
            seen.spin_until(lambda so_far=answered: seen.answered > so_far)
        check_rejected(seen, 3, parts)


def test_images_without_a_camera_info():
    with stream(DEPTH) as seen:
        for index in range(3):  # The last one still waits for it.
            seen.publish(image=image_message(WALL, (2 + index) * SECOND))
        check_rejected(seen, 2, ['clean/camera_info', 'must come with every image'])


@pytest.mark.parametrize(
    ('spoilt', 'parts'),
    [
        (image_message(WALL, encoding='16UC1'), ['reflectivity: encoding', '16UC1', '32FC1']),
        (image_message(WALL[:, :100]), ['reflectivity: size', '100 x 172', '224 x 172']),
    ],
    ids=['encoding', 'size'],
)
def test_bad_reflectivity_costs_no_depth(spoilt, parts):
    with stream(DEPTH, GRAY) as seen:
        for index in range(3):
            spoilt.header.stamp.sec = index
            assert seen.send(**good(index * SECOND), reflectivity=spoilt)
        seen.spin_until(lambda: seen.logged('input rejected'))
        assert len(seen.depths()) == len(seen.messages(GRAY)) == 3
        (said,) = seen.logged('input rejected')
        assert all(part in said for part in parts), said


def test_warnings_are_rate_limited():
    with stream() as seen:
        for index in range(1, 60):
            messages = good(index * SECOND)
            messages['image'].data = messages['image'].data[:index]
            assert not seen.send(**messages)
            messages = good(index * SECOND)
            messages['info'].k[0] = -float(index)
            assert not seen.send(**messages)
        assert seen.send(**good(99 * SECOND))
        # Once every five seconds; a busy machine may need that long.
        seen.spin_until(lambda: seen.logged('input rejected'))
        assert len(seen.logged('input rejected', 'data: must be')) < 5
        assert len(seen.logged('input rejected', 'K: fx: must be')) < 5
