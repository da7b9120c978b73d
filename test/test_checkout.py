"""What developers run in a checkout: make, and the linters of ament, as `colcon test` does."""

import os
from pathlib import Path
import subprocess
import sys
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXECUTABLES = {'flexx2', 'flexx2_camera', 'go1_cameras'}
CODE = [
    str(ROOT / name) for name in ('flexx2_sim_ros', 'study', 'test', 'bench', 'launch', 'setup.py')
]


# Without ROS, ament's plugins of flake8 and pydocstyle run in `make lint`. `ament_copyright` does
# not run: no file has a header of its own.
def test_ament_flake8():
    main = pytest.importorskip('ament_flake8.main')
    code, errors = main.main_with_errors(argv=['--config', str(ROOT / '.flake8'), *CODE])
    assert code == 0, '\n'.join(errors)


def test_ament_pep257():
    main = pytest.importorskip('ament_pep257.main')
    assert main.main(argv=CODE) == 0


def test_no_file_has_a_copyright_header_and_the_licence_is_said_once():
    files = [path for folder in CODE for path in Path(folder).rglob('*.py')]
    assert len(files) > 300
    with_header = [path.name for path in files if 'Copyright' in path.read_text()[:300]]
    assert with_header == []
    assert 'Apache License' in (ROOT / 'LICENSE').read_text()[:200]
    assert ElementTree.parse(ROOT / 'package.xml').findtext('license') == 'Apache-2.0'


@pytest.mark.skipif(
    not Path(sys.executable).with_name('flexx2').is_file(),
    reason='the package is not installed with pip',
)
def test_make_shell_finds_the_commands():
    # -o: an environment that is there is not made again.
    command = 'make', '-s', '-o', '.venv/.complete', 'shell', f'BIN={Path(sys.executable).parent}'
    typed = ''.join(f'command -v {name}\n' for name in sorted(EXECUTABLES))
    usual = {'capture_output': True, 'text': True, 'check': True, 'cwd': ROOT}
    shell = {**os.environ, 'SHELL': '/bin/sh'}
    done = subprocess.run(command, input=typed, env=shell, **usual)
    found = [Path(line) for line in done.stdout.splitlines() if line.startswith('/')]
    assert {path.name for path in found} == EXECUTABLES
    assert {path.parent for path in found} == {Path(sys.executable).parent}


def make_demo_on_aarch64(tmp_path, **env):
    """Run the rule with commands that only say what they are asked for."""
    programs = {
        'python3': 'test "$2" != "import rclpy" || test -e "$PYTHONPATH/rclpy.py"',
        'pip': 'echo "pip $*"',
        'flexx2': 'echo "flexx2 $* with $PYTHONPATH"',
    }
    for name, program in programs.items():
        (tmp_path / name).write_text(f'#!/bin/sh\n{program}\n')
        (tmp_path / name).chmod(0o755)
    names = {'MACHINE': 'aarch64', 'JAZZY': tmp_path / 'jazzy', 'BIN': tmp_path}
    names |= {'PYTHON': tmp_path / 'python3', 'STAMP': tmp_path / 'complete'}
    command = ['make', '-s', 'demo', *(f'{name}={value}' for name, value in names.items())]
    kept = {k: v for k, v in os.environ.items() if k not in ('PYTHONPATH', 'AMENT_PREFIX_PATH')}
    usual = {'capture_output': True, 'text': True, 'check': False}
    return subprocess.run(command, cwd=ROOT, env={**kept, **env}, **usual)


def test_a_computer_without_wheels_of_ros_uses_the_ros_that_it_has(tmp_path):
    done = make_demo_on_aarch64(tmp_path)
    assert done.returncode == 2
    assert 'There are no wheels of ROS 2 for aarch64: install ROS 2 Jazzy in' in done.stderr
    assert 'pip' not in done.stdout
    for folder in (tmp_path / 'jazzy', tmp_path / 'mine'):
        folder.mkdir()
        (folder / 'rclpy.py').touch()
    ros = f'export PYTHONPATH={tmp_path}/jazzy AMENT_PREFIX_PATH={tmp_path}/jazzy:/more\n'
    (tmp_path / 'jazzy' / 'setup.bash').write_text(ros)
    mine = {'AMENT_PREFIX_PATH': f'{tmp_path}/mine', 'PYTHONPATH': f'{tmp_path}/mine'}
    for folder, env in (('jazzy', {}), ('mine', mine)):
        done = make_demo_on_aarch64(tmp_path, **env)
        assert done.returncode == 0, done.stderr
        assert f'for aarch64: uses the one in {tmp_path}/{folder}.' in done.stdout
        assert f'flexx2 demo with {tmp_path}/{folder}' in done.stdout
        assert '[ros' not in done.stdout
        (tmp_path / 'complete').unlink()
