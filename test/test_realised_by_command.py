"""The frames that the benchmark's realised reduction is measured on are those of the command."""

from campaigns import all_but
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.recording import load_recording
import numpy as np
import pytest
from study.blind import BlindCamera, Case, SceneKey

MODE = 'Mode_9_30fps'


def recorded(folder, seed, effects):
    """Record six scenes with the blind camera: a drift takes as many."""
    folder.mkdir()
    key = SceneKey(MODE, seed, 0.0, 112, 86, recordings=6, frames=8)
    BlindCamera(Case(key, effects, 5)).record(folder)
    return folder


# A fitted form, a map in a side file, a drift that depends on the time since power-on.
@pytest.mark.parametrize('name', ['wiggling', 'fixed_pattern', 'warm_up_drift'])
def test_the_command_simulates_new_scenes_as_the_benchmark_does(tmp_path, name):
    campaign = recorded(tmp_path / 'campaign', 31, {name: 2.0})
    table = diagnose(campaign, out=tmp_path / 'out', without=all_but(name, 'pose_error'))
    effects = {one['name']: one['parameters'] for one in table['effects']}
    assert name in effects
    effects.pop('pose_error', None)  # the benchmark leaves it out, as effects.yaml does
    fresh = sorted(recorded(tmp_path / 'fresh', 32, {name: 2.0}).iterdir())[0]
    again = tmp_path / 'again.npz'
    written = str(tmp_path / 'out' / 'effects.yaml')
    command = ['simulate', str(fresh), str(again), '--usecase', MODE, '--effects', written]
    assert main([*command, '--seed', '1']) == 0
    scene = load_recording(fresh)
    if name == 'warm_up_drift':
        effects[name]['uptime'] = float(scene.extra['uptime'].flat[0])
    inputs = scene.clean_depth, scene.K, scene.stamp_ns, scene.reflectivity
    seen = Camera(MODE, effects=effects, seed=1).capture(*inputs).depth
    np.testing.assert_array_equal(load_recording(again).depth, seen)
    plain = Camera(MODE, seed=1).capture(*inputs).depth
    assert not np.array_equal(seen, plain, equal_nan=True)
