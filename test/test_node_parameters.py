"""Parameters of a running node: set together, written down and loaded, and hostile."""

from flexx2_sim_ros.effects import parse_effects, save_effects
from flexx2_sim_ros.profiles.modes import flexx2
from hostile_files import hostile_texts
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from streams import DEPTH, Parameter, stream

pytestmark = pytest.mark.usefixtures('ros')

SECOND = 10**9
WALL = np.full((172, 224), 1.5, np.float32)
USECASE, AUTO, EXPOSURE = 'usecase', 'auto_exposure_0', 'exposure_time_0'


@pytest.fixture(scope='module')
def seen(ros):
    """Return a camera that all tests of this file put questions to."""
    with stream(DEPTH) as made:
        yield made


@pytest.fixture(autouse=True)
def still_streams(request):
    """Assert that the shared camera still publishes after each test."""
    yield
    if 'seen' in request.fixturenames:
        made = request.getfixturevalue('seen')
        still_streams.stamp += SECOND
        assert made.show(WALL, still_streams.stamp)
        for values in ({'effects': ''}, {USECASE: 'Mode_9_30fps', AUTO: True}, {'frame_id': ''}):
            assert made.set(**values).successful


still_streams.stamp = SECOND


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'usecase': ''}, ['usecase', "''", 'Mode_9_30fps']),
        ({'usecase': 5}, ['usecase', "'5'", 'Mode_9_30fps']),
        ({'input_depth': 'flat'}, ['input_depth', "'flat'", 'planar, radial']),
        ({'frame_id': 'x' * 256}, ['frame_id: must be at most 255 characters, got 256']),
    ],
    ids=['empty', 'number', 'choice', 'long'],
)
def test_bad_values_are_refused(seen, values, parts):
    (name,) = values
    before = seen.get(name)
    refused = seen.set(**values)
    assert not refused.successful
    assert all(part in refused.reason for part in parts), refused.reason
    assert seen.get(name) == before


def messages_of(values):
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]


def call(seen, kind, parameters):
    """Return the answer of one of the two services that set parameters."""
    name = 'set_parameters' if kind is SetParameters else 'set_parameters_atomically'
    client = seen.node.create_client(kind, f'{seen.name}/{name}')
    seen.spin_until(client.service_is_ready, name)
    answer = seen.wait(client.call_async(kind.Request(parameters=parameters)))
    seen.node.destroy_client(client)
    return answer


def atomically(seen, **values):
    return call(seen, SetParametersAtomically, messages_of(values)).result


def one_request(seen, values):
    return list(call(seen, SetParameters, messages_of(values)).results)


def dump(seen):
    """Return all parameters, as `ros2 param dump` asks for them."""
    names = sorted(seen.wait(seen.clients.list_parameters()).result.names)
    values = seen.wait(seen.clients.get_parameters(names)).values
    return {
        name: Parameter.from_parameter_msg(ParameterMessage(name=name, value=value)).value
        for name, value in zip(names, values, strict=True)
    }


def test_mode_and_exposure_are_judged_together(seen):
    """Assert the new mode's range counts, and that what success says is what is stored."""
    longest = {mode.name: mode.exposure_us[1] for mode in flexx2().modes}
    new, old = 'Mode_9_5fps', 'Mode_9_30fps'
    exposure = longest[new] - 1
    assert exposure > longest[old]
    given = {USECASE: new.upper(), AUTO: False, EXPOSURE: exposure}
    for names in ((USECASE, AUTO, EXPOSURE), (EXPOSURE, AUTO, USECASE), (AUTO, EXPOSURE, USECASE)):
        for together in (True, False):
            values = {name: given[name] for name in names}
            results = [atomically(seen, **values)] if together else one_request(seen, values)
            assert all(result.successful for result in results)
            assert [seen.get(name) for name in given] == [new, False, exposure]
            # What only the old mode could do is refused, and nothing changes.
            refused = atomically(seen, **{USECASE: old, EXPOSURE: exposure})
            assert not refused.successful
            assert f'{EXPOSURE}: must be' in refused.reason
            assert old in refused.reason
            assert [seen.get(name) for name in given] == [new, False, exposure]
            limits = seen.wait(seen.clients.describe_parameters([EXPOSURE])).descriptors[0]
            limits = limits.integer_range[0]
            shortest, longest_of_new = flexx2().mode(new).exposure_us
            assert (limits.from_value, limits.to_value) == (shortest, longest_of_new)
            assert atomically(seen, **{USECASE: old, AUTO: True}).successful
            assert seen.get(EXPOSURE) == longest[old]


def test_an_automatic_exposure_cannot_be_set(seen):
    longest = flexx2().mode('Mode_9_30fps').exposure_us[1]
    for result in (seen.set(**{EXPOSURE: 100}), atomically(seen, **{EXPOSURE: 100, AUTO: True})):
        assert result.successful
        assert seen.get(EXPOSURE) == longest
    assert not seen.set(**{EXPOSURE: 10**6}).successful
    assert atomically(seen, **{EXPOSURE: 100, AUTO: False}).successful
    assert seen.get(EXPOSURE) == 100
    assert seen.set(**{AUTO: True}).successful
    assert seen.get(EXPOSURE) == longest


