"""Reflectivity from gray values: a corner of two walls whose reflectivity is known."""

from flexx2_sim_ros.truth.clean import Clean, KNOWN
from flexx2_sim_ros.truth.reflectivity import (
    find_scale,
    gray_samples,
    GrayScale,
    surfaces,
    with_reflectivity,
)
import numpy as np
import pytest

HEIGHT, WIDTH, FOCAL = 64, 84, 80.0
LEFT, RIGHT = (slice(8, -8), slice(8, 32)), (slice(8, -8), slice(52, -8))


def corner(rough=0.0):
    """Return two walls that meet at a right angle 3 m ahead, and the image's rays."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL], axis=-1)
    slant = 1 + np.abs(rays[..., 0])
    depth = 3 / slant + rough * np.random.default_rng(1).standard_normal(slant.shape)
    cosine = slant / np.sqrt(2) / np.sqrt(1 + (rays**2).sum(axis=-1))
    part, sigma = np.full(depth.shape, KNOWN, np.uint8), np.zeros(depth.shape, np.float32)
    return (
        Clean(depth.astype(np.float32), np.arccos(cosine).astype(np.float32), None, part, sigma),
        rays,
    )


def light(clean, reflectivity):
    """Return the light that comes back, 1/m^2, with 1 % of noise."""
    noise = 1 + 0.01 * np.random.default_rng(2).standard_normal(reflectivity.shape)
    return np.asarray(reflectivity * np.cos(clean.incidence) / clean.depth**2 * noise)


def painted():
    """Return the left wall with 0.2, and the right one with waves around 0.6."""
    u = np.broadcast_to(np.arange(WIDTH), (HEIGHT, WIDTH))
    return np.where(u < WIDTH / 2, 0.2, 0.6 + 0.2 * np.sin(u / 4))


def test_a_corner_is_two_surfaces():
    label = surfaces(*corner())
    assert label.max() == 2
    assert len(np.unique(label[LEFT])) == len(np.unique(label[RIGHT])) == 1


@pytest.mark.parametrize('root', [False, True])
@pytest.mark.parametrize('full', [200.0, 3000.0])
def test_the_scale_of_gray_values_is_found(root, full):
    clean, rays = corner()
    true = painted()
    back = light(clean, true)
    gray = np.rint(full * (np.sqrt(back / 0.2) if root else back / 0.2))
    sample = gray_samples(gray, clean, rays)
    assert sample is not None
    scale = find_scale([sample])
    assert scale.power == (2 if root else 1)
    found = with_reflectivity(clean, gray, rays, scale).reflectivity
    assert found is not None
    # Waves reach 0.8, which is what bright surfaces are taken for.
    for wall in (LEFT, RIGHT):
        assert np.median(np.abs(found / true - 1)[wall]) < 0.05


def test_a_texture_is_kept_and_noise_is_not():
    clean, rays = corner()
    out = with_reflectivity(clean, light(clean, painted()), rays, GrayScale(1.0, 1, 0.0))
    assert np.ptp(out.reflectivity[LEFT]) == 0
    assert out.reflectivity[LEFT][0, 0] == pytest.approx(0.2, rel=0.01)
    assert np.corrcoef(out.reflectivity[RIGHT].ravel(), painted()[RIGHT].ravel())[0, 1] > 0.99
    # 1 % is the noise; the factor of 2 is far beyond what the median of 1000 pixels can be off.
    assert 0.005 < np.median(out.reflectivity_spread[LEFT]) < 0.02
    assert np.median(out.reflectivity_spread[RIGHT]) > 0.1


def test_pixels_without_light_and_saturated_ones_are_filled_from_their_surface():
    clean, rays = corner()
    gray = light(clean, painted())
    gray[20:30, 10:20] = 0
    gray[30:40, 10:20] = np.nan
    out = with_reflectivity(clean, gray, rays, GrayScale(1.0, 1, 0.0))
    assert np.isfinite(out.reflectivity).all()
    assert out.reflectivity[20:40, 10:20] == pytest.approx(0.2, rel=0.01)


def test_a_mesh_without_surfaces_gives_no_reflectivity():
    clean, rays = corner(rough=0.05)
    gray = light(clean, painted())
    assert gray_samples(gray, clean, rays) is None
    assert with_reflectivity(clean, gray, rays, GrayScale(1.0, 1, 0.0)).reflectivity is None
    assert find_scale([]) is None
