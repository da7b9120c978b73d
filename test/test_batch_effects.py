"""Effects of many cameras at once: those of one at a time, pixel by pixel."""

import os
from pathlib import Path
import subprocess
import sys

from batches import DEVICES, look, scenes, WAYS
from flexx2_sim_ros.batch import BatchCamera, images
from flexx2_sim_ros.batch.effect_tables import BATCHED
from flexx2_sim_ros.camera import Camera, flexx2, Mode, Profile
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.errors import InputError
import numpy as np
import pytest
import warp as wp

MODES = ['Mode_5_30fps', 'Mode_9_30fps', 'Mode_9_5fps']
MATRIX = flexx2().intrinsics.matrix
# Strong enough that every one shows in these scenes.
STRONG = {
    'grazing_dropout': {'half_deg': 30.0},
    'lateral_noise': {'strength': 4.0},
    'low_signal_dropout': {'strength': 4.0},
    'range_wrap': {'strength': 4.0},
    'saturation': {'half': 0.5},
    'wiggling': {'strength': 4.0},
}
OFFSET = {'offset': {'bias': 0.05}}
EVERYTHING = tuple(registry()[name]() for name in BATCHED)


def film(count, frames):
    """Return clean depth that moves (frames, count, H, W) and reflectivity (count, H, W)."""
    still = scenes(count)
    generator = np.random.default_rng(1)
    shades = generator.uniform(0, 1, still.shape).astype(np.float32)
    shades[:, 60:90] *= 0.02
    shades[:, 100] = np.nan
    nearer = np.arange(frames, dtype=np.float32)[:, None, None, None] * np.float32(0.02)
    with np.errstate(invalid='ignore'):
        return np.where(still < 1.2, still + nearer, still), shades


def disagreement(device, effects, frames=3):
    """Return the share of pixels beyond 2e-5 m, and the share that the effects change."""
    clean, shades = film(3, frames)
    camera = BatchCamera(3, MODES, effects=effects, seed=2, device=device)
    plain = BatchCamera(3, MODES, seed=2, device=device)
    alone = [Camera(mode, seed=2 + i, effects=effects[i]) for i, mode in enumerate(MODES)]
    other = changed = 0.0
    for step in range(frames):
        seen = look(device, camera, clean[step], shades)
        base = look(device, plain, clean[step])
        changed += float((~np.isclose(seen, base, rtol=0, atol=1e-4, equal_nan=True)).mean())
        for i, one in enumerate(alone):
            stamp = step * round(1e9 / one.mode.rate_hz)
            wanted = one.capture(clean[step, i], MATRIX, stamp, shades[i]).depth
            other += (
                float((~np.isclose(seen[i], wanted, rtol=0, atol=2e-5, equal_nan=True)).mean()) / 3
            )
    return other / frames, changed / frames


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('name', BATCHED)
def test_batch_and_camera_agree_for_every_effect(name, device):
    """
    Assert 2e-5 m in all but one pixel of 10,000, where a decision flips.

    Measured on the CPU: at most 1e-6 m, and one pixel in 346,752 where storage rounds the other
    way.
    """
    effect = registry()[name](**STRONG.get(name, {}))
    other, changed = disagreement(device, [(effect,)] * 3)
    assert other <= 1e-4
    assert changed > 1e-3


