"""The example of mjlab, in mjlab: its manager, its renderer, its resets and randomisation."""

import importlib

from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.rendering.renderer import open_renderer
import mujoco
import numpy as np
import pytest
from simulators import assert_noise_is_sigma

torch = pytest.importorskip('torch')
pytest.importorskip('mjlab')
example = importlib.import_module('mjlab_go1')  # in examples/, which needs mjlab

COUNT, WIDTH, HEIGHT = 64, 56, 43
EFFECTS = [{}] * 32 + example.different_cameras(32)
SHOWN = []  # every clean image of front_left, in the order of calls


class Recorded(example.DepthImages):
    """Depth images that are kept, by a reference that survives the manager's deep copies."""

    def __call__(self, env):
        """Return the images and keep a copy."""
        images = super().__call__(env)
        SHOWN.append(images.clone())
        return images


@pytest.fixture(scope='module')
def cfg():
    """Return the example's task, with small images."""
    cfg = example.task(COUNT, WIDTH, HEIGHT, EFFECTS)
    cfg.observations['images'].terms['front_left'].params['depth'] = Recorded('front_left')
    return cfg


@pytest.fixture(scope='module')
def env(cfg):
    """Return the environment after some steps, two of its robots reset."""
    env = example.ManagerBasedRlEnv(cfg, device='cpu')
    env.reset()
    env.seen, *_ = env.step(torch.zeros(COUNT, env.action_manager.total_action_dim))
    env.seen, _ = env.reset(env_ids=torch.tensor([1, 40]))
    yield env
    env.close()


@pytest.fixture(scope='module')
def lens(cfg):
    """Return the intrinsics of the images."""
    return cfg.observations['actor'].terms['height_scan'].params['lens']


def mujoco_state(env, index):
    """Return one environment, with its randomised cameras, as MuJoCo's model and data."""
    model = env.sim.mj_model
    for name in ('cam_pos', 'cam_quat'):
        getattr(model, name)[:] = getattr(env.sim.model, name)[index].numpy()
    data = mujoco.MjData(model)
    data.qpos[:] = env.sim.data.qpos[index].numpy()
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize('index', [0, 1, 40])
def test_clean_depth_is_that_of_exact_rays(env, lens, index):
    model, data = mujoco_state(env, index)
    exact, _ = open_renderer(model, lens, 'ray').render(data, 'robot/front_right')
    depth = env.scene['front_right'].data.depth[index, ..., 0].numpy()
    off = np.abs(np.nan_to_num(exact) - depth)
    assert (depth > 0).mean() > 0.3
    assert np.percentile(off, 98) < 1e-3  # the rest are edges, and floors beyond the far plane


def test_the_manager_makes_the_frames_of_the_camera_and_resets_them(env, lens):
    # The manager calls each term when it is made, after the reset, after the step, and after
    # the second reset.
    first, start, step, last = SHOWN
    camera = BatchCamera(
        COUNT,
        example.USECASE,
        name='front_left',
        K=lens.matrix,
        effects=EFFECTS,
        device='cpu',
        invalid_value='zero',
    )
    camera(first[..., 0], steps=1)
    camera.reset(None)
    camera(start[..., 0], steps=1)
    camera(step[..., 0], steps=1)
    mask = np.zeros(COUNT, bool)
    mask[[1, 40]] = True
    camera.reset(mask)
    expected = camera(last[..., 0], steps=0)  # at the time of the step, in the other robots
    assert torch.equal(env.seen['images']['front_left'][..., 0], expected)


def test_the_noise_is_sigma_of_the_base_model(env, lens):
    clean, noisy = SHOWN[-1][:32, ..., 0], env.seen['images']['front_left'][:32, ..., 0]
    assert_noise_is_sigma(clean.numpy(), noisy.numpy(), lens, example.USECASE)


def test_each_environment_has_a_camera_of_its_own(env):
    clean, noisy = SHOWN[-1][..., 0].numpy(), env.seen['images']['front_left'][..., 0].numpy()
    before = SHOWN[1][..., 0].numpy()  # what the filter mixes in, while the robots fall
    before[40] = clean[40]  # but not after the reset
    for index in range(32, COUNT):
        near = (noisy[index] > 0) & (clean[index] < 0.8)
        share = EFFECTS[index]['temporal_filter']['share']
        wanted = (1 - share) * clean[index] + share * before[index]
        bias = EFFECTS[index]['offset']['bias']
        # Some hundred pixels of 3 mm: a median error of 1.5 mm is beyond 6 sigma.
        assert np.median((noisy[index] - wanted)[near]) == pytest.approx(bias, abs=1.5e-3)
    model = env.sim.model.cam_pos
    ids = [env.sim.mj_model.camera(f'robot/{name}').id for name in example.CAMERAS]
    assert (model[:, ids].std(dim=0) > 1e-3).all()


def test_the_height_grid_is_the_ground(env, lens):
    grids = {group: example.height_grid(env, env.seen, group) for group in ('actor', 'critic')}
    assert (grids['critic'] != example.UNSEEN).float().mean() > 0.3
    errors = []
    for index in range(0, COUNT, 8):
        model, data = mujoco_state(env, index)
        trunk = model.body('robot/trunk').id
        robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[trunk]
        rotation, place = data.xmat[trunk].reshape(3, 3), data.xpos[trunk]
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        cells = np.stack(np.meshgrid(example.AHEAD, example.LEFT, indexing='ij'), axis=-1)
        ground = SceneGround(model, data, robot)
        truth = ground.heights(place[:2] + cells @ turn.T, place[2] + 1.0) - place[2]
        grid = grids['critic'][index].numpy()
        errors.append((grid - truth)[grid != example.UNSEEN])
    # A step within a cell moves the mean of its points; treads are level.
    assert np.median(np.abs(np.concatenate(errors))) < 2e-3
    both = (grids['actor'] != example.UNSEEN) & (grids['critic'] != example.UNSEEN)
    difference = (grids['actor'] - grids['critic'])[both].abs()
    assert 1e-5 < difference.median() < 1e-2


def test_the_picture_is_drawn(env, tmp_path):
    example.draw(tmp_path / 'grid.png', env, env.seen)
    assert (tmp_path / 'grid.png').stat().st_size > 20_000
