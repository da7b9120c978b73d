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


@dataclass(frozen=True)
class Environment:
    """
    One clean environment.

    Attributes
    ----------
    name : str
        Its folder.
    extra : str
        Of this package, or nothing.
    others : tuple of str
        Packages beside it.
    imports : tuple of str
        Modules that must import together.
    pythons : tuple of str
        Versions for which all of it has wheels.
    tests : tuple of str
        Test files that run in it.
    command : tuple of str
        What has to run in it, with arguments.

    """

    name: str
    extra: str
    others: tuple[str, ...]
    imports: tuple[str, ...]
    pythons: tuple[str, ...] = ('3.11', '3.12', '3.13')
    tests: tuple[str, ...] = ()
    command: tuple[str, ...] = ()


ENVIRONMENTS = (
    Environment('base', '', (), (CORE, 'flexx2_sim_ros.rendering.renderer', 'mujoco')),
    # ROS 2 Jazzy has wheels for these two.
    Environment(
        'ros',
        '[ros]',
        (),
        ('flexx2_sim_ros.nodes.flexx2_camera', 'rclpy'),
        ('3.11', '3.12'),
        command=('flexx2', 'demo', '--seconds', '1', '--out', 'demo'),
    ),
    Environment(
        'mjlab',
        '[batch]',
        ('mjlab',),
        (BATCH, 'mjlab.envs', 'mujoco_warp'),
        tests=('test_example_mjlab.py',),
    ),
    Environment(
        'playground', '[batch]', ('playground',), (BATCH, 'mujoco_playground', 'mujoco.mjx')
    ),
    Environment('torch', '[batch]', ('torch',), (BATCH, 'torch')),
)
CASES = [(one, python) for one in ENVIRONMENTS for python in one.pythons]

pytestmark = pytest.mark.skipif(
    not os.environ.get('FLEXX2_MATRIX'), reason='FLEXX2_MATRIX is not set'
)


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    """Return what a command, which has to succeed, prints."""
    env = {
        name: value
        for name, value in os.environ.items()
        if name not in ('PYTHONPATH', 'AMENT_PREFIX_PATH', 'VIRTUAL_ENV')
    }
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, check=False)
    assert done.returncode == 0, f'{command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}'
    return done.stdout


def cpu_torch(python: str) -> tuple[list[str], bool]:
    """Return the options that make uv take torch for CPUs, and whether there is one."""
    if os.environ.get('UV_TORCH_BACKEND'):
        return [], True
    folder = Path(os.environ.get('PIP_FIND_LINKS') or 'none')
    wheels = sorted(folder.glob(f'torch-*+cpu-cp{python.replace(".", "")}-*.whl'))
    if not wheels:
        return [], False
    return [f'torch=={wheels[-1].name.split("-")[1]}', '--find-links', str(folder)], True


@pytest.fixture(scope='module')
def wheel() -> Path:
    """Build the source distribution and, from it, the wheel that users get."""
    if shutil.which('uv') is None:
        pytest.skip('needs uv: pip install uv')
    shutil.rmtree(FOLDER / 'dist', ignore_errors=True)
    run('uv', 'build', '--quiet', '--out-dir', FOLDER / 'dist', ROOT)
    (path,) = (FOLDER / 'dist').glob('*.whl')
    return path


@pytest.mark.parametrize(
    ('environment', 'python'), CASES, ids=[f'{one.name}-{python}' for one, python in CASES]
)
def test_a_clean_environment(environment: Environment, python: str, wheel: Path) -> None:
    """Resolve; install, import and run the tests of this environment, where a CPU suffices."""
    if subprocess.run(
        ['uv', 'python', 'find', python], capture_output=True, check=False
    ).returncode:
        pytest.skip(f'there is no Python {python} here: uv python install {python}')
    began = time.monotonic()
    wanted = [f'flexx2_sim_ros{environment.extra} @ {wheel.as_uri()}', *environment.others]
    FOLDER.mkdir(parents=True, exist_ok=True)
    place = FOLDER / f'{environment.name}-{python}'
    requirements = FOLDER / f'{place.name}.in'
    write_text(requirements, '\n'.join(wanted) + '\n')
    resolved = run('uv', 'pip', 'compile', '--quiet', '--python-version', python, requirements)
    options, on_cpu = cpu_torch(python)
    needs_torch = re.search(r'^torch==', resolved, re.M) is not None
    tests, result = environment.tests, 'resolved'
    if on_cpu or not needs_torch:
        run('uv', 'venv', '--quiet', '--clear', '--python', python, place)
        interpreter = place / 'bin' / 'python'
        install = ('uv', 'pip', 'install', '--quiet', '--python', interpreter)
        run(*install, *wanted, *(TESTING if tests else ()), *(options if needs_torch else ()))
        # Away from the checkout, so that what is imported is what was installed.
        run(interpreter, '-c', f'import {", ".join(environment.imports)}', cwd=FOLDER)
        resolved = run('uv', 'pip', 'freeze', '--python', interpreter)
        result = 'imports'
        if environment.command:
            program, *arguments = environment.command
            run(place / 'bin' / program, *arguments, cwd=place)
            result = ' '.join(environment.command[:2])
        if tests:
            files = [ROOT / 'test' / name for name in tests]
            printed = run(interpreter, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *files)
            result = printed.strip().splitlines()[-1].split(' in ')[0]
            assert 'skipped' not in result
    versions = dict(re.findall(r'^([\w-]+)==(\S+)', resolved, re.M))
    row = {
        'environment': ' + '.join([f'`flexx2_sim_ros{environment.extra}`', *environment.others]),
        'python': python,
        'versions': {
            name: versions[name]
            for name in ('mujoco', 'numpy', 'numba', 'warp-lang', 'torch', 'jax', 'mjlab')
            if name in versions
        },
        'result': result,
        'seconds': round(time.monotonic() - began),
    }
    write_text(FOLDER / f'{place.name}.json', json.dumps(row))


def test_the_table_of_the_matrix() -> None:
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
