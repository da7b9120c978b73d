"""
Clean environments: the package beside its users' packages resolves, installs, imports and runs.

Only ``make matrix`` runs this: it installs gigabytes into ``build/matrix`` and takes minutes.
Environments with torch are installed where torch has a wheel for CPUs: of an index that
``UV_TORCH_BACKEND`` names, or in a folder that ``PIP_FIND_LINKS`` names. Elsewhere their versions
are resolved, and nothing is downloaded.
"""

from dataclasses import dataclass
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import time

from flexx2_sim_ros.atomic import write_text
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / 'build' / 'matrix'
CORE = 'flexx2_sim_ros.camera'
BATCH = 'flexx2_sim_ros.batch'
# What the tests themselves need.
TESTING = ('pytest', 'hypothesis')
# What the table shows the versions of, beside the packages that an environment is about.
SHOWN = ('mujoco', 'numpy', 'numba', 'warp-lang', 'torch', 'jax')


@dataclass(frozen=True)
class Environment:
    """
    One clean environment.

    * `name`: its folder
    * `extra`: of this package, or nothing
    * `others`: packages beside it
    * `imports`: modules that must import together
    * `pythons`: versions for which all of it has wheels
    * `tests`: test files that run in it
    * `command`: what has to run in it, with arguments
    * `source_only`: whether ``others`` are resolved, but installed without their dependencies:
      they cannot run on a CPU, and tests read their source
    """

    name: str
    extra: str
    others: tuple[str, ...]
    imports: tuple[str, ...]
    pythons: tuple[str, ...] = ('3.11', '3.12', '3.13')
    tests: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    source_only: bool = False


ENVIRONMENTS = (
    Environment('base', '', (), (CORE, BATCH)),
    Environment('all', '[all]', (), (CORE, 'flexx2_sim_ros.rendering.renderer', 'mujoco')),
    # ROS 2 Jazzy has wheels for these two.
    Environment(
        'ros',
        '[all,ros]',
        (),
        ('flexx2_sim_ros.nodes.flexx2_camera', 'rclpy'),
        ('3.11', '3.12'),
        command=('flexx2', 'demo', '--seconds', '1', '--out', 'demo'),
    ),
    Environment(
        'mjlab',
        '[figures]',
        ('mjlab',),
        (BATCH, 'mjlab.envs', 'mujoco_warp'),
        tests=('test_example_mjlab.py',),
    ),
    Environment(
        'playground',
        '[figures]',
        ('playground',),
        (BATCH, 'mujoco_playground', 'mujoco.mjx'),
        tests=('test_example_playground.py',),
    ),
    Environment(
        'isaaclab',
        '',
        ('isaaclab',),
        (BATCH,),
        ('3.11', '3.12'),
        tests=('test_isaac_lab.py',),
        source_only=True,
    ),
    Environment(
        'gym-quadruped',
        '[figures]',
        ('gym-quadruped',),
        (CORE, 'gym_quadruped'),
        tests=('test_example_gym_quadruped.py',),
    ),
    Environment(
        'pybullet',
        '[figures]',
        ('pybullet',),
        (CORE,),
        ('3.11',),
        tests=('test_example_pybullet.py',),
    ),
    Environment(
        'sapien', '[figures]', ('sapien',), (CORE, 'sapien'), tests=('test_example_sapien.py',)
    ),
    Environment(
        'genesis',
        '[figures]',
        ('genesis-world', 'torch'),
        (CORE, 'genesis'),
        tests=('test_example_genesis.py',),
    ),
    Environment('torch', '', ('torch',), (BATCH, 'torch')),
)
CASES = [(one, python) for one in ENVIRONMENTS for python in one.pythons]

pytestmark = pytest.mark.skipif(
    not os.environ.get('FLEXX2_MATRIX'), reason='FLEXX2_MATRIX is not set'
)


def run(*command, cwd=ROOT):
    """Return what a command, which has to succeed, prints."""
    env = {
        name: value
        for name, value in os.environ.items()
        if name not in ('PYTHONPATH', 'AMENT_PREFIX_PATH', 'VIRTUAL_ENV')
    }
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, check=False)
    assert done.returncode == 0, f'{command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}'
    return done.stdout


def cpu_torch(python):
    """Return the options that make uv take torch for CPUs, and whether there is one."""
    if os.environ.get('UV_TORCH_BACKEND'):
        return [], True
    folder = Path(os.environ.get('PIP_FIND_LINKS') or 'none')
    wheels = sorted(folder.glob(f'torch-*+cpu-cp{python.replace(".", "")}-*.whl'))
    if not wheels:
        return [], False
    return [f'torch=={wheels[-1].name.split("-")[1]}', '--find-links', str(folder)], True


