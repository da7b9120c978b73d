"""The observation term as training uses it: its class, its clock, its noise, its images."""

import abc
import copy
from importlib import import_module
import pickle
from types import SimpleNamespace

from batches import scenes
from flexx2_sim_ros.batch import noisy_depth
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.errors import InputError
import numpy as np
import pytest

STEP = 0.02
CLEAN = np.full((3, 24, 32), 1.2, np.float32)


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
    return SimpleNamespace(num_envs=3, device='cpu', image=CLEAN, **more)


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
        wanted = [one.capture(CLEAN[0], matrix, step * 50_000_000).depth for one in alone]
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
        env.image = CLEAN + np.float32(0.05 * step)
        wanted = seen_of(once, env)
        for _ in range(1 + step % 3):
            np.testing.assert_array_equal(seen_of(twice, env), wanted)
        if step == 9:
            for term in (once, twice):
                term.reset([1])
    before = seen_of(twice, env)
    twice.reset([1])
    env.image = CLEAN + 1
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
        env.image = CLEAN + np.float32(0.05 * step)
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
    clean = scenes(3)[:, 60:84, 80:112]
    if library == 'torch':
        clean = pytest.importorskip('torch').from_numpy(clean)
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