def setups(tmp_path):
    """Return sets of parameters of which each gives another camera."""
    path = tmp_path / 'gap.yaml'
    effects = {'offset': {'bias': 0.02}, 'saturation': None, 'residual_patch': {'bias_0': 0.03}}
    save_effects(path, parse_effects(effects))
    yield {'effects': 'typical', 'effect.multipath.strength': 0.0, USECASE: 'Mode_5_45fps'}
    yield {'effect.offset.strength': 2.0, 'effect.multipath.gain': 3.0, AUTO: False, EXPOSURE: 90}
    of_file = {'effects': str(path), 'effect.offset.bias': 0.01, 'invalid_value': 'zero'}
    yield of_file | {USECASE: 'Mode_9_5fps', AUTO: False, EXPOSURE: 1200, 'frame_id': 'lens'}


def test_dumped_parameters_load_unchanged(tmp_path):
    for values in setups(tmp_path):
        with stream(**values) as first:
            written, chosen = dump(first), first.camera.settings.effects.chosen
            assert any(effect.strength for effect in chosen)
            # Into the camera itself, alphabetically: nothing changes.
            results = [*one_request(first, written), atomically(first, **written)]
            assert all(result.successful for result in results)
            assert dump(first) == written
            assert first.camera.settings.effects.chosen == chosen
        given = {name: value for name, value in written.items() if not name.startswith('qos')}
        with stream() as second, stream(**given) as third:  # as by --params-file at the start
            assert all(result.successful for result in one_request(second, given))
            for other in (second, third):
                assert dump(other) | given == dump(other)
                assert other.camera.settings.effects.chosen == chosen


def test_a_changed_number_marks_the_file(seen):
    assert seen.set(effects='typical').successful
    assert seen.get('effects') == 'typical'
    multipath = 'effect.multipath.strength'
    assert seen.set(**{multipath: 0.5}).successful
    assert seen.get('effects') == 'typical*'
    assert seen.set(effects='typical*').successful
    assert seen.get(multipath) == 0.5
    assert seen.set(**{multipath: 1.0}).successful
    assert seen.get('effects') == 'typical'
    assert atomically(seen, **{multipath: 0.0, 'effects': 'typical'}).successful
    assert seen.get(multipath) == 0.0
    assert seen.get('effects') == 'typical*'
    assert seen.set(effects='typical').successful
    assert seen.get(multipath) == 1.0
    assert not seen.set(effects='typica*').successful


def test_no_file_stops_a_running_node(seen, tmp_path):
    """Assert a short reason without terminal escapes, at once, whatever `effects` names."""
    for text in hostile_texts(tmp_path):
        result = seen.set(effects=text)
        assert not result.successful
        assert result.reason.startswith('effects: ')
        assert result.reason.isprintable()
        assert len(result.reason) < 1000
        assert seen.get('effects') == ''


def test_odd_requests_are_answered(seen):
    names = ['', 'x' * 10_000, 'a\x1b[31mb', '\n', 'usecase.', '.', 'usecas']
    for name in names:
        result = seen.set(**{name: 1})
        assert not result.successful
        assert result.reason.isprintable()
        assert len(result.reason) < 300
        assert not seen.wait(seen.clients.get_parameters(['usecase', name])).values
        assert not seen.wait(seen.clients.describe_parameters([name])).descriptors
        assert not seen.wait(seen.clients.get_parameter_types([name])).types
    assert 'did you mean usecase?' in result.reason
    for depth in (0, 1, 2, 2**64 - 1):
        seen.wait(seen.clients.list_parameters(names, depth))
    assert '' not in dump(seen)
    many = [ParameterMessage(name='frame_id')] * 1001
    result = call(seen, SetParametersAtomically, many).result
    assert result.reason == 'parameters: must be at most 1000, got 1001'
    assert call(seen, SetParametersAtomically, []).result.successful
    # Of one that comes twice each is judged; together they are refused.
    twice = [*messages_of({'invalid_value': 'zer'}), *messages_of({'invalid_value': 'zero'})]
    results = call(seen, SetParameters, twice).results
    assert [result.successful for result in results] == [False, True]
    result = call(seen, SetParametersAtomically, twice).result
    assert result.reason == 'invalid_value: must be given once, got it 2 times'
    # A parameter cannot be taken away.
    for name in ('usecase', 'effects', 'invalid_value', 'effect.offset.bias', 'seed'):
        (result,) = call(seen, SetParameters, [ParameterMessage(name=name)]).results
        assert not result.successful


def test_an_error_in_a_service_is_logged_and_refused(seen, monkeypatch):
    def fail(*_):
        raise MemoryError('\x1b[31m' + 'x' * 200)

    monkeypatch.setattr(seen.camera, 'describe_parameter', fail)
    result = seen.set(frame_id='lens')
    assert not result.successful
    assert 'internal error' in result.reason
    assert len(result.reason) < 200
    seen.spin_until(lambda: seen.logged('service', 'set_parameters', 'MemoryError'))
    assert not [text for text in seen.logged('MemoryError') if '\x1b' in text]
