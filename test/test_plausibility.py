"""What is said of depth images in which nothing can be seen."""

from flexx2_sim_ros.nodes.plausibility import explain, sees_something
import numpy as np
import pytest

RANGE = (0.1, 7.0)


def found(values, encoding='32FC1'):
    """Explain an image that shows these values, over and over."""
    image = np.resize(np.asarray(values, np.float32), (172, 224))
    return explain(image, encoding, *RANGE)


@pytest.mark.parametrize(
    ('values', 'encoding', 'kind', 'part'),
    [
        ([1200.0, 1500.0, 1800.0], '32FC1', 'millimetres', 'values of about 1500'),
        ([1500.0, np.nan, 0.0], '64FC1', 'millimetres', '64FC1 must be metres'),
        ([1500.0], '32FC1', 'millimetres', 'far plane'),
        ([0.001, 0.002, 0.003], '16UC1', 'metres', '16UC1 must be millimetres'),
        ([0.0015, 0.0016], '32FC1', 'kilometres', 'divided by 1000'),
        ([0.0], '32FC1', 'zero', 'every pixel is 0'),
        ([-1.5, -1.4, np.nan], '32FC1', 'negative', 'must be positive'),
        ([8.5, 12.0, 9.0], '32FC1', 'too far', '8.5 to 12 m'),
        ([8.5, 12.0], '16UC1', 'too far', '8.5 to 12 m'),
        ([0.02, 0.05], '32FC1', 'too near', '0.02 to 0.05 m'),
        ([0.05, 9.0, 0.06, 9.1], '32FC1', 'too near or too far', '0.05 to 9.1 m'),
    ],
)
def test_implausible_input_is_reported(values, encoding, kind, part):
    finding = found(values, encoding)
    assert finding.wrong
    assert finding.kind == kind
    assert part in finding.text


def test_wrong_byte_order():
    finding = found(np.array([1.5, 2.0], '>f4').view('<f4'))
    assert finding.wrong
    assert finding.kind == 'byte order'


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ([np.nan], ['NaN 100%']),
        ([np.inf], ['+inf 100%']),
        ([np.nan, np.inf, 0.0, np.inf], ['NaN 25%', '+inf 50%', '0 25%']),
        ([-np.inf], ['near plane']),
        ([50.0], ['every pixel is 50 m', 'far plane']),
    ],
)
def test_frames_without_any_return_are_no_error(values, parts):
    finding = found(values)
    assert not finding.wrong
    assert all(part in finding.text for part in parts), finding.text


def test_one_pixel_in_range_is_enough():
    image = np.full((480, 640), 1500.0, np.float32)
    assert not sees_something(image, *RANGE)
    image[101, 203] = 1.5
    assert not sees_something(image, *RANGE)
    assert explain(image, '32FC1', *RANGE) is None
    image[100:140, 200:240] = 1.5
    assert sees_something(image, *RANGE)
    # Of a small image, every pixel is looked at.
    assert sees_something(np.diag([0.0, 1.5]), *RANGE)
