"""The example of PyBullet, in PyBullet: its z-buffer becomes depth, and depth gets noise."""

import importlib
import sys

from flexx2_sim_ros.camera import Camera, depth_from_z_buffer
import numpy as np
import pytest
from simulators import assert_noise_is_sigma, assert_same_depth, exact_room
from small_room import FAR, LENS, NEAR, USECASE

pytest.importorskip('pybullet')
example = importlib.import_module('pybullet_depth')  # in examples/, which needs pybullet


@pytest.fixture(scope='module')
def buffer():
    """Return the z-buffer of the room."""
    return example.z_buffer(example.build())


def test_a_z_buffer_is_not_depth(buffer):
    exact = exact_room()
    # Everything is between 0.95 and 1, as if it were a wall at 1 m.
    assert np.nanmin(exact) < 1.1
    assert np.nanmax(exact) > 2.9
    assert buffer.min() > 0.95
    assert (buffer == 1.0)[np.isnan(exact)].all()
    assert_same_depth(depth_from_z_buffer(buffer, NEAR, FAR), exact)


def test_the_noise_is_sigma_of_the_base_model(buffer):
    clean = depth_from_z_buffer(buffer, NEAR, FAR)
    noisy = Camera(USECASE, seed=3).capture(clean, LENS.matrix, stamp=0.0).depth
    assert_noise_is_sigma(clean[None], noisy[None], LENS, USECASE)


def test_the_picture_is_drawn(tmp_path, monkeypatch):
    out = tmp_path / 'depth.png'
    monkeypatch.setattr(sys, 'argv', ['pybullet_depth.py', '--out', str(out)])
    example.main()
    assert out.stat().st_size > 15_000
