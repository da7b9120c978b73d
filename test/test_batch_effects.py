"""Effects of many cameras at once: those of one at a time, pixel by pixel."""

import os

from batches import arrays_of, DEVICES, look, scenes, WAYS
from flexx2_sim_ros.batch import BatchCamera, images
from flexx2_sim_ros.batch.effect_tables import BATCHED
from flexx2_sim_ros.camera import Camera, flexx2, Mode, Profile
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.errors import InputError
import numpy as np
from programs import ROOT, run_python
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


def film(frames):
    """Return frames of 3 scenes that pass by: clean depth, reflectivity; each (3, H, W)."""
    still = scenes(3)
    generator = np.random.default_rng(1)
    shades = generator.uniform(0, 1, still.shape).astype(np.float32)
    shades[:, 60:90] *= 0.02
    shades[:, 100] = np.nan
    depths = [still + np.float32(0.02 * step) * (still < 1.2) for step in range(frames)]
    return [
        (np.roll(one, 2 * t, axis=2), np.roll(shades, 2 * t, axis=2))
        for t, one in enumerate(depths)
    ]


def disagreement(device, effects, frames):
    """Return the share of pixels beyond 2e-5 m, and the share that the effects change."""
    camera = BatchCamera(3, MODES, effects=effects, seed=2, device=device)
    plain = BatchCamera(3, MODES, seed=2, device=device)
    alone = [Camera(mode, seed=2 + i, effects=effects[i]) for i, mode in enumerate(MODES)]
    other = changed = 0.0
    for step, (clean, shades) in enumerate(frames):
        seen = look(device, camera, clean, shades)
        base = look(device, plain, clean)
        changed += np.mean(~np.isclose(seen, base, rtol=0, atol=1e-4, equal_nan=True))
        wanted = [
            one.capture(clean[i], MATRIX, step * round(1e9 / one.mode.rate_hz), shades[i]).depth
            for i, one in enumerate(alone)
        ]
        other += np.mean(~np.isclose(seen, wanted, rtol=0, atol=2e-5, equal_nan=True))
    return other / len(frames), changed / len(frames)


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('name', BATCHED)
def test_batch_and_camera_agree_for_every_effect(name, device):
    """
    Assert 2e-5 m in all but one pixel of 10,000, where a decision flips.

    Measured on the CPU: at most 1e-6 m, and one pixel in 346,752 where storage rounds the other
    way.
    """
    effect = registry()[name](**STRONG.get(name, {}))
    other, changed = disagreement(device, [(effect,)] * 3, film(3))
    assert other <= 1e-4
    assert changed > 1e-3


@pytest.mark.parametrize(('device', 'many'), WAYS)
def test_batch_and_camera_agree_for_all_effects_together(device, many, monkeypatch):
    """Assert it in all but one pixel of 1,000: rounding to 4 mm after filters flips more often."""
    monkeypatch.setattr(images, 'many_threads', lambda _: many)
    other, changed = disagreement(device, [EVERYTHING] * 3, film(2))
    assert other <= 1e-3
    assert changed > 0.5


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('stamp_at', [0.0, 0.5, 1.0])
def test_batch_and_camera_agree_where_edges_move(device, stamp_at):
    (images,) = film(1)
    frames = [[np.roll(image, (step, 5 * step), (1, 2)) for image in images] for step in range(4)]
    effects = [{'motion_artefact': {'stretch': 1.5, 'stamp_at': stamp_at}}] * 3
    other, changed = disagreement(device, effects, frames)
    assert other < 1e-4
    assert changed > 1e-3


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
        other, changed = disagreement(device, poses, film(1))
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
    other, changed = disagreement(device, own, film(4))
    assert other <= 1e-4
    assert changed > 1e-3


@pytest.mark.parametrize('name', ['time_offset', 'multipath'])
@pytest.mark.parametrize('device', DEVICES)
def test_cached_parts_of_a_scene_follow_the_scene(device, name):
    """A scene stands still, changes in one pixel, its reflectivity changes, its modes change."""
    clean, shades = (image[:2, 20:90, 30:120].copy() for image in film(1)[0])
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


@pytest.mark.parametrize('library', ['numpy', 'warp', 'torch', 'jax'])
@pytest.mark.parametrize('device', DEVICES)
def test_reset_forgets_the_chosen_environments(device, library):
    effects = [{'temporal_filter': {'share': 0.9}, 'warm_up_drift': {'tau': 1.0, 'bias': 0.1}}] * 3
    clean = np.full((3, 20, 30), 1.5, np.float32)
    camera, wanted = (BatchCamera(3, effects=effects, K=MATRIX, device=device) for _ in range(2))
    alone = [Camera(seed=i, effects=effects[0]) for i in range(3)]
    for step in range(4):
        if step == 2:
            camera.reset(arrays_of(library, np.array([False, True, False]), device))
            alone[1].reset()
        seen = look(device, camera, clean).copy()
        wanted_of = [one.capture(clean[0], MATRIX, step * round(1e9 / 30)).depth for one in alone]
        np.testing.assert_allclose(seen, wanted_of, rtol=0, atol=2e-5)
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
    plain, other = Camera('Mode_5_30fps'), Camera('Mode_9_20fps', seed=1, effects=OFFSET)
    look(device, camera, clean)
    camera.set_effects(OFFSET, np.array([False, True]))
    camera.set_usecase('Mode_9_20fps', np.array([False, True]))
    stamp = round(1e9 / 30)
    wanted = [one.capture(clean[0], MATRIX, stamp).depth for one in (plain, other)]
    np.testing.assert_allclose(look(device, camera, clean), wanted, rtol=0, atol=2e-5)
    camera.set_effects(())
    wanted = plain.capture(clean[0], MATRIX, 2 * stamp).depth
    np.testing.assert_allclose(look(device, camera, clean)[0], wanted, rtol=0, atol=2e-5)


def test_every_effect_of_the_registry_has_a_kernel():
    package = Effect.__module__.rpartition('.')[0]
    own = {name for name, kind in registry().items() if kind.__module__.startswith(package)}
    assert own <= set(BATCHED)


@pytest.mark.parametrize('device', DEVICES)
def test_batch_and_camera_agree_for_effects_without_a_kernel(device, caplog):
    """Assert it to the bit beside an environment that kernels compute, and that it is said."""
    curve = {'knots': [0.5, 2.0], 'values': [0.01, 0.03]}
    patch = {'residual_patch': {'bias_0': 0.02}, 'offset': {'curve': curve}}
    effects = [{**patch, 'temporal_filter': None}, OFFSET, ()]
    other, changed = disagreement(device, effects, film(3))
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
    for mask in (np.ones(2), np.ones(3, bool), [True, False]):
        with pytest.raises(InputError, match='env_mask: must'):
            camera.reset(mask)


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
    done = run_python(script, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert 'within bounds' in done.stdout, done.stderr
    assert 'not noticed' not in done.stdout
    assert done.returncode != 0
