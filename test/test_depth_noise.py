"""`depth_noise`, one line in any training program, and the observation term around it."""

import abc
import copy
from importlib import import_module
import json
import pickle
from types import SimpleNamespace

from batches import arrays_of, scenes
from flexx2_sim_ros.batch import BatchCamera, depth_noise, noisy_depth
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import save_randomisation
from flexx2_sim_ros.effects.randomisation import fixed, of_strengths
from flexx2_sim_ros.effects.registry import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processing import parse_chain
import numpy as np
import pytest

CLEAN = np.full((6, 24, 32), 1.2, np.float32)
THREE = CLEAN[:3]
STEP = 0.02
BIAS = {'offset': {'bias': 0.1}}


def drawn_offsets():
    """Return cameras that differ in an offset of up to 10 mm."""
    return of_strengths([registry()['offset']()], 0.0, 2.0)


def offset_of(seen):
    """Return (N,) metres by which images differ from the clean ones."""
    return np.array(np.median(np.asarray(seen), axis=(1, 2)) - CLEAN[0, 0, 0])


@pytest.mark.parametrize('effects', [(), 'typical', {'time_offset': {'delay': 0.04}}])
def test_effects_that_are_not_drawn_are_those_of_the_batch(effects):
    clean = scenes(4)[:, 60:84, 80:112]
    options = {'effects': effects, 'seed': [3, 1, 4, 1], 'device': 'cpu'}
    noise = depth_noise('flexx2', mode='Mode_5_30fps', **options)
    batch = BatchCamera(4, 'Mode_5_30fps', invalid_value='zero', **options)
    for step in range(4):
        moving = clean + np.float32(0.01 * step)
        np.testing.assert_array_equal(noise(moving), batch(moving))
        if step == 2:
            noise.reset([1])
            batch.reset(np.arange(4) == 1)


def test_randomised_cameras_differ_and_change_at_a_reset():
    noise = depth_noise('flexx2', mode='Mode_9_30fps', effects='randomised', pool=64)
    noise(CLEAN)
    before = noise.camera.drawn.drawn.numpy().copy()
    assert len(set(before)) > 2
    noise.reset(np.arange(6) < 3)
    after = noise.camera.drawn.drawn.numpy()
    np.testing.assert_array_equal(after[3:], before[3:])
    assert not np.array_equal(after[:3], before[:3])
    # A profile whose frequencies are not known leaves out the effects that need them.
    other = depth_noise('realsense_d435', mode='Depth_848x480_30fps', effects='randomised', pool=8)
    assert np.isfinite(other(CLEAN)).all()


def test_progress_scales_the_strength_of_each_camera():
    noise = depth_noise(effects=drawn_offsets(), pool=32, progress=0.5)
    half = offset_of(noise(CLEAN))
    noise.set_progress(1.0)
    full = offset_of(noise(CLEAN))
    noise.set_progress(0.0)
    none = offset_of(noise(CLEAN))
    assert full.max() > 0.004
    np.testing.assert_allclose(half, 0.5 * full, atol=0.003)
    np.testing.assert_allclose(none, 0, atol=0.003)
    fixed_one = depth_noise(effects=BIAS, progress=0.3)
    assert abs(offset_of(fixed_one(CLEAN)) - 0.03).max() < 0.003
    for wrong in (1.1, -0.1, np.nan, 'half'):
        with pytest.raises(InputError, match='progress: must be a number from 0 to 1'):
            noise.set_progress(wrong)
    with pytest.raises(InputError, match='progress: must be 1'):
        depth_noise(effects={'pose_error': None}, progress=0.5)


def test_latency_is_drawn_for_each_environment():
    noise = depth_noise(mode='Mode_9_30fps', latency=(0.0, 0.2), step_s=0.02, pool=64)
    for step in range(16):
        noise(CLEAN + np.float32(0.01 * step))
    camera = noise.camera
    ages = camera.stamps.numpy() - 20_000_000 - camera.image_stamps.numpy()
    assert len(set(ages)) > 2
    assert ages.max() <= 200_000_000 + 34_000_000  # and the time to the next frame
    exact = depth_noise(effects=drawn_offsets(), latency=0.06, step_s=0.02, pool=4)
    exact(CLEAN)
    assert set(exact.camera._rows.delays.numpy()) == {60_000_000}
    for wrong in (-1, (0.3, 0.1), 'long', (1, 2, 3)):
        with pytest.raises(InputError, match='latency: must be seconds'):
            depth_noise(latency=wrong)
    with pytest.raises(InputError, match='effects: must be without time_offset'):
        depth_noise(effects={'time_offset': None}, latency=0.1)


