"""Effects on the camera node, on real topics: parameters, switching, memory, light."""

from dataclasses import replace
import math

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.camera.frame import gray_image
from flexx2_sim_ros.effects import parse_effects, registry, save_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import ProfileFile, save_profile
import numpy as np
import pytest
import streams
from streams import (
    array_of,
    CLOUD,
    DEPTH,
    Flexx2Camera,
    GRAY,
    nanoseconds,
    NOISE,
    same,
    SECOND,
    START,
    stream,
    WHITE,
)

PERIOD = SECOND // 30
WARM = {'knots': [0.0, 600.0], 'values': [0.02, 0.0]}
KEEPS = ('warm_up_drift', 'temporal_filter', 'multipath', 'fixed_pattern', 'time_offset')

pytestmark = pytest.mark.usefixtures('ros')


def scene(step=0):
    """Return a near ball's worth of light, an edge, a slant; it moves with the step."""
    row = np.linspace(1.2, 1.6, 224, dtype=np.float32)
    row[:60] = 0.45
    return np.broadcast_to(row + np.float32(0.01 * step), (172, 224)).copy()


def twin(seen, effects, usecase=''):
    """Return the library's camera that does what the node should."""
    settings = seen.camera.settings
    return Camera(
        usecase or settings.usecase, effects=effects, seed=settings.seed, name=settings.camera_name
    )


def capture(camera, depth, stamp, paint=None):
    return camera.capture(depth, flexx2().intrinsics.matrix, stamp, paint)


def confidence(message):
    return np.frombuffer(message.data, '<f4')[3::4].reshape(172, 224)


def test_a_file_at_the_start_and_numbers_beside_it(tmp_path):
    path = tmp_path / 'mine.yaml'
    of_file = {'warm_up_drift': {'bias': 0.03, 'curve': WARM}}
    of_file |= dict.fromkeys(('saturation', 'ambient_light', 'temporal_filter'))
    save_effects(path, parse_effects(of_file))
    numbers = {
        'effect.warm_up_drift.strength': 2,
        'effect.offset.strength': 1.5,
        'effect.multipath.gain': 3,
    }
    paint = np.full((172, 224), 0.8, np.float32)
    outputs = DEPTH, NOISE, GRAY, CLOUD
    with stream(*outputs, effects=str(path), auto_exposure_0=False, **numbers) as seen:
        assert seen.get('effects') == f'{path}*'  # Numbers differ from the file's.
        for name, value in numbers.items():
            assert seen.get(name) == value
        assert seen.get('effect.warm_up_drift.bias') == 0.03
        assert seen.get('effect.saturation.strength') == 1.0
        assert seen.get('effect.multipath.strength') == 0.0
        names = 'offset, warm_up_drift, ambient_light, temporal_filter, saturation'
        seen.spin_until(lambda: seen.logged(f'effects are now {names}'))
        stronger = of_file['warm_up_drift'] | {'strength': 2}
        effects = of_file | {'warm_up_drift': stronger, 'offset': {'strength': 1.5}}
        camera = twin(seen, effects)
        for step in range(3):
            stamp = START + step * PERIOD
            assert seen.show(scene(step), stamp, paint)
            frame = capture(camera, scene(step), stamp, paint)
            assert same(seen.depths()[-1], frame.depth)
            assert same(array_of(seen.messages(NOISE)[-1]), frame.sigma)
            gray = array_of(seen.messages(GRAY)[-1])
            assert same(gray, gray_image(frame.amplitude, 1.0, WHITE))
            assert same(confidence(seen.messages(CLOUD)[-1]), frame.confidence)
            lost = np.isnan(frame.depth[:, :40])
            assert 0.3 < lost.mean() < 1
            assert gray[:, :40][lost].min() == 255  # too much light is white


def test_parameters_are_described():
    with stream() as seen:
        items = {
            f'effect.{name}.{item.name}': item
            for name, kind in registry().items()
            for item in kind.parameters()
        }
        assert len(items) > 70
        names = list(items)
        described = seen.wait(seen.clients.describe_parameters(names)).descriptors
        values = seen.wait(seen.clients.get_parameters(names)).values
        for name, item, descriptor, value in zip(
            names, items.values(), described, values, strict=True
        ):
            assert descriptor.name == name
            assert descriptor.type == 3  # PARAMETER_DOUBLE
            assert not descriptor.read_only
            assert item.text in descriptor.description
            assert descriptor.description.endswith(item.unit)
            limits = descriptor.floating_point_range[0]
            assert (limits.from_value, limits.to_value) == (item.low, item.high)
            off = 0.0 if item.name == 'strength' else item.default
            assert value.double_value == off
        assert seen.camera._camera.effects == ()


