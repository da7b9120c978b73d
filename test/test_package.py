"""The package as a user gets it: from ``colcon build`` and from ``pip install``."""

import ast
from functools import cache
import importlib.metadata
import importlib.util
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from xml.etree import ElementTree
import zipfile

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import executable
import numpy as np
from programs import first_line, run_python
import pytest
import yaml

NAME = 'flexx2_sim_ros'
ROOT = Path(__file__).resolve().parents[1]
EXECUTABLES = {'flexx2', 'flexx2_camera', 'go1_cameras'}
PAGE = Path(NAME, 'view', 'page')
MODES = set(yaml.safe_load((ROOT / 'config' / 'modes.yaml').read_text())['modes'])
# Import name: (rosdep key, name on the Python package index). Any other name is a ROS package.
# Keys that install with pip are not in package.xml: the build farm refuses them.
LIBRARIES = {
    'PIL': ('python3-pil', 'pillow'),
    'matplotlib': ('python3-matplotlib', 'matplotlib'),
    'mujoco': ('', 'mujoco'),
    'numba': ('python3-numba', 'numba'),
    'numpy': ('python3-numpy', 'numpy'),
    'rich': ('python3-rich', 'rich'),
    'rosbags': ('', 'rosbags'),
    'scipy': ('python3-scipy', 'scipy'),
    'sklearn': ('python3-sklearn', 'scikit-learn'),
    # Ubuntu's package of scikit-learn depends on it.
    'threadpoolctl': ('python3-sklearn', 'threadpoolctl'),
    'tornado': ('python3-tornado', 'tornado'),
    'yaml': ('python3-yaml', 'PyYAML'),
}
# Extras of pip's, with no key in rosdep: import name, name on the Python package index.
EXTRAS = {
    **{name: name for name in ('av', 'distributed', 'embreex', 'h5py')},
    **{name: name for name in ('pyarrow', 'pyoctomap', 'trimesh')},
    'cv2': 'opencv-python-headless',
    'mujoco_menagerie': 'mujoco-menagerie',
    'warp': 'warp-lang',
    # It brings its decompressors.
    **dict.fromkeys(('backports', 'compression', 'lz4'), 'rosbags'),
}


def environment(**changes):
    """Return the environment of a shell in which neither ROS nor this checkout was sourced."""
    of_ros = 'PYTHONPATH', 'AMENT_PREFIX_PATH', 'COLCON_PREFIX_PATH'
    kept = {key: value for key, value in os.environ.items() if key not in of_ros}
    return kept | {key: str(value) for key, value in changes.items()}


def run(*command, cwd, **changes):
    """Return what a command, which has to succeed, prints in a folder."""
    usual = {'capture_output': True, 'text': True, 'check': False}
    done = subprocess.run(command, cwd=cwd, env=environment(**changes), **usual)
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout


def site_packages(prefix):
    """Return where Python modules are under an install prefix."""
    return Path(sysconfig.get_path('purelib', vars={'base': str(prefix)}))


def files_under(folder):
    """Return the files under a folder, relative to it, but for what Python compiled."""
    files = {path.relative_to(folder) for path in folder.rglob('*') if path.is_file()}
    return {path for path in files if '__pycache__' not in path.parts}


