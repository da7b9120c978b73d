"""Parameters that nodes get at their start: hostile, misspelt, and of another type."""

import itertools
import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.robot_node import RobotCameras
from hostile_files import hostile_texts
from programs import node_words, PATIENCE, starting
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import parameter_dict_from_yaml_file
from robots import robot_node, USUAL
from streams import Flexx2Camera, listening, Parameter, stream
import yaml

pytestmark = pytest.mark.usefixtures('ros')

_numbers = itertools.count()


@pytest.mark.parametrize('name', ['process', 'profile'])
def test_no_file_stops_a_start_without_its_name(name, tmp_path):
    for text in hostile_texts(tmp_path):
        with pytest.raises(ValueError, match=f'^{name}: '):
            Flexx2Camera(parameter_overrides=[Parameter(name, value=text)])


def test_misspelt_parameters_are_named():
    with stream(usecas='Mode_5_60fps', **{'effect.ofset.bias': 0.1}) as camera:
        camera.spin_until(lambda: camera.logged('usecas: ', 'did you mean usecase?'))
        camera.spin_until(lambda: camera.logged('did you mean effect.offset.bias?'))
        assert camera.get('usecase') == 'Mode_9_30fps'
        assert len(camera.logged('no such parameter')) == 2
    with robot_node(max_sped=0.1) as robot:
        robot.spin_until(lambda: robot.logged('max_sped: ', 'did you mean max_speed?'))
    with stream(usecase='Mode_5_60fps', **{'effect.offset.bias': 0.1}) as camera:
        camera.next_diagnostics()
        assert not camera.logged('no such parameter')


def test_a_serial_of_digits_stays_as_typed(tmp_path, child_env):
    """Assert the command line's text, and a word on what to write where it is lost."""
    lost = tmp_path / 'lost.yaml'
    lost.write_text('/**:\n  ros__parameters:\n    serial: 0123\n')
    cases = {
        '/typed': (['-p', 'serial:=0123'], '0123'),
        '/lost': (['--params-file', str(lost)], '83'),
    }
    said = {}
    with starting(env=child_env) as start, listening() as listener:
        processes = {
            space: start(node_words('flexx2_camera', '-r', f'__ns:={space}', *arguments))
            for space, (arguments, _) in cases.items()
        }
        for space, (_, serial) in cases.items():
            assert listener.parameters_of(f'{space}/flexx2_camera', 'serial') == [serial]
            processes[space].terminate()
            said[space] = processes[space].communicate(timeout=PATIENCE)[1]
    assert "in quotes, e.g. serial: '0123'" in said['/lost']
    assert 'quotes' not in said['/typed']


# Texts that YAML's or ROS's reader of parameter files makes another type of, or may.
TEXTS = (
    *('*', '0123', 'true', '1e3', 'y', 'inf', 'nan', 'NaN'),
    *('.5', '0x1p3', '~', 'null', '', '5', '-inf', 'nan(1)', '1e400'),
    *('2026-01-01', 'a: b', ' a', "it's", '[1, 2]', '{a: 1}'),
    *('%', 'a\nb', 'lens', '/a b.yaml', '=', 'word ' * 40, '1e+22'),
)
NOT_LOADED = '*', '2026-01-01', 'a: b', '{a: 1}', '=', '%'
LOST_IN_A_FILE = {'1e3', 'y', 'NaN', '0x1p3', 'nan(1)'}
LOST_IN_A_FILE |= {'1e+22', '1e400', *NOT_LOADED}
REFUSED = '^{}: must be a text that `ros2 param dump` and `load` keep as it is, got '


def node_of(kind, *arguments, **values):
    return kind(
        namespace=f'/texts_{next(_numbers)}',
        cli_args=['--ros-args', *arguments],
        parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
    )


def written(node, path):
    """Write a node's parameters as `ros2 param dump` does, and return them."""
    values = {
        name: list(value.value) if hasattr(value.value, 'typecode') else value.value
        for name, value in node._parameters.items()
        if not name.startswith('qos')
    }
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    return values


def check_texts(names, text, other, path):
    """Return which of these parameters keep a text: all together, or else one by one."""
    given = {**dict.fromkeys(names, text), 'effect.offset.bias': 1e-05}
    try:
        first = node_of(Flexx2Camera, **given)
    except InputError as error:
        if len(names) > 1:
            return [kept for name in names for kept in check_texts([name], text, other, path)]
        if not re.match(REFUSED.format(*names), str(error)):
            raise
        return []
    values = written(first, path)
    assert values['effects'] == 'none*'
    second = node_of(Flexx2Camera, '--params-file', str(path))
    for node in (first, second):
        assert {name: node.get_parameter(name).value for name in given} == given
    request = SetParameters.Request(
        parameters=list(parameter_dict_from_yaml_file(str(path), True).values())
    )
    for node in (first, other.camera):
        answer = node._set_parameters_service(request, SetParameters.Response())
        refused = [one.reason for one in answer.results if not one.successful]
        assert all('(read-only)' in reason for reason in refused)
        assert not refused or node is not first
        assert node.get_parameter('frame_id').value == values['frame_id']
        assert node.get_parameter('effect.offset.bias').value == 1e-05
    first.destroy_node()
    second.destroy_node()
    return names


def test_every_text_that_is_reported_survives_dump_and_load(tmp_path):
    """Assert both ways to load a dumped file, and a reason where ROS would change the text."""
    kept = {'serial': set(), 'frame_id': set()}
    with stream() as other:
        for text in TEXTS:
            for name in check_texts(list(kept), text, other, tmp_path / 'dumped.yaml'):
                kept[name].add(text)
    assert set(TEXTS) - kept['serial'] == LOST_IN_A_FILE
    assert kept['frame_id'] >= {'', '~', 'null', 'true', 'inf', 'nan', '5', 'lens'}
    assert not kept['frame_id'] & {*LOST_IN_A_FILE, '0123', '*', '.5', '[1, 2]', '2026-01-01'}


def test_texts_of_the_robot_survive_too(tmp_path):
    for name, value in (('frame_prefix', '1e3'), ('cameras', ['front_left', 'nan'])):
        with pytest.raises(InputError, match=REFUSED.format(name)):
            node_of(RobotCameras, **{name: value})
    given = {**USUAL, 'frame_prefix': '0123', 'cameras': ['true', 'null']}
    first = node_of(RobotCameras, **given)
    values = written(first, tmp_path / 'dumped.yaml')
    second = node_of(RobotCameras, '--params-file', str(tmp_path / 'dumped.yaml'))
    assert {name: second.get_parameter(name).value for name in values} == values
    first.destroy_node()
    second.destroy_node()
