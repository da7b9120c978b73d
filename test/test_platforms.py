"""What the package depends on is there: wheels for robots and macOS, keys of rosdep."""

import os
from pathlib import Path
import runpy
import subprocess
import sys
import tomllib
import urllib.request
from xml.etree import ElementTree

import pytest
import setuptools
import yaml

ROOT = Path(__file__).resolve().parents[1]
ROSDISTRO = 'https://raw.githubusercontent.com/ros/rosdistro/master'
PYTHON = f'{sys.version_info.major}.{sys.version_info.minor}'
# The oldest system that has wheels of all of them: Jetson (JetPack 6) and Raspberry Pi OS 12 have
# glibc 2.35 and 2.36.
PLATFORMS = {
    'aarch64': [f'manylinux_2_{minor}_aarch64' for minor in (17, 27, 28, 34)],
    'arm64': [f'macosx_{major}_0_arm64' for major in (11, 12, 13, 14)],
}


def resolved(*requirements, platforms=()):
    """Return what pip says when it cannot resolve wheels for a platform; empty: it can."""
    pip = (sys.executable, '-m', 'pip', 'install', '--dry-run', '--quiet', '--ignore-installed')
    options = ('--only-binary=:all:', '--python-version', PYTHON, '--target', 'nowhere')
    for_platforms = [word for one in platforms for word in ('--platform', one)]
    command = [*pip, *options, *for_platforms, '--retries', '0', *requirements]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stderr if done.returncode else ''


@pytest.fixture(scope='module')
def declared():
    """Return what setup.py gives to setuptools."""
    given = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, 'setup', lambda **words: given.update(words))
        runpy.run_path(str(ROOT / 'setup.py'))
    if resolved('numpy'):
        pytest.skip('no package index can be reached')
    return given


@pytest.mark.parametrize('machine', PLATFORMS)
def test_all_dependencies_have_wheels(declared, machine):
    wanted = []
    for one in (*declared['install_requires'], *declared['extras_require']['all']):
        name, _, marker = one.partition(';')
        if not marker or f'"{machine}"' not in marker:  # pip looks at the marker of this machine
            wanted.append(name)
    assert len(wanted) > 10
    assert not resolved(*wanted, platforms=tuple(PLATFORMS[machine]))


def test_what_is_left_out_on_a_robot_has_no_wheel_there(declared):
    for one in declared['extras_require']['all']:
        name, _, marker = one.partition(';')
        if marker:
            said = resolved(name, '--no-deps', platforms=tuple(PLATFORMS['aarch64']))
            assert 'No matching distribution' in said


def rosdistro(path):
    """Return a YAML file of rosdistro: of a checkout in FLEXX2_ROSDISTRO, or from GitHub."""
    checkout = os.environ.get('FLEXX2_ROSDISTRO')
    if checkout:
        text = Path(checkout, path).read_bytes()
    else:
        try:
            with urllib.request.urlopen(f'{ROSDISTRO}/{path}', timeout=20) as answer:
                text = answer.read()
        except OSError:
            pytest.skip('rosdistro cannot be reached: FLEXX2_ROSDISTRO names a checkout')
    return dict(yaml.load(text, getattr(yaml, 'CSafeLoader', yaml.SafeLoader)))  # noqa: S506


@pytest.mark.parametrize(('distribution', 'ubuntu'), [('jazzy', 'noble'), ('lyrical', 'resolute')])
def test_rosdep_knows_all_keys_without_pip(distribution, ubuntu):
    entries = ElementTree.parse(ROOT / 'package.xml').findall('*')
    keys = {str(one.text) for one in entries if one.tag.endswith('depend')}
    repositories = rosdistro(f'{distribution}/distribution.yaml')['repositories']
    released = {
        name
        for repository, one in repositories.items()
        for name in (one.get('release') or {}).get('packages', [repository])
        if one.get('release')
    }
    known = {**rosdistro('rosdep/base.yaml'), **rosdistro('rosdep/python.yaml')}
    for key in sorted(keys - released):
        rule = known[key]['ubuntu']
        if isinstance(rule, dict):
            rule = rule.get(ubuntu, rule.get('*'))
        assert rule, key
        assert 'pip' not in rule, key


def test_pixi_takes_what_there_is(declared):
    content = tomllib.loads((ROOT / 'pixi.toml').read_text())
    own = content['pypi-dependencies']['flexx2_sim_ros']
    assert set(own['extras']) <= set(declared['extras_require'])
    programs = {one.split(' = ')[0] for one in declared['entry_points']['console_scripts']}
    assert {task.split()[0] for task in content['tasks'].values()} == programs
