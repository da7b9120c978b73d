"""When the images of a batch are taken and when they arrive, in steps of an environment loop."""

import pickle

from batches import DEVICES, look, scenes, WAYS
from flexx2_sim_ros.batch import BatchCamera, images
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import load_randomisation
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.pacing import FrameGate
import numpy as np
import pytest
import warp as wp
import yaml

MATRIX = flexx2().intrinsics.matrix
MS = 1_000_000


def late(seconds):
    """Return the effects of a camera whose images are right but late."""
    return {'time_offset': {'latency': 0.0, 'delay': seconds}}


def gate_of(rate_hz, step_ns):
    """Return a gate that has seen how long the steps are, as a batch knows it."""
    gate = FrameGate(rate_hz)
    for k in range(40):
        gate.accept(10**15 + k * step_ns)
    return gate


def expected(rate_hz, step_ns, delay_ns, count):
    """Return the stamp of the image at each step: the newest of those that the node would take."""
    gate, taken, shown = gate_of(rate_hz, step_ns), [], []
    for stamp in range(0, count * step_ns, step_ns):
        if gate.accept(stamp):
            taken.append(stamp)
        # Steps and delays are whole nanoseconds.
        arrived = [one for one in taken if one + delay_ns <= stamp + 1000]
        shown.append(max(arrived, default=0))
    return shown


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('step_hz', [50, 60, 200, 7])
def test_images_come_at_the_rate_of_the_mode_and_late(step_hz, device):
    modes = [mode for mode in flexx2().modes for _ in range(4)]
    steps = [0, 1, 2.5, 3] * len(flexx2().modes)
    step_ns = round(1e9 / step_hz)
    delays = [k * step_ns / 1e9 for k in steps]
    cameras = BatchCamera(
        len(modes),
        [mode.name for mode in modes],
        effects=[late(delay) for delay in delays],
        step_s=1 / step_hz,
        device=device,
    )
    clean = wp.full((len(modes), 1, 1), 1.5, dtype=wp.float32, device=device)
    shown = []
    for _ in range(90):
        cameras(clean)
        shown.append(cameras.image_stamps.numpy().copy())
    for i, mode in enumerate(modes):
        wanted = expected(mode.rate_hz, step_ns, round(delays[i] * 1e9), 90)
        assert [int(row[i]) for row in shown] == wanted, (mode.name, steps[i])


def moving(count, frames):
    """Return scenes that come nearer, (frames, count, 60, 80)."""
    still = scenes(count)[:, 50:110, 60:140]
    nearer = np.arange(frames, dtype=np.float32)[:, None, None, None] * np.float32(0.01)
    return still - nearer


KEEPING = {
    'temporal_filter': {'share': 0.5},
    'motion_artefact': None,
    'warm_up_drift': None,
    'multipath': None,
    'time_offset': {'latency': 0.03, 'delay': 0.05},
}
CURVE = {'wiggling': {'curve': {'knots': [0.5, 2.0], 'values': [0.01, -0.01]}}}


@pytest.mark.parametrize(('device', 'many'), WAYS)
def test_images_are_those_of_a_camera_that_takes_the_frames_that_are_due(
    device, many, monkeypatch
):
    """Steps without a frame change nothing that effects keep: a `Camera` never sees them."""
    monkeypatch.setattr(images, 'many_threads', lambda _: many)
    effects = [late(0.04), KEEPING, {**CURVE, **late(0.04)}]
    cameras = BatchCamera(3, 'Mode_5_30fps', effects=effects, step_s=0.02, device=device, K=MATRIX)
    alone = [Camera('Mode_5_30fps', seed=i, effects=own) for i, own in enumerate(effects)]
    film = moving(3, 24)
    gate = gate_of(30.0, 20 * MS)
    taken = {}
    for step, clean in enumerate(film):
        if step == 13:
            cameras.reset(np.ones(3, bool))
            gate, taken = gate_of(30.0, 20 * MS), {}
            for camera in alone:
                camera.reset()
        stamp = step * 20 * MS
        if gate.accept(stamp):
            taken[stamp] = [
                camera.capture(clean[i], MATRIX, stamp).depth for i, camera in enumerate(alone)
            ]
        seen = look(device, cameras, clean)
        for i, when in enumerate(cameras.image_stamps.numpy()):
            close = np.isclose(seen[i], taken[int(when)][i], rtol=0, atol=2e-5, equal_nan=True)
            assert close.mean() > 1 - 1e-3, (step, i)
    assert stamp - when >= 40 * MS