@pytest.mark.parametrize(('device', 'many'), WAYS)
def test_batch_and_camera_agree_for_all_effects_together(device, many, monkeypatch):
    """Assert it in all but one pixel of 1,000: rounding to 4 mm after filters flips more often."""
    monkeypatch.setattr(images, 'many_threads', lambda _: many)
    other, changed = disagreement(device, [EVERYTHING] * 3, frames=2)
    assert other <= 1e-3
    assert changed > 0.5


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('stamp_at', [0.0, 0.5, 1.0])
def test_batch_and_camera_agree_where_edges_move(device, stamp_at):
    still, shades = film(3, 1)
    effects = {'motion_artefact': {'stretch': 1.5, 'stamp_at': stamp_at}}
    camera = BatchCamera(3, MODES, effects=effects, seed=2, device=device)
    alone = [Camera(mode, seed=2 + i, effects=effects) for i, mode in enumerate(MODES)]
    other = 0.0
    for step in range(4):
        clean, rho = (np.roll(image, (step, 5 * step), (1, 2)) for image in (still[0], shades))
        seen = look(device, camera, clean, rho)
        for i, one in enumerate(alone):
            stamp = step * round(1e9 / one.mode.rate_hz)
            wanted = one.capture(clean[i], MATRIX, stamp, rho[i]).depth
            differs = ~np.isclose(seen[i], wanted, rtol=0, atol=2e-5, equal_nan=True)
            other = max(other, float(differs.mean()))
    assert other < 1e-3


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('reach', [0.02, 0.2, 1.0])
def test_batch_and_camera_agree_on_what_other_poses_see(device, reach):
    """
    Assert it where `Camera` follows only rays that a nearer surface may cut, and a batch all.

    2e-5 m in all but one pixel of 10,000: compilers round places in different ways, and one on the
    border of two pixels may fall into the other one. Measured on the CPU: none.
    """
    generator = np.random.default_rng(3)
    most = dict.fromkeys('xyz', 0.2) | dict.fromkeys(('pitch_deg', 'yaw_deg', 'roll_deg'), 10.0)
    for _ in range(3):
        poses = [
            {'pose_error': {key: reach * generator.uniform(-x, x) for key, x in most.items()}}
            for _ in MODES
        ]
        other, changed = disagreement(device, poses, frames=1)
        assert other <= 1e-4
        assert changed > 0.1


@pytest.mark.parametrize(
    'own',
    [
        # Delays of less and of more than a frame, and of frames that are yet to come.
        [{'time_offset': {'latency': seconds}} for seconds in (0.02, 0.3, -0.05)],
        [{'stray_light': {'width': 0.05}}, (), {'stray_light': {'width': 1.0, 'share': 0.1}}],
        [(), {'multipath': {'gain': 3.0}}, {'multipath': None, 'stray_light': None}],
    ],
    ids=['time_offset', 'stray_light', 'multipath'],
)
@pytest.mark.parametrize(('device', 'many'), WAYS)
def test_each_environment_has_its_own_reflectivity_and_uptime(own, device, many, monkeypatch):
    """Assert 2e-5 m in all but 1 of 10,000 pixels: where light nearly cancels, phases differ."""
    monkeypatch.setattr(images, 'many_threads', lambda _: many)
    other, changed = disagreement(device, own, frames=4)
    assert other <= 1e-4
    assert changed > 1e-3


@pytest.mark.parametrize('name', ['time_offset', 'multipath'])
@pytest.mark.parametrize('device', DEVICES)
def test_cached_parts_of_a_scene_follow_the_scene(device, name):
    """A scene stands still, changes in one pixel, its reflectivity changes, its modes change."""
    scene, shades = film(2, 1)
    clean = scene[0, :, 20:90, 30:120].copy()
    shades = shades[:, 20:90, 30:120].copy()
    camera = BatchCamera(2, 'Mode_9_30fps', effects={name: None}, K=MATRIX, device=device)
    alone = [Camera('Mode_9_30fps', seed=i, effects={name: None}) for i in range(2)]
    stamps = np.zeros(2, np.int64)
    for step in range(8):
        if step == 2:
            clean[0, 34, 34] = 0.4  # in the middle of a patch
        if step == 4:
            shades[1] *= 0.5
        if step == 6:
            camera.set_usecase('Mode_5_30fps', np.array([True, False]))
            alone[0] = Camera('Mode_5_30fps', effects={name: None})
        if step == 7:  # stamps go back
            camera.stamps.zero_()
            stamps[:] = 0
        seen = look(device, camera, clean, shades)
        for i, one in enumerate(alone):
            wanted = one.capture(clean[i], MATRIX, stamps[i], shades[i]).depth
            np.testing.assert_allclose(seen[i], wanted, rtol=0, atol=2e-6)
            stamps[i] += round(1e9 / one.mode.rate_hz)