@cache
def ros_packages():
    """Return the ROS packages that the package and its launch files import anywhere."""
    known = {NAME, *LIBRARIES, *EXTRAS, *sys.stdlib_module_names}
    found = set()
    for path in (*(ROOT / NAME).rglob('*.py'), *(ROOT / 'launch').glob('*.py')):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ''] if isinstance(node, ast.ImportFrom) else []
            found |= {name.split('.')[0] for name in names}
    return found - known


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Copy what the package is built from."""
    copy = tmp_path_factory.mktemp('source') / NAME
    copy.mkdir()
    for folder in (NAME, 'config', 'launch', 'resource'):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns('__pycache__'))
    files = 'CHANGELOG.rst', 'LICENSE', 'MANIFEST.in', 'README.md', 'package.xml'
    for file in (*files, 'pyproject.toml', 'setup.cfg', 'setup.py'):
        shutil.copy(ROOT / file, copy)
    return copy


@pytest.fixture(scope='module')
def workspace(source, tmp_path_factory):
    """Build the package with colcon; return the workspace."""
    work = tmp_path_factory.mktemp('workspace')
    build = '-m', 'colcon', 'build', '--base-paths', source
    run(sys.executable, *build, cwd=work, COLCON_HOME=work)
    return work


def in_workspace(workspace, script):
    """Return what a shell prints in which the workspace was sourced."""
    return run('bash', '-c', f'. install/setup.bash && {script}', cwd=workspace)


def test_colcon_puts_files_where_ros_looks(workspace):
    prefix = workspace / 'install' / NAME
    share = prefix / 'share' / NAME
    assert files_under(prefix / 'lib' / NAME) == {Path(name) for name in EXECUTABLES}
    assert (prefix / 'share/ament_index/resource_index/packages' / NAME).is_file()
    assert (share / 'package.xml').is_file()
    for folder in ('config', 'launch'):
        assert files_under(share / folder) == files_under(ROOT / folder)
    assert files_under(site_packages(prefix) / PAGE) == files_under(ROOT / PAGE)


def test_colcon_install_runs_and_its_camera_is_compiled(workspace):
    flexx2 = f'"$AMENT_PREFIX_PATH/lib/{NAME}/flexx2"'
    printed = in_workspace(workspace, f'{flexx2} modes && {flexx2} compile --no-effects')
    assert len(MODES) == 9
    assert set(re.findall(r'Mode_\w+', printed)) == MODES
    assert printed.endswith('everything was compiled before\n')


def test_launch_files_find_the_executables(workspace):
    names = sorted(EXECUTABLES)
    program = f'from {NAME}.paths import executable; print(*map(executable, {names}))'
    found = in_workspace(workspace, f'"{sys.executable}" -c "{program}"').split()
    folder = workspace / 'install' / NAME / 'lib' / NAME
    assert found == [str(folder / name) for name in names]
    # Without an install beside it: those of this Python, or of a workspace that was sourced.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('AMENT_PREFIX_PATH', str(workspace / 'install' / NAME))
        of_python = Path(sys.executable).parent / 'flexx2'
        assert executable('flexx2') == (of_python if of_python.is_file() else folder / 'flexx2')
        patch.setattr(sys, 'executable', str(workspace / 'python'))
        assert executable('flexx2') == folder / 'flexx2'
    with pytest.raises(InputError, match='flexx3: must be an installed executable'):
        executable('flexx3')


@pytest.fixture(scope='module')
def distributions(source, tmp_path_factory):
    """Build the source distribution and, from it, the wheel, as `make release` does."""
    pytest.importorskip('build')
    pytest.importorskip('twine')
    dist = tmp_path_factory.mktemp('dist')
    run(sys.executable, '-m', 'build', '--no-isolation', '--outdir', dist, source, cwd=dist)
    (sdist,), (wheel,) = dist.glob('*.tar.gz'), dist.glob('*.whl')
    return sdist, wheel


def test_a_release_holds_all_files(distributions):
    sdist, wheel = distributions
    run(sys.executable, '-m', 'twine', 'check', '--strict', *distributions, cwd=sdist.parent)
    data = Path(wheel.name.removesuffix('-py3-none-any.whl') + '.data', 'data', 'share', NAME)
    code = {Path(NAME, path) for path in files_under(ROOT / NAME)}
    assert {Path(NAME, 'py.typed'), PAGE / 'view.js'} <= code
    shared = {
        Path(folder, path)
        for folder in ('config', 'launch')
        for path in files_under(ROOT / folder)
    }
    with zipfile.ZipFile(wheel) as archive:
        inside = {Path(name) for name in archive.namelist()}
    assert code | {data / path for path in shared} <= inside
    with tarfile.open(sdist) as packed:
        inside = {Path(*Path(name).parts[1:]) for name in packed.getnames()}
    assert code | shared <= inside
    assert {Path('package.xml'), Path('CHANGELOG.rst'), Path('README.md')} <= inside


def test_the_wheel_runs_in_a_clean_environment(distributions, tmp_path):
    clean = tmp_path / 'clean'
    run(sys.executable, '-m', 'venv', '--without-pip', clean, cwd=tmp_path)
    python = clean / 'bin' / 'python'
    install = ('install', '--no-index', '--no-deps', distributions[1])
    run(sys.executable, '-m', 'pip', '--python', python, *install, cwd=tmp_path)
    # What it depends on comes from the environment of the tests; an editable install of the
    # package there is not seen, since its own .pth file is not read.
    (site_packages(clean) / 'dependencies.pth').write_text(sysconfig.get_path('purelib'))
    program = f'from {NAME} import paths; print(paths.__file__, paths.config_dir())'
    module, config = run(python, '-c', program, cwd=tmp_path).split()
    assert Path(module).is_relative_to(clean)
    assert Path(config) == clean / 'share' / NAME / 'config'
    assert {Path(name) for name in EXECUTABLES} <= files_under(clean / 'bin')
    flexx2 = clean / 'bin' / 'flexx2'
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    assert run(flexx2, '--version', cwd=tmp_path).split()[-1] == version
    assert set(re.findall(r'Mode_\w+', run(flexx2, 'modes', cwd=tmp_path))) == MODES
    help_of_gap = run(flexx2, 'gap', '--help', cwd=tmp_path)
    assert 'diagnose' in help_of_gap
    assert 'benchmark' not in help_of_gap  # needs the blind camera, which is in a checkout


@pytest.mark.skipif(importlib.util.find_spec('warp') is None, reason='needs warp-lang')
def test_a_batch_needs_no_numba_and_no_simulator(tmp_path):
    """Assert that importing it imports none of them, and that all effects run without numba."""
    apart = "{'numba', 'rclpy', 'mujoco', 'matplotlib', 'rosbags', 'sklearn'} & set(sys.modules)"
    program = f"""