def test_effects_are_switched_between_two_frames():
    with stream(DEPTH) as seen:
        steps = iter(range(1000))

        def feed(count):
            for _ in range(count):
                assert seen.show(scene(), START + next(steps) * PERIOD)

        feed(2)
        answer = seen.clients.set_parameters_atomically(
            [
                streams.Parameter('effect.offset.strength', value=2),
                streams.Parameter('effect.excess_noise.strength', value=1.0),
            ]
        )
        while not answer.done():
            feed(1)
        assert answer.result().result.successful
        after = len(seen.depths())
        feed(2)
        # All off again is the base model to the last bit.
        assert seen.set(effects='').successful
        assert seen.get('effect.offset.strength') == 0.0
        assert seen.camera._camera.effects == ()
        feed(1)
        plain = twin(seen, ())
        changed = twin(seen, {'offset': {'strength': 2}, 'excess_noise': None})
        kinds = []
        for depth, message in zip(seen.depths(), seen.messages(DEPTH), strict=True):
            matching = [
                same(depth, capture(camera, scene(), nanoseconds(message)).depth)
                for camera in (plain, changed)
            ]
            assert sum(matching) == 1
            kinds.append('changed' if matching[1] else 'plain')
        assert kinds.pop() == 'plain'
        assert kinds[:2] == ['plain', 'plain']
        assert set(kinds[after:]) == {'changed'}
        assert kinds == sorted(kinds, reverse=True), 'back and forth'


def test_a_bad_value_is_rejected_and_the_stream_goes_on(tmp_path):
    path = tmp_path / 'bad.yaml'
    path.write_text('schema: 1\neffects: {offset: {bias: 7}}\n')
    bias = 'effect.offset.bias'
    with stream(DEPTH, **{'effect.offset.strength': 1.0}) as seen:
        bad = [(bias, value) for value in (0.3, -0.21, 5, math.nan, math.inf)]
        bad += [(bias, value) for value in ('much', True, [0.1])]
        bad += [('effect.offset.strength', value) for value in (-1, 4.5)]
        bad += [('effects', value) for value in ('/no/such/file.yaml', str(path), 'typica', 5)]
        bad += [('effect.offset.bis', 0.1), ('effect.blur.strength', 1.0)]
        for name, value in bad:
            answer = seen.set(**{name: value})
            assert not answer.successful
            parts = name, str(value), 'parameter type', 'undeclared'
            assert any(part in answer.reason for part in parts), answer.reason
        assert 'offset.bias: must be' in seen.set(effects=str(path)).reason
        assert seen.show(scene(), START)
        expected = capture(twin(seen, {'offset': None}), scene(), START)
        assert same(seen.depths()[0], expected.depth)
        assert seen.get(bias) == 0.005
        assert seen.get('effects') == 'none*'  # No file, and a number that is not off.
        assert seen.set(**{bias: 0}).successful  # a whole number will do
        assert seen.get(bias) == 0.0
    for name, value in (
        ('effects', str(path)),
        (bias, 0.5),
        (bias, 'much'),
        ('effects', 'typica'),
    ):
        with pytest.raises(InputError, match=r'offset\.bias|typica'):
            Flexx2Camera(parameter_overrides=[streams.Parameter(name, value=value)])


def test_effects_forget_past_frames_when_stamps_go_back_or_the_mode_changes():
    """Assert frames continue what was before, and start afresh when they have to."""
    strengths = {f'effect.{name}.strength': 2.0 for name in KEEPS}
    effects = {name: {'strength': 2.0} for name in KEEPS}
    with stream(DEPTH, **strengths) as seen:
        camera = twin(seen, effects)

        def check(step, stamp):
            assert seen.show(scene(step), stamp)
            assert same(seen.depths()[-1], capture(camera, scene(step), stamp).depth)

        for step in range(4):
            check(step, START + step * SECOND)
        # Another effect switched on and off leaves the memory of the others alone.
        assert seen.set(**{'effect.offset.strength': 1}).successful
        assert seen.set(**{'effect.offset.strength': 0}).successful
        check(4, START + 4 * SECOND)
        went_on = seen.depths()[-1]
        camera = twin(seen, effects)
        for step in range(3):
            check(step, 5 + step * SECOND)
        camera = twin(seen, effects, 'Mode_9_15fps')
        assert seen.set(usecase='Mode_9_15fps').successful
        check(4, 5 + 4 * SECOND)
        assert not np.isclose(seen.depths()[-1], went_on, atol=1e-4).all()


def test_effects_need_to_know_the_frequencies(tmp_path):
    first, *others = flexx2().modes
    path = tmp_path / 'camera.yaml'
    save_profile(
        path, ProfileFile(replace(flexx2(), modes=(replace(first, modulation_hz=()), *others)))
    )
    with stream(DEPTH, profile=str(path), usecase=first.name) as seen:
        assert seen.set(**{'effect.offset.strength': 1.0}).successful
        refused = seen.set(**{'effect.wiggling.strength': 1.0})
        assert not refused.successful
        assert 'modulation_hz' in refused.reason
        assert 'modulation_hz' in seen.set(effects='typical').reason
        assert seen.set(usecase='Mode_9_30fps').successful
        assert seen.set(**{'effect.wiggling.strength': 1.0}).successful
        refused = seen.set(usecase=first.name)
        assert not refused.successful
        assert 'modulation_hz' in refused.reason
        assert seen.show(scene(), START)