@pytest.fixture(scope='module')
def wheel():
    """Build the source distribution and, from it, the wheel that users get."""
    if shutil.which('uv') is None:
        pytest.skip('needs uv: pip install uv')
    shutil.rmtree(FOLDER / 'dist', ignore_errors=True)
    run('uv', 'build', '--quiet', '--out-dir', FOLDER / 'dist', ROOT)
    (path,) = (FOLDER / 'dist').glob('*.whl')
    return path


def installed(environment, python, place, wheel, options):
    """Install an environment and import what has to be together; return its Python."""
    run('uv', 'venv', '--quiet', '--clear', '--python', python, place)
    interpreter = place / 'bin' / 'python'
    install = ('uv', 'pip', 'install', '--quiet', '--python', interpreter)
    testing = TESTING if environment.tests else ()
    if environment.source_only:
        versions = FOLDER / f'{place.name}.txt'
        run(*install, wheel, *testing, '--constraints', versions)
        run(*install, '--no-deps', *environment.others)
    else:
        run(*install, wheel, *environment.others, *testing, *options)
    # Away from the checkout, so that what is imported is what was installed.
    run(interpreter, '-c', f'import {", ".join(environment.imports)}', cwd=FOLDER)
    return interpreter


def tried(environment, interpreter):
    """Run the command and the tests of an environment; return what to say of it."""
    result = 'imports'
    if environment.command:
        program, *arguments = environment.command
        run(interpreter.parent / program, *arguments, cwd=interpreter.parents[1])
        result = ' '.join(environment.command[:2])
    if environment.tests:
        files = [ROOT / 'test' / name for name in environment.tests]
        # -P: what is tested is what was installed, not the checkout.
        pytest_run = ('-P', '-m', 'pytest', '-q', '-p', 'no:cacheprovider')
        printed = run(interpreter, *pytest_run, *files)
        result = printed.strip().splitlines()[-1].split(' in ')[0]
        assert 'skipped' not in result or 'vulkan' in printed, printed[-2000:]
    return result


@pytest.mark.parametrize(
    ('environment', 'python'), CASES, ids=[f'{one.name}-{python}' for one, python in CASES]
)
def test_a_clean_environment(environment, python, wheel):
    """Resolve; install, import and run the tests of this environment, where a CPU suffices."""
    if subprocess.run(
        ['uv', 'python', 'find', python], capture_output=True, check=False
    ).returncode:
        pytest.skip(f'there is no Python {python} here: uv python install {python}')
    began = time.monotonic()
    package = f'flexx2_sim_ros{environment.extra} @ {wheel.as_uri()}'
    FOLDER.mkdir(parents=True, exist_ok=True)
    place = FOLDER / f'{environment.name}-{python}'
    requirements, versions_file = (FOLDER / f'{place.name}.{end}' for end in ('in', 'txt'))
    write_text(requirements, '\n'.join([package, *environment.others]) + '\n')
    resolved = run('uv', 'pip', 'compile', '--quiet', '--python-version', python, requirements)
    write_text(versions_file, re.sub(r'^flexx2.*\n', '', resolved, flags=re.M))
    needs_torch = re.search(r'^torch==', resolved, re.M) is not None
    options, on_cpu = cpu_torch(python)
    result = 'resolved'
    if environment.source_only or not needs_torch or on_cpu:
        options = options if needs_torch else []
        interpreter = installed(environment, python, place, package, options)
        result = tried(environment, interpreter)
        if not environment.source_only:
            resolved = run('uv', 'pip', 'freeze', '--python', interpreter)
    found = dict(re.findall(r'^([\w-]+)==(\S+)', resolved, re.M))
    row = {
        'environment': ' + '.join([f'`flexx2_sim_ros{environment.extra}`', *environment.others]),
        'python': python,
        'versions': {name: found[name] for name in (*SHOWN, *environment.others) if name in found},
        'result': result,
        'seconds': round(time.monotonic() - began),
    }
    write_text(FOLDER / f'{place.name}.json', json.dumps(row))


def test_the_table_of_the_matrix():
    """Write what was found as the table of docs/install.md, to build/matrix/table.md."""
    lines = ['| environment | Python | versions | result | seconds |', '|---|---|---|---|---|']
    for environment, python in CASES:
        path = FOLDER / f'{environment.name}-{python}.json'
        if path.is_file():
            row = json.loads(path.read_text())
            versions = ', '.join(f'{name} {one}' for name, one in row['versions'].items())
            lines.append(
                f'| {row["environment"]} | {python} | {versions} | {row["result"]} '
                f'| {row["seconds"]} |'
            )
    write_text(FOLDER / 'table.md', '\n'.join(lines) + '\n')
    assert len(lines) > 2