def test_a_checkpoint_goes_on():
    options = {'effects': drawn_offsets(), 'pool': 32, 'seed': 7}
    noise = depth_noise(**options)
    noise(CLEAN)
    noise.reset([1, 2])
    noise.set_progress(0.7)
    state = json.loads(json.dumps(noise.state_dict()))
    wanted = [np.array(noise(CLEAN)) for _ in range(2)]
    for used_before in (False, True):
        other = depth_noise(**options)
        if used_before:
            other(CLEAN)
            other.reset()
        other.load_state_dict(state)
        assert other.camera is None or other.state_dict() == state
        np.testing.assert_array_equal([other(CLEAN) for _ in range(2)], wanted)
        np.testing.assert_array_equal(copy.deepcopy(other)(CLEAN), other(CLEAN))
    with pytest.raises(InputError, match='state: must be of 6 environments'):
        noise.load_state_dict({**state, 'stamps': [0]})
    with pytest.raises(InputError, match='state: must be one of state_dict'):
        noise.load_state_dict({'weights': 1})


def test_a_file_of_distributions_and_a_curriculum_of_the_environment(tmp_path):
    path = tmp_path / 'mine.yaml'
    save_randomisation(path, fixed([registry()['offset'].from_mapping({'bias': 0.1})]))
    env = SimpleNamespace(num_envs=6, device='cpu', image=CLEAN, share=0.0)
    camera = {'effects': str(path), 'progress': lambda env: env.share}
    term = noisy_depth()(SimpleNamespace(params={'camera': camera}), env)
    for env.share in (0.0, 0.4, 1.0):
        seen = term(env, lambda env: env.image)
        assert abs(offset_of(seen) - 0.1 * env.share).max() < 0.003


def test_images_of_torch_are_written_in_place():
    torch = pytest.importorskip('torch')
    noise = depth_noise(effects=BIAS)
    clean = torch.from_numpy(CLEAN.copy())
    kept = noise(clean)
    assert noise(clean, out=clean) is clean
    assert not torch.equal(kept, clean)
    assert abs(offset_of(clean) - 0.1).max() < 0.003
    noise.reset(torch.tensor([0, 2]))
    noise.reset(torch.arange(6) > 3)


def test_images_of_jax_come_back_as_such():
    jax = pytest.importorskip('jax')
    noise = depth_noise(effects='typical', device='cpu')
    seen = noise(jax.numpy.asarray(CLEAN))
    assert isinstance(seen, jax.Array)
    noise.reset(jax.numpy.arange(6) > 3)
    np.testing.assert_array_equal(seen, depth_noise(effects='typical', device='cpu')(CLEAN))


@pytest.mark.parametrize('library', ['numpy', 'torch', 'jax'])
def test_images_are_processed_as_your_program_does(library):
    stages = [
        {'decimate': {'factor': 4}},
        {'fill': {'method': 'temporal'}},
        {'rate': {'hz': 25.0}},
    ]
    stages += [{'spatial': {}}, {'smooth': {'persistency': 3}}, {'fill': {'method': 'inpaint'}}]
    stages += [{'normalise': {'high': 2.0, 'invalid': -1.0}}]
    options = {'mode': 'Mode_9_30fps', 'step_s': 0.02, 'device': 'cpu'}
    noise = depth_noise(process=stages, **options)
    plain = depth_noise(invalid_value='nan', **options)
    made, wanted = parse_chain(stages), None
    clean = scenes(6)[:, 60:84, 80:112]
    given = arrays_of(library, clean[:, None], 'cpu')
    for step in range(1, 6):
        found = noise(given)
        assert type(found) is type(given)
        assert tuple(found.shape) == (6, 1, 6, 8)
        seen = made.step(plain(clean), step * 20_000_000)
        wanted = wanted if seen is None else seen  # held where the rate leaves a step out
        np.testing.assert_array_equal(np.asarray(found)[:, 0], wanted)
        if step == 3:
            again = noise(given, steps=0)
            np.testing.assert_array_equal(np.asarray(again), np.asarray(found))
            plain(clean, steps=0)
    noise.reset([1])
    with pytest.raises(InputError, match='out: must be left out'):
        noise(given, out=given)
    with pytest.raises(InputError, match='crop.left: must be'):
        depth_noise(process=[{'crop': {'left': -1}}])


class Base:
    """What terms of a simulator inherit from."""

    def __init__(self, cfg, env):
        """Keep the environment, as Isaac Lab does."""
        self._env = env


def made_of(env, base=object, **camera):
    """Return a term."""
    return noisy_depth(base)(cfg=SimpleNamespace(params={'camera': camera}), env=env)


def environment(**more):
    """Return an environment whose clean depth is `image`."""
    return SimpleNamespace(num_envs=3, device='cpu', image=THREE, **more)


def seen_of(term, env):
    """Return what a term computes."""
    return np.array(term(env, lambda env: env.image))


@pytest.mark.parametrize('base', [object, Base, abc.ABC])
def test_the_class_is_found_by_its_name_and_pickles(base):
    term = noisy_depth(base)
    assert issubclass(term, base)
    assert getattr(import_module(term.__module__), term.__name__) is term
    assert pickle.loads(pickle.dumps(term)) is term  # noqa: S301 (our own)
    assert copy.deepcopy({'func': term})['func'] is term


