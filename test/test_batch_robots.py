"""Many robots at once: what they see of the stairs that they walk on."""

from flexx2_sim_ros.batch.height_grid import HeightGrid
from flexx2_sim_ros.batch.rendering import open_batch_renderer
from flexx2_sim_ros.batch.walking import walk
from flexx2_sim_ros.camera import Intrinsics
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