import sys, numpy as np
from {NAME}.batch import BatchCamera
print({apart})
from {NAME}.effects import registry
own = {{name: None for name, kind in registry().items() if kind.batched is not None}}
seen = BatchCamera(2, effects=own, device='cpu')(np.full((2, 24, 32), 1.2, np.float32))
print({apart}, len(own) > 20, np.isfinite(seen).any())
"""
    printed = run(sys.executable, '-c', program, cwd=tmp_path, PYTHONPATH=ROOT).splitlines()
    assert [line for line in printed if line.startswith('set')] == ['set()', 'set() True True']


# What `pip install .` does not bring.
OF_EXTRAS = ('matplotlib', 'mujoco', 'rclpy', 'rosbags', 'sklearn', 'threadpoolctl', 'tornado')


def without(names, module, *commands):
    """Return a program that runs a module's `main` where libraries are not installed."""
    return f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {names}:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)
sys.meta_path.insert(0, Missing())
from {NAME}.{module} import main
sys.exit(max([main() for sys.argv[1:] in {[one.split() for one in commands]}]))
"""


@pytest.mark.parametrize(
    ('module', 'commands', 'missing'),
    [
        (
            'cli.main',
            ['modes', 'effects', 'simulate scene.npz out.npz', 'export octomap_server'],
            '',
        ),
        ('cli.main', ['convert bag.mcap out.npz'], 'rosbags'),
        ('cli.main', ['characterize capture campaign'], 'mujoco'),
        ('nodes.go1_cameras', [''], 'mujoco'),
    ],
)
def test_optional_libraries_are_imported_only_where_needed(tmp_path, module, commands, missing):
    if module.startswith('nodes'):
        pytest.importorskip('rclpy')
    (tmp_path / 'bag.mcap').touch()
    np.savez(tmp_path / 'scene.npz', clean_depth=np.full((24, 32), 1.5), K=np.eye(3))
    program = without(('mujoco', 'rosbags') if missing else OF_EXTRAS, module, *commands)
    done = run_python('-c', program, cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    if missing:
        assert done.returncode in (1, 2)
        line = done.stderr.strip().splitlines()[-1]
        assert f'error: {missing} is not installed, and this needs it: pip install "' in line
        assert 'Traceback' not in done.stderr
    else:
        assert done.returncode == 0, done.stderr


def test_the_camera_node_needs_neither_mujoco_nor_rosbags():
    pytest.importorskip('rclpy')
    words = '--ros-args -r __ns:=/needs_little'
    program = without(('mujoco', 'rosbags'), 'nodes.flexx2_camera', words)
    line = first_line([sys.executable, '-c', program])
    assert 'waiting for /needs_little/clean/depth_image' in line


def test_every_import_is_a_declared_dependency():
    declared = {
        depend.text
        for depend in ElementTree.parse(ROOT / 'package.xml').findall('*')
        if depend.tag.endswith('depend')
    }
    setup = (ROOT / 'setup.py').read_text()
    for key, distribution in LIBRARIES.values():
        assert not key or key in declared
        assert f"'{distribution}>=" in setup
    for distribution in EXTRAS.values():
        assert f"'{distribution}" in setup
    assert {*ros_packages(), 'ros2launch'} <= declared  # the last one is `ros2 launch`
    assert not [key for key in declared if key and key.endswith('-pip')]


def test_the_dockerfile_does_what_is_tested_here():
    text = (ROOT / 'Dockerfile').read_text()
    assert 'FROM ros:jazzy' in text
    installed = re.findall(r'pip install --no-cache-dir --break-system-packages (.*) \\', text)
    # What package.xml leaves out, a numba that setup.py accepts, and nothing else.
    by_pip = {distribution for key, distribution in LIBRARIES.values() if not key}
    numba = next(iter(re.findall(r"'numba>=[\d.]+'", (ROOT / 'setup.py').read_text())))
    assert {one for line in installed for one in line.split()} == by_pip | {numba}
    for command in ('rosdep install', 'colcon build', 'colcon test', 'ros2 run flexx2_sim_ros'):
        assert command in text
    for name in re.findall(r'ros2 run flexx2_sim_ros (\w+)', text):
        assert name in EXECUTABLES


def test_one_version_everywhere(workspace):
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    site = site_packages(workspace / 'install' / NAME)
    installed = importlib.metadata.distributions(name=NAME, path=[str(site)])
    changes = re.findall(r'^(\d+\.\d+\.\d+) \(.*\)$', (ROOT / 'CHANGELOG.rst').read_text(), re.M)
    assert [found.version for found in installed] == [version]
    assert changes[0] == version
    assert __import__(NAME).__version__ == version
    assert yaml.safe_load((ROOT / 'CITATION.cff').read_text())['version'] == version


def test_bloom_can_read_this_release():
    pytest.importorskip('catkin_pkg')  # bloom reads with it
    from catkin_pkg.changelog import get_changelog_from_path
    from catkin_pkg.package import parse_package

    warnings = []
    package = parse_package(ROOT / 'package.xml', warnings=warnings)
    changes = get_changelog_from_path(str(ROOT), package.name)
    assert not warnings
    assert changes.get_content_of_version(package.version)
