"""The report of a diagnosis: single frames with marked pixels."""

import base64
from io import BytesIO
import re
from types import SimpleNamespace

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.gap.data.axes import AXES, axes_of
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.features.confirm import Apart
from flexx2_sim_ros.gap.features.pixel_patterns import grain_moments
from flexx2_sim_ros.gap.features.single_frame import single_frame
from flexx2_sim_ros.gap.report.frames import frames, MOST_FRAMES
from flexx2_sim_ros.html_drawing import MARKS
import numpy as np
from PIL import Image

MODE = flexx2().mode('Mode_9_30fps')
K = np.array([[200.0, 0, 39.5], [0, 200.0, 29.5], [0, 0, 1]])
# A wall at 1 m on the left and at 2 m on the right.
CLEAN = np.where(np.arange(80) < 40, 1.0, 2.0)[None].repeat(60, 0).astype(np.float32)
DISTANCES = axes_of(flexx2())['distance'].edges
FAR = min(edge for edge in DISTANCES if edge > 1.5)


def outcomes(count, depth=CLEAN):
    """Return what the page asks of the outcome of recordings that show a wall and another one."""
    scene = look_at(CLEAN, None, 0.0, None, K, MODE, axes_of(flexx2()))
    frame = single_frame(4, [depth, depth - 0.01, depth], [scene])
    return [
        SimpleNamespace(
            name=f'<{i}>.npz',
            frame=frame,
            apart=Apart({'wasserstein_mm': [8.0, 2.0, 1.0]}, float(i)),
        )
        for i in range(count)
    ]


def pictures(page):
    """Return all pictures of a page, (H, W, 3) uint8."""
    return [
        np.array(Image.open(BytesIO(base64.b64decode(code))).convert('RGB'))
        for code in re.findall(r'base64,([^"]*)', page)
    ]


def page_of(some, where=(), effects=({'name': 'offset'},)):
    return frames({'where': where, 'effects': effects}, some, axes_of(flexx2()))


def marked(image, index):
    return np.asarray((image == MARKS[index]).all(axis=-1))


def test_bins_of_pixels_are_those_of_their_covariates():
    scene = look_at(CLEAN, None, 0.0, None, K, MODE, axes_of(flexx2()))
    place = scene.places('distance')
    assert np.array_equal(place >= 0, scene.inside)
    assert np.array_equal(
        place[scene.inside], np.searchsorted(np.array(DISTANCES), CLEAN[scene.inside])
    )
    for name in AXES:
        assert scene.places(name).max() < AXES[name].bins


def test_the_pixels_of_the_first_rows_are_marked():
    bias = {'channel': 'bias', 'low': None, 'high': None, 'unit': '', 'detail': ''}
    far = {'covariate': 'distance', 'low': FAR, 'unit': 'm'}
    rows = [bias | one for one in ({'covariate': 'all'}, far, {'covariate': 'edge'})]
    page = page_of(outcomes(1), rows)
    assert '&lt;0&gt;.npz, frame 4: depth errors 8 mm, with the effects 2 mm' in page
    real, marks, simulated, before, after, rest = pictures(page)
    assert real.shape == simulated.shape == (60, 80, 3)
    # All surfaces are not marked: that says nothing of single pixels.
    far, edges = marked(marks, 0), marked(marks, 1)
    assert far[:, 50:].all()
    assert not far[:, :40].any()
    assert edges[:, 38:42].all()
    assert edges.sum() == 60 * 6
    # 1 cm too far: red. With the effects nothing is left.
    assert (before[:, :, 0] > before[:, :, 2]).all()
    assert np.array_equal(after, real)
    assert (rest == 255).all()


def test_a_difference_says_how_large_it_is_and_marks_the_worst_pixels():
    real = CLEAN.copy()
    real[:, :8] = np.nan
    real[:, 8:12] += 0.1
    some = outcomes(1, real)
    some[0].frame.depth[1:] = CLEAN
    some[0].frame.depth[2, 0, 20] -= 0.4  # one of 4320 pixels
    page = page_of(some)
    assert 'real, 10.0 % invalid' in page
    assert 'simulated, 0.0 % invalid' in page
    size = 0.1 * 4 / 72 * 1000
    assert f'real minus simulated: median +0.0, size {size:.1f}, worst 1 % from 100 mm' in page
    *_, before, _, after = pictures(page)
    assert not marked(before, 1).any()  # none is worse than the others
    assert np.argwhere(marked(after, 1)).tolist() == [[0, 20]]


def test_a_recording_without_any_depth_is_drawn():
    page = page_of(outcomes(1, np.full_like(CLEAN, np.nan)), effects=())
    assert len(pictures(page)) == 4
    # Pixels without depth are not marked where no condition is.
    assert not marked(pictures(page)[1], 0).any()
    assert 'nan' not in re.sub('base64,[^"]*', '', page)


def test_frames_of_pure_noise_leave_the_page_below_4_mb():
    noise = np.random.default_rng(5).uniform(0.2, 7.0, (172, 224)).astype(np.float32)
    camera = np.array([[210.6, 0, 111.5], [0, 212.9, 85.5], [0, 0, 1]])
    scene = look_at(noise, None, 0.0, None, camera, MODE, axes_of(flexx2()))
    frame = single_frame(4, [noise, noise[::-1], noise[:, ::-1]], [scene])
    some = outcomes(MOST_FRAMES + 4)
    for i, one in enumerate(some):
        one.frame = frame if i >= 4 else None
    page = page_of(some)
    assert len(page) < 3.9e6
    assert 'Recordings that are not shown: 4.' in page
    # Those with the largest gap come first.
    shown = [int(number) for number in re.findall(r'<h3>&lt;(\d+)&gt;', page)]
    assert shown == [*range(MOST_FRAMES + 3, 3, -1)]


def test_grain_is_a_number_of_pixels_their_squares_and_products_of_pairs():
    grain = np.random.default_rng(0).normal(0, 2, (7, 9)).astype(np.float32)
    grain[1, 2] = grain[3, 3:5] = np.nan
    clipped = np.clip(grain, -3, 3)

    def pairs(lines):
        products = np.concatenate(
            [np.outer(one, one)[np.triu_indices(len(one), 1)] for one in lines]
        )
        return np.nanmean(products)

    wanted = np.isfinite(grain).sum(), np.nansum(clipped**2), pairs(clipped), pairs(clipped.T)
    beside = np.nanmean(clipped[:, 1:] * clipped[:, :-1])
    np.testing.assert_allclose(grain_moments(grain), (*wanted, beside), rtol=1e-5)