@pytest.mark.parametrize('device', DEVICES)
def test_a_reset_shows_the_new_scene_at_once_and_only_there(device):
    cameras = BatchCamera(2, 'Mode_9_5fps', effects=late(0.06), step_s=0.02, device=device)
    depth = np.full((2, 4, 5), 1.0, np.float32)
    for _ in range(7):
        look(device, cameras, depth)
    cameras.reset(np.array([True, False]))
    seen = look(device, cameras, depth + 1)
    assert cameras.image_stamps.numpy().tolist() == [140 * MS, 0]
    np.testing.assert_allclose(seen[0], 2.0, atol=0.1)
    np.testing.assert_allclose(seen[1], 1.0, atol=0.1)
    own = wp.array(depth, device=device)
    cameras(wp.array(depth + 1, device=device), out=own)
    np.testing.assert_array_equal(own.numpy(), seen)


@pytest.mark.parametrize('device', DEVICES)
def test_without_steps_an_image_is_late_by_whole_frames(device):
    usecases = ['Mode_9_30fps', 'Mode_9_10fps']
    cameras = BatchCamera(2, usecases, effects=late(0.1), device=device)
    for _ in range(9):
        look(device, cameras, np.ones((2, 4, 5), np.float32))
    period = round(1e9 / 30)
    assert cameras.image_stamps.numpy().tolist() == [(8 - 3) * period, (8 - 1) * 100 * MS]


def drawn(folder, effect, parameters, **more):
    """Return random cameras, read from a file."""
    path, effects = folder / f'{effect}.yaml', {effect: {'parameters': parameters, **more}}
    path.write_text(yaml.safe_dump({'schema': 1, 'randomisation': {'effects': effects}}))
    return load_randomisation(path)


@pytest.mark.parametrize('device', DEVICES)
def test_a_reset_draws_another_delay_and_latency(device, tmp_path):
    parameters = {'latency': {'low': 0.0, 'high': 0.1}, 'delay': {'low': 0.02, 'high': 0.06}}
    cameras = BatchCamera(8, 'Mode_5_60fps', step_s=0.02, device=device, K=MATRIX)
    cameras.randomise(drawn(tmp_path, 'time_offset', parameters, probability=0.9), 3, pool=64)
    assert cameras.drawn is not None
    film = moving(1, 22)
    delays_drawn = []
    for step in range(22):
        if step == 11:
            cameras.reset()
        if step in (0, 11):
            chosen = [cameras.drawn.cameras[k] for k in cameras.drawn.drawn.numpy()]
            alone = [Camera('Mode_5_60fps', seed=i, effects=own) for i, own in enumerate(chosen)]
            delays = [own[0].delay if own else 0.0 for own in chosen]
            taken = {}
            delays_drawn.append(delays)
        taken[step * 20 * MS] = [
            camera.capture(film[step, 0], MATRIX, step * 20 * MS).depth for camera in alone
        ]
        seen = look(device, cameras, np.repeat(film[step], 8, axis=0))
        for i, when in enumerate(cameras.image_stamps.numpy().tolist()):
            steps = int(np.ceil(delays[i] / 0.02 - 1e-4))
            assert when == max(step - steps, 11 * (step >= 11)) * 20 * MS
            close = np.isclose(seen[i], taken[when][i], rtol=0, atol=2e-5, equal_nan=True)
            assert close.mean() > 1 - 1e-3
    assert all(own != other for own, other in zip(*delays_drawn, strict=True))
    assert all(0.02 <= delay <= 0.06 for delay in delays_drawn[0] if delay)
    cameras.set_effects(())
    assert cameras.drawn is None
    with pytest.raises(InputError, match='intrinsics_error: cannot be drawn again'):
        cameras.randomise(drawn(tmp_path, 'intrinsics_error', {}))