def as_mask(library, mask, device):
    if library == 'torch':
        return pytest.importorskip('torch').tensor(mask, device=device)
    if library == 'jax':
        return pytest.importorskip('jax').device_put(np.array(mask), wp.device_to_jax(device))
    if library == 'warp':
        return wp.array(mask, dtype=wp.bool, device=device)
    return np.repeat(mask, 2)[::2]  # not contiguous


@pytest.mark.parametrize('library', ['numpy', 'warp', 'torch', 'jax'])
@pytest.mark.parametrize('device', DEVICES)
def test_reset_forgets_the_chosen_environments(device, library):
    effects = [{'temporal_filter': {'share': 0.9}, 'warm_up_drift': {'tau': 1.0, 'bias': 0.1}}] * 3
    clean = np.full((3, 20, 30), 1.5, np.float32)
    camera, wanted = (BatchCamera(3, effects=effects, K=MATRIX, device=device) for _ in range(2))
    alone = [Camera(seed=i, effects=effects[0]) for i in range(3)]
    for step in range(4):
        if step == 2:
            camera.reset(as_mask(library, [False, True, False], device))
            alone[1].reset()
        seen = look(device, camera, clean).copy()
        for i, one in enumerate(alone):
            depth = one.capture(clean[i], MATRIX, step * round(1e9 / 30)).depth
            np.testing.assert_allclose(seen[i], depth, rtol=0, atol=2e-5)
    # All of them; and when stamps go back.
    for again in (lambda: camera.reset(), lambda: camera.stamps.zero_()):
        camera.stamps.zero_()
        camera.reset()
        again()
        np.testing.assert_array_equal(look(device, camera, clean), look(device, wanted, clean))
        look(device, camera, clean)
        wanted.reset()
        wanted.stamps.zero_()


@pytest.mark.parametrize('device', DEVICES)
def test_effects_and_modes_change_between_frames(device):
    clean = np.full((2, 20, 30), 1.5, np.float32)
    camera = BatchCamera(2, 'Mode_5_30fps', K=MATRIX, device=device)
    look(device, camera, clean)
    camera.set_effects({'offset': {'bias': 0.1}}, np.array([False, True]))
    camera.set_usecase('Mode_9_20fps', np.array([False, True]))
    seen = look(device, camera, clean)
    stamp = round(1e9 / 30)
    for i, (mode, effects) in enumerate(
        (('Mode_5_30fps', ()), ('Mode_9_20fps', {'offset': {'bias': 0.1}}))
    ):
        depth = Camera(mode, seed=i, effects=effects).capture(clean[i], MATRIX, stamp).depth
        np.testing.assert_allclose(seen[i], depth, rtol=0, atol=2e-5)
    camera.set_effects(())
    np.testing.assert_allclose(
        look(device, camera, clean)[0],
        Camera('Mode_5_30fps').capture(clean[0], MATRIX, 2 * stamp).depth,
        rtol=0,
        atol=2e-5,
    )


def test_every_effect_of_the_registry_has_a_kernel():
    package = Effect.__module__.rpartition('.')[0]
    own = {name for name, kind in registry().items() if kind.__module__.startswith(package)}
    assert own <= set(BATCHED)


@pytest.mark.parametrize('device', DEVICES)
def test_batch_and_camera_agree_for_effects_without_a_kernel(device, caplog):
    """Assert it to the bit beside an environment that kernels compute, and that it is said."""
    curve = {'knots': [0.5, 2.0], 'values': [0.01, 0.03]}
    patch = {'residual_patch': {'bias_0': 0.02}, 'offset': {'curve': curve}}
    other, changed = disagreement(device, [{**patch, 'temporal_filter': None}, OFFSET, ()])
    assert other <= 1e-4
    assert changed > 0.3
    assert 'offset, residual_patch: no kernel, 1 environments' in caplog.text


