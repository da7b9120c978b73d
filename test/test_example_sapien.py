"""The example of SAPIEN, in SAPIEN: its positions become depth, and depth gets noise."""

import importlib
import os
from pathlib import Path

from flexx2_sim_ros.camera import Camera, depth_from_z_buffer
import numpy as np
import pytest
from simulators import assert_noise_is_sigma, assert_same_depth, exact_room
from small_room import FAR, LENS, NEAR, USECASE

pytest.importorskip('sapien')
CHROMIUM = Path('/usr/lib/chromium/vk_swiftshader_icd.json')  # Vulkan on the CPU
if CHROMIUM.is_file():
    os.environ.setdefault('VK_ICD_FILENAMES', str(CHROMIUM))
# Vulkan lets a driver round the corners of triangles to 1/16 pixel (subPixelPrecisionBits of 4).
# SwiftShader does, so rays pass up to half of that beside the centres of pixels.
ROUNDING = 1 / 32 + 1e-4  # pixels, with what float32 adds
example = importlib.import_module('sapien_depth')  # in examples/, which needs sapien


@pytest.fixture(scope='module')
def position():
    """Return the room's positions; the first picture compiles shaders for a minute on a CPU."""
    try:
        made = example.build()
    except RuntimeError as error:
        pytest.skip(f'no Vulkan: {error}')
    return example.positions(*made)


def off_centre(position):
    """Return (2, H, W) how far points are below and to the right of pixel centres, pixels."""
    x, y, z, buffer = np.moveaxis(position.astype(float), -1, 0)
    there = buffer < 1.0
    z = np.where(there, -z, 1.0)
    pixels = np.stack([LENS.cy - LENS.fy * y / z, LENS.cx + LENS.fx * x / z])
    return np.where(there, pixels - np.mgrid[: LENS.height, : LENS.width], 0.0)


def test_rays_pass_through_the_centres_of_pixels(position):
    assert np.abs(off_centre(position)).max() < ROUNDING


def test_positions_are_in_the_axes_of_opengl(position):
    exact = exact_room()
    assert (position[..., 2] <= 0).all()  # taken for depth, nothing has a return
    assert (position[np.isnan(exact)] == (0.0, 0.0, 0.0, 1.0)).all()
    exact = exact_room(off_centre=off_centre(position))
    assert_same_depth(example.depth(position), exact)
    assert_same_depth(depth_from_z_buffer(position[..., 3], NEAR, FAR), exact)


def test_the_noise_is_sigma_of_the_base_model(position):
    clean = example.depth(position)
    noisy = Camera(USECASE, seed=3).capture(clean, LENS.matrix, stamp=0.0).depth
    assert_noise_is_sigma(clean[None], noisy[None], LENS, USECASE)
