"""Many sets of effects on the same frames: sharing what they have in common changes nothing."""

from bench.gap_campaigns import look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.features.catalogue import catalogue
import numpy as np
import pytest

K = flexx2().intrinsics.matrix * [[0.5], [0.5], [1]]
STAMPS = 1_000_000_000 + np.arange(4) * 33_000_000


def scene(moving, still_albedo=False):
    room = make_room(np.random.default_rng(2))
    views = [
        look(room, K, (86, 112), optical(0.1, 0.35, 0.0), np.array([0.02 * t, 0.1, 0.6]))
        for t in range(len(STAMPS) if moving else 1)
    ]
    depth, albedo = (np.stack(images) for images in zip(*views, strict=True))
    depth[:, 5:9, 5:20] = np.nan
    albedo[:, 40, 3:7] = np.nan
    albedo = albedo[0] if still_albedo else albedo
    return (depth, albedo) if moving else (depth[0], albedo[0])


@pytest.mark.parametrize(('moving', 'lit'), [(False, False), (True, False), (True, True)])
def test_frames_do_not_depend_on_effects_simulated_before(moving, lit):
    clean, albedo = scene(moving, lit)
    tables = [
        {},
        *(column.effects for column in catalogue()[0]),
        *({name: {'strength': 1.3}} for name in registry()),
        {'pose_error': {}, 'lateral_noise': {}, 'saturation': {}},
        {'lateral_noise': {}, 'range_wrap': {}},
        {name: {} for name in registry()},
        {},
    ]
    shared, alone = (
        CommonRandomNumbers(Camera(seed=3, name='gap'), clean, K, STAMPS, albedo, sharing)
        for sharing in (True, False)
    )
    before = clean.copy(), albedo.copy()
    for table in tables:
        if table:
            camera = Camera(seed=3, name='gap', effects=table)
            wanted = camera.capture(clean, K, STAMPS, albedo).depth
        else:  # A camera without effects has compiled loops, which round otherwise.
            wanted = alone.depth(table)
        assert np.array_equal(shared.depth(table), wanted, equal_nan=True), table
    assert all(
        np.array_equal(one, other, equal_nan=True)
        for one, other in zip((clean, albedo), before, strict=True)
    )


def test_cached_simulations_belong_to_their_scene():
    clean, _ = scene(False)
    retakes = CommonRandomNumbers(Camera(seed=3), clean, K, STAMPS)
    plain = retakes.depth({})
    nearer = retakes.depth(
        {'pose_error': {'x': 0, 'y': 0, 'z': 0.05, 'pitch_deg': 0, 'yaw_deg': 0, 'roll_deg': 0}}
    )
    assert np.nanmedian(plain - nearer) == pytest.approx(0.05, abs=0.01)
    assert np.array_equal(retakes.depth({}), plain, equal_nan=True)
