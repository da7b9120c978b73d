"""Bad input to the camera node: one clear message, and the next good frame comes out."""

from dataclasses import replace
import itertools

import numpy as np
import pytest
from streams import DEPTH, FLEXX2, GRAY, image_message, info_message, stream

SECOND = 1_000_000_000
WALL = np.full((172, 224), 1.5, np.float32)
# How a message is spoilt; None leaves it out.

pytestmark = pytest.mark.usefixtures('ros')


def _changed(**fields):
    def change(message):
        for name, value in fields.items():
            setattr(message, name, value)
        return message

    return change


def _data(change):
    def cut(message):
        message.data = change(message.data)
        return message

    return cut


def _another(array, **layout):
    def other(message):
        made = image_message(array, **layout)
        made.header = message.header
        return made

    return other


def _of(**fields):
    def other(message):
        made = info_message(replace(FLEXX2, **fields))
        made.header = message.header
        return made

    return other


def _late_nanoseconds(message):
    message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 4_000_000_000
    return message


CASES = {
    'encoding': (
        'image',
        _another(WALL, encoding='mono8'),
        ['clean/depth_image: encoding', "'mono8'", '32FC1 or 64FC1 or 16UC1'],
    ),
    'nanoseconds': (
        'both',
        _late_nanoseconds,
        ['clean/depth_image: header.stamp', '4000000000', 'must be'],
    ),
    'other size': (
        'info',
        _of(width=640, height=480),
        ['clean/camera_info: size', '640 x 480', '224 x 172'],
    ),
    'no info': (
        'info',
        lambda _: None,
        ['clean/camera_info', 'must come with every image', 'got none'],
    ),
}


def _three(stamp):
    return {
        'image': image_message(WALL, stamp),
        'info': info_message(FLEXX2, stamp),
        'reflectivity': None,
    }


@pytest.mark.parametrize(('kind', 'spoil', 'parts'), CASES.values(), ids=CASES)
def test_bad_input(kind, spoil, parts):
    with stream(DEPTH) as seen:
        no_info = kind == 'info' and spoil(info_message(FLEXX2)) is None
        if not no_info:  # One that has come stays.
            assert seen.send(**_three(SECOND))
        frames = len(seen.depths())
        for index in range(3):
            messages = _three((2 + index) * SECOND)
            for name in ('image', 'info') if kind == 'both' else (kind,):
                messages[name] = spoil(messages[name])
            answered = seen.answered
            seen.publish(**messages)
            if not no_info:
                seen.spin_until(lambda so_far=answered: seen.answered > so_far)
        rejected = seen.camera._statistics
        seen.spin_until(lambda: rejected.rejected == (2 if no_info else 3))
        seen.spin_until(lambda: seen.logged('input rejected'))
        seen.publish(**_three(9 * SECOND))
        seen.spin_until(lambda: len(seen.depths()) == frames + 1)
        logged = seen.logged('input rejected')
        assert len(logged) == 1
        assert all(part in logged[0] for part in parts), logged[0]
        assert ', got ' in logged[0]
        assert 'Traceback' not in logged[0]
        assert seen.camera._statistics.published == frames + 1


@pytest.mark.parametrize(
    ('spoil', 'parts'),
    [
        (_changed(encoding='16UC1'), ['clean/reflectivity: encoding', '16UC1', '32FC1']),
        (_another(WALL[:, :100]), ['clean/reflectivity: size', '100 x 172', '224 x 172']),
        (_data(lambda data: data[:7]), ['clean/reflectivity: data', 'got 7', str(896 * 172)]),
    ],
    ids=['encoding', 'size', 'data'],
)
def test_bad_reflectivity_costs_no_depth(spoil, parts):
    with stream(DEPTH, GRAY) as seen:
        for index in range(3):
            messages = _three(index * SECOND)
            messages['reflectivity'] = spoil(image_message(WALL, index * SECOND))
            assert seen.send(**messages)
        seen.spin_until(lambda: seen.logged('input rejected'))
        assert len(seen.depths()) == len(seen.messages(GRAY)) == 3
        logged = seen.logged('input rejected')
        assert len(logged) == 1
        assert all(part in logged[0] for part in parts), logged[0]


def test_warnings_are_rate_limited():
    with stream() as seen:
        for index in range(1, 60):
            messages = _three(index * SECOND)
            messages['image'].data = messages['image'].data[:index]
            assert not seen.send(**messages)
            messages = _three(index * SECOND)
            messages['info'].k[0] = -float(index)
            assert not seen.send(**messages)
        assert seen.send(**_three(99 * SECOND))
        # Once every five seconds; a busy machine may need that long.
        seen.spin_until(lambda: seen.logged('input rejected'))
        assert len(seen.logged('input rejected', 'data: must be')) < 5
        assert len(seen.logged('input rejected', 'K: fx: must be')) < 5


@pytest.fixture(scope='module')
def going(ros):
    """Return a stream, and stamps for its images."""
    with stream(DEPTH) as seen:
        yield seen, itertools.count(SECOND, SECOND)


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'usecase': ''}, ['usecase', "''", 'Mode_9_30fps']),
        ({'input_depth': 'flat'}, ['input_depth', "'flat'", 'planar, radial']),
        ({'frame_id': 'x' * 256}, ['frame_id: must be at most 255 characters, got 256']),
        ({'usecase': 5}, ['usecase', "'5'", 'Mode_9_30fps']),
    ],
    ids=str,
)
def test_bad_parameters_are_refused(going, values, parts):
    seen, stamps = going
    assert seen.send(**_three(next(stamps)))
    name = next(iter(values))
    before = seen.get(name)
    refused = seen.set(**values)
    assert not refused.successful
    assert all(part in refused.reason for part in parts), refused.reason
    assert seen.get(name) == before
    assert seen.send(**_three(next(stamps)))
