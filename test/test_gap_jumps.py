"""Features at depth jumps that a pose error cannot imitate."""

from bench.gap_campaigns import look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.gap.data.axes import axes_of
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.features.features import Feature, features, LAYOUT
from flexx2_sim_ros.gap.features.sums import accumulate
import numpy as np
import pytest

MODE = flexx2().mode('Mode_9_30fps')
K = flexx2().intrinsics.matrix.copy()
K[:2] *= 0.5
K[:2, 2] -= 0.25
SIZE = 86, 112
FRAMES = 16
ROOM = make_room(np.random.default_rng(2))


def seen(shift):
    """Return clean depth and reflectivity from a camera that was moved sideways, metres."""
    return look(ROOM, K, SIZE, optical(0.1, 0.35, 0.0), np.array([0.0, 0.1 + shift, 0.6]))


def at_jumps(shift=0.0, **effects):
    """Return the two features of a camera whose given pose is wrong by a shift."""
    clean, rho = seen(0.0)
    stamps = np.arange(FRAMES) / 30
    depth = Camera(effects=effects, seed=1).capture(*_swapped(seen(shift), K, stamps)).depth
    scene = look_at(clean, None, 0.0, rho, K, MODE, axes_of(flexx2()))
    values, _ = features(accumulate(depth, [scene], np.arange(FRAMES) == 0, 0))
    names = 'jump_between', 'jump_switches'
    between, switches = (values[LAYOUT.index(Feature(name, 'structure', 0))] for name in names)
    return float(between), float(switches)


def _swapped(view, *rest):
    # In the order of `Camera.capture`.
    return view[0], *rest, view[1]


@pytest.mark.parametrize(
    ('index', 'effects'),
    [(0, {'flying_pixels': {'strength': 0.5}}), (1, {'lateral_noise': {'strength': 0.5}})],
)
def test_an_edge_effect_shows_and_a_pose_error_does_not(index, effects):
    """
    Assert that half of an effect changes its feature more than a pose error of 5 mm.

    It cannot fail by chance: scene and noise have fixed seeds.
    """
    plain = at_jumps()[index]
    effect = at_jumps(**effects)[index] - plain
    moved = [abs(at_jumps(shift)[index] - plain) for shift in (-0.005, 0.005)]
    assert effect > 0.005
    assert max(moved) < 0.5 * effect


def test_a_moving_scene_has_no_switches():
    clean, rho = seen(0.0)
    scene = look_at(clean, None, 0.0, rho, K, MODE, axes_of(flexx2()))
    depth = np.array([clean, clean])
    sums = accumulate(depth, [scene, scene], np.array([True, False]), 0)
    values, _ = features(sums)
    assert np.isnan(values[LAYOUT.index(Feature('jump_switches', 'structure', 0))])
