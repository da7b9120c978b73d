"""The core and its extras have wheels for computers of robots and for macOS."""

from pathlib import Path
import runpy
import subprocess
import sys
from typing import Any

import pytest
import setuptools

ROOT = Path(__file__).resolve().parents[1]
# The oldest system that has wheels of all of them: Jetson (JetPack 6) and Raspberry Pi OS 12 have
# glibc 2.35 and 2.36.
PLATFORMS = {
    'aarch64': [f'manylinux_2_{minor}_aarch64' for minor in (17, 27, 28, 34)],
    'arm64': [f'macosx_{major}_0_arm64' for major in (11, 12, 13, 14)],
}


def resolved(*requirements: str, platforms: tuple[str, ...] = ()) -> str:
    """Return what pip says when it cannot resolve wheels for a platform; empty: it can."""
    pip = (sys.executable, '-m', 'pip', 'install', '--dry-run', '--quiet', '--ignore-installed')
    options = ('--only-binary=:all:', '--python-version', '3.11', '--target', 'nowhere')
    for_platforms = [word for one in platforms for word in ('--platform', one)]
    done = subprocess.run(
        [*pip, *options, *for_platforms, '--retries', '0', *requirements],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stderr if done.returncode else ''


@pytest.fixture(scope='module')
def declared() -> dict[str, Any]:
    """Return what setup.py gives to setuptools."""
    given: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, 'setup', lambda **words: given.update(words))
        runpy.run_path(str(ROOT / 'setup.py'))
    if resolved('numpy'):
        pytest.skip('no package index can be reached')
    return given


@pytest.mark.parametrize('machine', PLATFORMS)
def test_all_dependencies_have_wheels(declared: dict[str, Any], machine: str) -> None:
    wanted = []
    for one in (*declared['install_requires'], *declared['extras_require']['all']):
        name, _, marker = one.partition(';')
        if not marker or f'"{machine}"' not in marker:  # pip looks at the marker of this machine
            wanted.append(name)
    assert len(wanted) > 10
    assert not resolved(*wanted, platforms=tuple(PLATFORMS[machine]))


def test_what_is_left_out_on_a_robot_has_no_wheel_there(declared: dict[str, Any]) -> None:
    for one in declared['extras_require']['all']:
        name, _, marker = one.partition(';')
        if marker:
            said = resolved(name, '--no-deps', platforms=tuple(PLATFORMS['aarch64']))
            assert 'No matching distribution' in said
