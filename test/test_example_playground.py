"""The example of mujoco_playground, on MJX: its rays become depth, and depth gets noise."""

import importlib

from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import ray_length
import numpy as np
import pytest
from simulators import assert_noise_is_sigma, assert_same_depth
from small_room import USECASE

pytest.importorskip('mujoco_playground')
jax = importlib.import_module('jax')
mujoco = importlib.import_module('mujoco')
example = importlib.import_module('playground_cheetah')  # in examples/, which needs playground

COUNT, LENS = 8, example.lens(112, 86)


@pytest.fixture(scope='module')
def made():
    """Return the environment and the states of some of them."""
    return example.build(COUNT)


@pytest.fixture(scope='module')
def clean(made):
    """Return (N, H, W) depth, a JAX array."""
    return example.cast(*made, example.directions(LENS)).reshape(COUNT, LENS.height, LENS.width)


def test_depth_is_that_of_mujoco(made, clean):
    env, states = made
    data = mujoco.MjData(env.mj_model)
    camera = env.mj_model.camera(example.CAMERA).id
    rays = np.asarray(example.directions(LENS), float)
    for index in (0, COUNT - 1):
        data.qpos[:] = states.qpos[index]
        mujoco.mj_forward(env.mj_model, data)
        along = rays @ data.cam_xmat[camera].reshape(3, 3).T
        eye, geom = data.cam_xpos[camera], np.zeros(1, np.int32)
        exact = [mujoco.mj_ray(env.mj_model, data, eye, one, None, 1, -1, geom) for one in along]
        exact = np.where(np.array(exact) > 0, exact, np.nan).reshape(clean.shape[1:])
        found = np.where(clean[index] > 0, clean[index], np.nan)
        # In float32, what is 10 m away may be 1 mm off.
        near = ~(exact > 8.0)
        assert_same_depth(np.where(near, found, np.nan), np.where(near, exact, np.nan))


def test_rays_of_length_1_give_no_depth(made, clean):
    rays = example.directions(LENS)
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    env, states = made
    first = jax.tree.map(lambda value: value[:1], states)
    radial = np.asarray(example.cast(env, first, unit)).reshape(clean.shape[1:])
    near = (clean[0] > 0) & (clean[0] < 7)
    assert np.max((radial - clean[0])[near]) > 0.2
    np.testing.assert_allclose(
        (radial / ray_length(LENS.matrix, radial.shape))[near], clean[0][near], rtol=1e-4
    )


def test_the_noise_is_sigma_of_the_base_model(clean):
    seen = BatchCamera(COUNT, USECASE, K=LENS.matrix, seed=3)(clean)
    assert isinstance(seen, jax.Array)
    assert_noise_is_sigma(np.asarray(clean), np.asarray(seen), LENS, USECASE)