def test_unusable_sets_of_effects_are_refused():
    camera = BatchCamera(2, device='cpu')
    with pytest.raises(InputError, match='must be one set, or one for each of the 2 .*, got 3'):
        camera.set_effects([{}, {}, {}])
    with pytest.raises(InputError, match='offset.bias: must be .*, got 9'):
        camera.set_effects({'offset': {'bias': 9}})
    BatchCamera(2, effects={'stray_light': {'strength': 0}}, device='cpu')  # off


def test_effects_that_need_more_than_the_profile_are_refused():
    known = flexx2().mode('Mode_9_30fps')
    silent = Mode(**{**vars(known), 'name': 'silent', 'modulation_hz': ()})
    profile = Profile('other', flexx2().intrinsics, (known, silent))
    camera = BatchCamera(
        2, 'Mode_9_30fps', profile=profile, effects={'wiggling': None}, device='cpu'
    )
    with pytest.raises(InputError, match=r'effects: wiggling: .*modes\.silent\.modulation_hz'):
        camera.set_usecase('silent', np.array([True, False]))
    clean = np.full((2, 4, 5), 2.0, np.float32)
    plain, moved = (
        BatchCamera(2, 'silent', profile=profile, effects=effects, device='cpu')(clean)
        for effects in ({}, {'offset': {'bias': 0.05}})
    )
    np.testing.assert_allclose(moved - plain, 0.05, atol=1e-6)
    many = [{'intrinsics_error': {'cx': i / 10}} for i in range(65)]
    with pytest.raises(
        InputError, match='intrinsics_error: must have at most .* different sets .*, got 65'
    ):
        BatchCamera(65, effects=many, device='cpu')(np.ones((65, 3, 3), np.float32))


def test_unusable_reflectivity_and_masks_are_refused():
    camera = BatchCamera(2, effects={'offset': None}, device='cpu')
    clean = np.ones((2, 4, 5), np.float32)
    with pytest.raises(InputError, match=r'reflectivity: must have shape .*, got \(2, 4, 6\)'):
        camera(clean, np.ones((2, 4, 6), np.float32))
    with pytest.raises(InputError, match='reflectivity: must be ndarray, as depth is, got array'):
        camera(clean, wp.ones((2, 4, 5), device='cpu'))
    for mask in (np.ones(2), np.ones(3, bool)):
        with pytest.raises(InputError, match='env_mask: must'):
            camera.reset(mask)
    with pytest.raises(InputError, match='env_mask: must be .*, got list'):
        camera.reset([True, False])


_EVERY_SIZE = """
import numpy as np
import warp as wp
wp.config.mode = 'debug'
from flexx2_sim_ros.batch import arrays, BatchCamera, images
from flexx2_sim_ros.batch.effect_tables import BATCHED
generator = np.random.default_rng(0)
table = dict.fromkeys(BATCHED)
table['lateral_noise'] = {'factor': 5.0, 'strength': 4.0}
for images.many_threads in (lambda _: True, lambda _: False):
    for height, width in ((1, 1), (1, 6), (7, 1), (2, 2), (3, 5), (18, 33)):
        clean = generator.choice([0.2, 1.0, 1.1, 5.0, np.nan], (9, height, width))
        clean = clean.astype(np.float32)
        for effects in ((), table):
            camera = BatchCamera(9, effects=effects, device='cpu')
            for _ in range(2):
                camera(clean, clean)
print('within bounds', flush=True)

@wp.kernel
def beyond(a: wp.array(dtype=wp.float32)):
    arrays.put(a, a.shape[0], 1.0)

wp.launch(beyond, 1, [wp.zeros(4, device='cpu')], device='cpu')
print('not noticed')
"""


def test_no_size_reads_or_writes_out_of_bounds(tmp_path):
    """Every access is checked in Warp's debug mode, which ends the process at the first one."""
    script = tmp_path / 'every_size.py'
    script.write_text(_EVERY_SIZE)
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, 'PYTHONPATH': str(root)},
    )
    assert 'within bounds' in done.stdout, done.stderr
    assert 'not noticed' not in done.stdout
    assert done.returncode != 0
