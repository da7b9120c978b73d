"""`flexx2 compile`, and what a first diagnosis and a first node say that have to compile."""

import os

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.camera.compiling import compiling_said
from numba import njit
from programs import flexx2_words, node_words, ROOT, started
import pytest

SAID = 'compiling: takes a minute or two, once (flexx2 compile does it ahead)'


@pytest.fixture(scope='module')
def compiled(tmp_path_factory):
    """Return a cache that the command has filled."""
    cache = tmp_path_factory.mktemp('cache')
    with command('compile', cache=cache) as process:
        assert 'compiled in' in process.communicate()[0]
    return cache


def command(*words, cache):
    return started(flexx2_words(*words), cwd=ROOT, env=with_cache(os.environ, cache))


def with_cache(env, cache):
    return {**env, 'NUMBA_CACHE_DIR': str(cache)}


def test_a_compilation_is_said_once():
    said = []
    with compiling_said(lambda: said.append('compiling')):
        assert not said
        for step in (1, 2):
            njit(lambda x, step=step: x + step)(1)
    assert said == ['compiling']


def test_the_command_compiles_once(compiled):
    with command('compile', '--no-effects', cache=compiled) as process:
        assert process.communicate()[0] == 'everything was compiled before\n'


def test_a_diagnosis_compiles_what_the_command_compiles(compiled, tmp_path):
    """Assert the first diagnosis says so once, and one after `flexx2 compile` does not."""
    effects = {'wiggling': {}, 'flying_pixels': {}}
    recordings = tmp_path / 'recordings'
    write_campaign(recordings, seed=3, effects=effects, scale=0.25, recordings=3, frames=6)
    diagnose = ['gap', 'diagnose', str(recordings), '--out']
    with command(*diagnose, str(tmp_path / 'one'), cache=tmp_path / 'none') as process:
        assert any(SAID in line for line in process.stderr)
    with command(*diagnose, str(tmp_path / 'two'), cache=compiled) as process:
        said = process.communicate()[1]
    assert process.returncode == 0, said
    assert SAID not in said


@pytest.mark.parametrize('ahead', [False, True])
def test_a_node_says_that_it_compiles(ahead, compiled, child_env, tmp_path):
    words = node_words('flexx2_camera', '-r', '__ns:=/fresh')
    until = 'waiting for' if ahead else 'compiling the camera model'
    said = ''
    with started(words, env=with_cache(child_env, compiled if ahead else tmp_path)) as process:
        for line in process.stderr:
            said += line
            if until in line:
                break
    assert until in said
    assert ('compiling' if ahead else 'waiting for') not in said
