"""Many robots at once: the example of the height grid, and terms for other people's training."""

import inspect
from types import SimpleNamespace

from batches import scenes
from flexx2_sim_ros.batch import noisy_depth
from flexx2_sim_ros.batch.height_grid import HeightGrid
from flexx2_sim_ros.batch.rendering import open_batch_renderer
from flexx2_sim_ros.batch.walking import walk
from flexx2_sim_ros.camera import Camera, flexx2, Intrinsics
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.robots.model import build_model
import numpy as np
import pytest
import warp as wp

CAMERAS = ('front_left', 'front_right')
SMALL = Intrinsics.from_field_of_view(56, 43, 56, 44)


def test_walking_robots_see_the_stairs_they_walk_on():
    model = build_model(scene='stairs', intrinsics=SMALL)
    assert not np.array_equal(
        walk(model, CAMERAS, 1, 1, 0.25, seed=-1).qpos, walk(model, CAMERAS, 1, 1, 0.25).qpos
    )
    walks = walk(model, CAMERAS, 6, 6, 0.25, seed=3)
    renderer = open_batch_renderer(model, CAMERAS, SMALL, 6, wp.get_device('cpu'), 'ray')
    assert renderer.backend == 'ray'
    grid = HeightGrid(6, SMALL, 'cpu', least=1)
    for frame in range(6):
        for index, image in enumerate(renderer.render(walks.qpos[frame])):
            grid.add(
                image,
                walks.camera_position[frame, :, index],
                walks.camera_rotation[frame, :, index],
            )
    error = grid.heights().numpy() - walks.heights
    seen = np.isfinite(error)
    assert seen.mean() > 0.4
    # Elsewhere the ground steps between a cell's points.
    assert np.median(np.abs(error[seen])) < 1e-3
    assert np.ptp(walks.heights) > 0.3


def test_mujoco_warp_renders_the_same():
    pytest.importorskip('mujoco_warp')
    model = build_model(scene='stairs', intrinsics=SMALL)
    qpos = walk(model, CAMERAS, 3, 1, 0.2).qpos[0]
    ours, theirs = (
        open_batch_renderer(model, CAMERAS, SMALL, 3, wp.get_device('cpu'), name).render(qpos)
        for name in ('ray', 'mujoco-warp')
    )
    for one, other in zip(ours, theirs, strict=True):
        off = np.abs(np.nan_to_num(one.numpy()) - other.numpy())
        assert np.percentile(off, 98) < 1e-4


def test_flexx2_batch(tmp_path, capsys):
    out = tmp_path / 'grid.png'
    arguments = ['batch', '--num-envs', '3', '--frames', '2', '--device', 'cpu', '--out', str(out)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert 'with - without' in printed
    assert out.stat().st_size > 20_000
    for wrong, said in (
        (['--num-envs', '0'], '--num-envs: must be'),
        (['--usecase', 'Mode_1'], 'usecase: must be'),
        (['--renderer', 'blender'], "got 'blender'"),
        (['--device', 'cuda:9'], "got 'cuda:9'"),
        (['--out', str(tmp_path / 'no' / 'grid.png')], 'there is no'),
    ):
        assert main([*arguments, *wrong]) == 2
        assert said in capsys.readouterr().err


class ManagerTermBase:
    """What Isaac Lab's class terms inherit from, as documented."""

    def __init__(self, cfg, env):
        self.cfg, self._env = cfg, env

    def reset(self, env_ids=None):
        raise AssertionError('not overridden')


class StandIn:
    """What an observation manager does with a class term, as documented."""

    def __init__(self, func, params, base, images):
        self.num_envs, self.device, self.images = len(images[0]), 'cpu', images
        self.cfg = SimpleNamespace(func=func, params=params)
        # Isaac Lab checks both before it makes the term.
        assert issubclass(func, base)
        named = list(inspect.signature(func.__call__).parameters.values())[2:]
        assert {p.name for p in named if p.default is p.empty} <= set(params)
        assert set(params) <= {p.name for p in named}
        self.cfg.func = func(cfg=self.cfg, env=self)

    def step(self):
        self.image = self.images.pop(0)
        return self.cfg.func(self, **self.cfg.params)


@pytest.mark.parametrize('library', ['numpy', 'torch'])
@pytest.mark.parametrize('base', [object, ManagerTermBase])
def test_observation_term(base, library):
    clean = np.full((3, 24, 32), 1.2, np.float32)
    made = [
        pytest.importorskip('torch').from_numpy(clean)[..., None]
        if library == 'torch'
        else clean[..., None]
    ] * 4
    effects = {'temporal_filter': {'share': 0.9}}
    matrix = [[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]]
    manager = StandIn(
        noisy_depth(base),
        {
            'depth': lambda env: env.image,
            'camera': {'mode': 'Mode_9_20fps', 'effects': effects, 'seed': 5, 'K': matrix},
        },
        base,
        made,
    )
    term = manager.cfg.func
    term.reset()
    kind = type(made[0])
    alone = [Camera('Mode_9_20fps', seed=5 + i, effects=effects) for i in range(3)]
    kept = []
    for step, env_ids in enumerate(([], [1], None, [0, 2])):
        seen = manager.step()
        kept.append(seen)
        assert type(seen) is kind
        assert tuple(seen.shape) == (3, 24, 32, 1)
        for i, one in enumerate(alone):
            wanted = one.capture(clean[i], matrix, step * 50_000_000).depth
            np.testing.assert_allclose(np.asarray(seen)[i, ..., 0], wanted, rtol=0, atol=2e-5)
        term.reset(env_ids)
        for i in range(3) if env_ids is None else env_ids:
            alone[i].reset()
    assert not np.array_equal(np.asarray(kept[0]), np.asarray(kept[1]))


def test_terms_give_zero_where_invalid():
    clean = scenes(2)
    term = noisy_depth()(
        cfg=SimpleNamespace(params={}), env=SimpleNamespace(num_envs=2, device='cpu')
    )
    seen = term(None, lambda env: clean)
    wanted = Camera().capture(clean[0], flexx2().intrinsics.matrix, 0).depth
    np.testing.assert_allclose(seen[0], np.nan_to_num(wanted), rtol=0, atol=2e-5)
