"""The example of Genesis, in Genesis: its depth, its intrinsics, and the noise on its depth."""

import importlib

from flexx2_sim_ros.camera import Camera
import numpy as np
import pytest
from simulators import assert_noise_is_sigma, assert_same_depth, exact_room
from small_room import FAR, USECASE

pytest.importorskip('torch')
pytest.importorskip('genesis')
example = importlib.import_module('genesis_depth')  # in examples/, which needs Genesis


@pytest.fixture(scope='module')
def camera():
    """Return the camera in the room; Genesis compiles for a minute or more."""
    return example.build()


@pytest.fixture(scope='module')
def image(camera):
    """Return Genesis's depth image."""
    return example.rendered(camera)


def test_depth_is_along_the_optical_axis_and_the_far_plane_for_nothing(image):
    exact = exact_room(example.SQUARE)
    assert_same_depth(example.depth(image), exact)
    np.testing.assert_allclose(image[np.isnan(exact)], FAR, rtol=1e-4)


def test_its_intrinsics_are_half_a_pixel_off(camera, image):
    lens, given = example.SQUARE, np.asarray(camera.intrinsics)
    np.testing.assert_allclose(np.diag(given), np.diag(lens.matrix), rtol=1e-6)
    np.testing.assert_allclose(given[:2, 2] - lens.matrix[:2, 2], 0.5)
    # Half a pixel lower, a floor at 2 m is 2 cm nearer.
    moved = exact_room(example.replace(lens, cx=given[0, 2], cy=given[1, 2]))
    error = np.abs(example.depth(image) - moved)
    assert np.nanpercentile(error, 95) > 0.01


def test_the_noise_is_sigma_of_the_base_model(image):
    clean, lens = example.depth(image), example.SQUARE
    noisy = Camera(USECASE, seed=3).capture(clean, lens.matrix, stamp=0.0).depth
    assert_noise_is_sigma(clean[None], noisy[None], lens, USECASE)
