"""What the tests of the examples of simulators share."""

from flexx2_sim_ros.camera import Camera
import numpy as np
import pytest
from scipy.ndimage import laplace, maximum_filter
from small_room import BOXES, EYE, LENS

NORMAL_MEDIAN = 0.6745  # of the size of normal numbers of sigma 1
LEAST = 6000  # pixels: their median size has a standard error of 1.5 % or less


def exact_room(lens=LENS, off_centre=0.0):
    """
    Return the exact depth of the room of the examples.

    * `lens`: of the image
    * `off_centre`: (2, H, W) how far each ray passes below and to the right of its pixel's centre,
      pixels

    Returns (H, W) float64 metres along the optical axis, NaN for nothing.
    """
    v, u = np.mgrid[: lens.height, : lens.width] + off_centre
    # The camera looks along +x with z up: rays whose part along x is 1 have depths as lengths.
    rays = np.stack([np.ones(u.shape), (lens.cx - u) / lens.fx, (lens.cy - v) / lens.fy], axis=-1)
    depth = np.full(u.shape, np.inf)
    for centre, half in BOXES.values():
        sides = [(np.add(centre, sign * np.array(half)) - EYE) / rays for sign in (-1, 1)]
        enter, leave = np.minimum(*sides).max(axis=-1), np.maximum(*sides).min(axis=-1)
        depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    return np.where(np.isfinite(depth), depth, np.nan)


def assert_same_depth(found, exact, share=0.99):
    """Assert that depth is within 1 mm in all but a few pixels, which may be edges."""
    there = np.isfinite(exact)
    assert 0.1 < there.mean() < 1
    assert (np.isfinite(found) == there).mean() > share
    assert (np.abs(found - exact)[there] < 1e-3).mean() > share


def assert_noise_is_sigma(clean, noisy, lens, usecase):
    """
    Assert that the noise on planes has the sigma of the base model.

    * `clean`, `noisy`: (N, H, W) metres along the optical axis; what is not positive is invalid
    * `lens`: of the images
    """
    camera = Camera(usecase)
    sigma = np.stack([camera.capture(one, lens.matrix, stamp=0.0).sigma for one in clean])
    # Edges move by sigma_x: only pixels whose neighbourhood is one plane, where 1/z is linear.
    with np.errstate(divide='ignore', invalid='ignore'):
        error = (noisy - clean) / sigma
        bend = np.abs(laplace(np.nan_to_num(1 / clean, nan=1e3, posinf=1e3), axes=(1, 2)))
    plane = maximum_filter(bend, size=5, axes=(1, 2)) < 1e-3
    plane &= np.isfinite(error) & (noisy > 0)
    assert plane.sum() > LEAST
    # 8 % of the median are over 5 standard errors: this fails by chance in 1e-7.
    assert np.median(np.abs(error[plane])) == pytest.approx(NORMAL_MEDIAN, rel=0.08)
