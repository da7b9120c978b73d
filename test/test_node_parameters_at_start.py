"""Parameters that nodes get at their start: hostile, misspelt, and of another type."""

from pathlib import Path
import subprocess
import sys

from hostile_files import hostile_texts
import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.parameter_client import AsyncParameterClient
from robots import robot_node
from streams import Flexx2Camera, Listener, Parameter, stream

pytestmark = pytest.mark.usefixtures('ros')


@pytest.mark.parametrize('name', ['effects', 'profile'])
def test_no_file_gives_a_traceback_at_the_start(
    name: str, tmp_path: Path, child_env: dict[str, str]
) -> None:
    """Assert one sentence and exit code 1."""
    path = tmp_path / 'deep.yaml'
    path.write_text('[' * 3000)
    done = subprocess.run(
        [
            sys.executable,
            '-m',
            'flexx2_sim_ros.nodes.flexx2_camera',
            '--ros-args',
            '-p',
            f'{name}:={path}',
        ],
        env=child_env,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f'error: {name}: ')
    assert done.stderr.count('\n') == 1
    for text in hostile_texts(tmp_path / 'more' if (tmp_path / 'more').mkdir() is None else path):
        if name == 'effects' and text in ('*', 'a\x1b[31mb'):
            continue
        with pytest.raises(ValueError, match=f'^{name}: '):
            Flexx2Camera(parameter_overrides=[Parameter(name, value=text)])


def test_misspelt_parameters_are_named() -> None:
    """Assert both nodes warn of what they were given and do not have."""
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


def serial_of(listener: Listener, name: str) -> str:
    client = AsyncParameterClient(listener.node, name)
    listener.spin_until(client.services_are_ready, name)
    value = listener.wait(client.get_parameters(['serial'])).values[0]
    assert value.type == ParameterType.PARAMETER_STRING
    return str(value.string_value)


def test_a_serial_of_digits_stays_as_typed(tmp_path: Path, child_env: dict[str, str]) -> None:
    """Assert the command line's text, and a word on what to write where it is lost."""
    lost = tmp_path / 'lost.yaml'
    lost.write_text('/**:\n  ros__parameters:\n    serial: 0123\n')
    cases = {
        '/typed': (['-p', 'serial:=0123'], '0123'),
        '/lost': (['--params-file', str(lost)], '83'),
    }
    processes = {
        space: subprocess.Popen(
            [
                sys.executable,
                '-m',
                'flexx2_sim_ros.nodes.flexx2_camera',
                '--ros-args',
                '-r',
                f'__ns:={space}',
                *arguments,
            ],
            env=child_env,
            stderr=subprocess.PIPE,
            text=True,
        )
        for space, (arguments, _) in cases.items()
    }
    listener = Listener()
    try:
        for space, (_, serial) in cases.items():
            assert serial_of(listener, f'{space}/flexx2_camera') == serial
    finally:
        listener.close()
        said = {}
        for space, process in processes.items():
            process.terminate()
            said[space] = process.communicate(timeout=60)[1]
    assert "in quotes, e.g. serial: '0123'" in said['/lost']
    assert 'quotes' not in said['/typed']