def test_a_manager_gets_the_frames_of_cameras_and_resets_them():
    effects, matrix = (
        {'temporal_filter': {'share': 0.9}},
        [[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]],
    )
    camera = {'mode': 'Mode_9_20fps', 'effects': effects, 'seed': 5, 'K': matrix}
    cfg = SimpleNamespace(params={'depth': lambda env: env.image, 'camera': camera})
    env = environment()
    term = noisy_depth(Base)(cfg=cfg, env=env)
    alone = [Camera('Mode_9_20fps', seed=5 + i, effects=effects) for i in range(3)]
    for step, env_ids in enumerate(([], [1], None, [0, 2])):
        seen = term(env, **cfg.params)
        wanted = [one.capture(THREE[0], matrix, step * 50_000_000).depth for one in alone]
        np.testing.assert_allclose(seen, wanted, rtol=0, atol=2e-5)
        term.reset(env_ids)
        for i in range(3) if env_ids is None else env_ids:
            alone[i].reset()


def test_invalid_pixels_are_zero():
    clean = scenes(3)
    seen = made_of(environment())(None, lambda env: clean)
    wanted = Camera().capture(clean[0], flexx2().intrinsics.matrix, 0).depth
    assert np.isnan(wanted).any()
    np.testing.assert_allclose(seen[0], np.nan_to_num(wanted), rtol=0, atol=2e-5)


def counted(step, kind):
    """Return the counters of an environment of Isaac Lab or mjlab, after some steps."""
    if kind == 'of the policy':
        return {'common_step_counter': step, '_sim_step_counter': 7}
    return {'_sim_step_counter': 4 * step, 'cfg': SimpleNamespace(decimation=4)}


@pytest.mark.parametrize('kind', ['of the policy', 'of the physics'])
@pytest.mark.parametrize('step_s', [None, np.float32(STEP)])
def test_computing_twice_in_a_step_changes_nothing(step_s, kind):
    """Assert it with a delay and a filter, over steps that nobody computes, and a reset."""
    effects = {'time_offset': {'latency': 0.0, 'delay': 0.06}, 'temporal_filter': {'share': 0.5}}
    camera = {'mode': 'Mode_9_30fps', 'effects': effects, 'step_s': step_s}
    env = environment()
    once, twice = made_of(env, name='left', **camera), made_of(env, name='left', **camera)
    for step in (0, 1, 2, 3, 4, 6, 9, 10, 11, 12):
        vars(env).update(counted(step, kind))
        env.image = THREE + np.float32(0.05 * step)
        wanted = seen_of(once, env)
        for _ in range(1 + step % 3):
            np.testing.assert_array_equal(seen_of(twice, env), wanted)
        if step == 9:
            for term in (once, twice):
                term.reset([1])
    before = seen_of(twice, env)
    twice.reset([1])
    env.image = THREE + 1
    after = seen_of(twice, env)
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    np.testing.assert_allclose(after[1], env.image[1], atol=0.1)
    again = seen_of(twice, env)
    np.testing.assert_array_equal(again, after)
    twice.reset([1])
    assert not np.array_equal(seen_of(twice, env)[1], again[1])  # the noise of another frame


def test_a_delay_is_of_simulated_time():
    env = environment()
    effects = {'time_offset': {'latency': 0.0, 'delay': 3 * STEP}}
    term = made_of(env, mode='Mode_9_30fps', effects=effects, step_s=STEP)
    for step in range(0, 30, 2):  # an environment that computes every other step
        env.common_step_counter = step
        env.image = THREE + np.float32(0.05 * step)
        late = step - (np.median(seen_of(term, env)) - 1.2) / 0.05
        assert step < 10 or 2.5 < late < 5.5
    env.common_step_counter = 0  # a counter that starts again
    seen_of(term, env)


def test_terms_share_their_noise_only_by_name():
    def run():
        env = environment()
        named = [{}, {}, {'name': 'left'}, {'name': 'left'}, {'name': 'left', 'seed': 9}, {}]
        return [seen_of(made_of(env, **camera), env) for camera in named]

    first, second = run(), run()
    np.testing.assert_array_equal(first, second)
    assert len({image.tobytes() for image in first}) == 5
    np.testing.assert_array_equal(first[2], first[3])


@pytest.mark.parametrize('library', ['numpy', 'torch'])
def test_images_have_their_channel_where_the_simulator_has_it(library):
    clean = arrays_of(library, scenes(3)[:, 60:84, 80:112], 'cpu')
    shapes = [(3, 24, 32), (3, 24, 32, 1), (3, 1, 24, 32)]
    images = []
    for shape in shapes:
        env = environment()
        env.image = clean.reshape(shape)
        seen = made_of(env)(env, lambda env: env.image)
        assert type(seen) is type(clean)
        assert tuple(seen.shape) == shape
        images.append(np.asarray(seen).reshape(shapes[0]))
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
    env.image = clean.reshape(3, 2, 12, 32)
    with pytest.raises(InputError, match='depth: must have shape'):
        made_of(env)(env, lambda env: env.image)