def test_unusable_steps_are_refused():
    for step_s in (0, -0.02, float('nan'), '0.02', True, 11):
        with pytest.raises(InputError, match='step_s: must be 1e-6 to 10 seconds, got'):
            BatchCamera(2, device='cpu', step_s=step_s)
    for steps in (-1, 0.5, True, '1'):
        with pytest.raises(InputError, match='steps: must be a whole number from 0, got'):
            BatchCamera(1, device='cpu')(np.ones((1, 4, 5), np.float32), steps=steps)


@pytest.mark.parametrize('step_s', [np.float32(0.02), np.int64(1)])
def test_steps_are_any_number(step_s):
    cameras = BatchCamera(1, 'Mode_9_5fps', device='cpu', step_s=step_s)
    cameras(np.ones((1, 4, 5), np.float32))
    assert cameras.stamps.numpy().tolist() == [round(float(step_s) * 1000) * MS]


@pytest.mark.parametrize('step_s', [None, 0.02])
@pytest.mark.parametrize('device', DEVICES)
def test_calls_without_a_step_change_nothing(device, step_s):
    """Nothing that effects keep, on the device or in a `Camera`, nor the clock."""
    options = {'effects': [late(0.04), KEEPING, {**CURVE, **late(0.04)}], 'step_s': step_s}
    cameras, alone = (BatchCamera(3, device=device, K=MATRIX, **options) for _ in range(2))
    for step, clean in enumerate(moving(3, 12)):
        wanted = look(device, cameras, clean, steps=1)
        np.testing.assert_array_equal(look(device, alone, clean, steps=1), wanted)
        for _ in range(step % 3):
            np.testing.assert_array_equal(look(device, alone, clean + 1, steps=0), wanted)
        np.testing.assert_array_equal(alone.stamps.numpy(), cameras.stamps.numpy())


@pytest.mark.parametrize('step_s', [None, 0.02])
@pytest.mark.parametrize('device', DEVICES)
def test_copies_go_on_as_the_original_does(device, step_s, tmp_path):
    delays = drawn(tmp_path, 'time_offset', {'delay': {'low': 0.02, 'high': 0.06}})
    cameras = BatchCamera(3, device=device, K=MATRIX, step_s=step_s)
    for randomised in (False, True):
        if randomised:
            cameras.randomise(delays, seed=3, pool=16)
        else:
            more = {'pose_error': None, 'random_dropout': None}
            cameras.set_effects([KEEPING, more, {**CURVE, 'temporal_filter': {'share': 0.5}}])
        film = moving(3, 12)
        for clean in film[:7]:
            look(device, cameras, clean)
        other = pickle.loads(pickle.dumps(cameras))  # noqa: S301 (our own)
        for clean in film[7:]:
            np.testing.assert_array_equal(look(device, other, clean), look(device, cameras, clean))
            np.testing.assert_array_equal(other.image_stamps.numpy(), cameras.image_stamps.numpy())
            cameras.reset(np.array([True, False, False]))
            other.reset(np.array([True, False, False]))
    stamps = cameras.stamps.numpy().tolist()
    look(device, other, film[0])
    assert cameras.stamps.numpy().tolist() == stamps


def test_more_frames_than_can_be_kept_are_refused():
    cameras = BatchCamera(2, 'Mode_5_60fps', effects=late(1.0), device='cpu')
    with pytest.raises(InputError, match='time_offset.delay: must be so short'):
        cameras(np.broadcast_to(np.float32(1), (2, 5000, 5000)))
