"""`flexx2 compile`, and what a first diagnosis and a first node say that have to compile."""

import os

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.camera.compiling import compiling_said
from flexx2_sim_ros.cli.main import main
from numba import njit
from programs import flexx2_words, node_words, ROOT, run_python, started
import pytest

SAID = 'compiling: takes a minute or two, once (flexx2 compile does it ahead)'
# Runs the command with the loops that this checkout keeps, and says which ones it looks for.
LOOKING = """
import sys
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.physics import kept

class Cache(kept._Cache):
    def load_overload(self, sig, context):
        print('looks for', self._py_func.__qualname__, *sig)
        return super().load_overload(sig, context)

kept._Cache = Cache
sys.exit(main(sys.argv[1:]))
"""


def with_cache(env, cache):
    return {**env, 'NUMBA_CACHE_DIR': str(cache)}


def looked_for(*words):
    """Return the loops that the command looks for, and what it said."""
    done = run_python('-c', LOOKING, *words, cwd=ROOT, timeout=600)
    assert done.returncode == 0, done.stderr
    loops = {line for line in done.stdout.splitlines() if line.startswith('looks for')}
    return loops, done.stdout + done.stderr


@pytest.fixture(scope='module')
def compiled():
    """Return the loops of `flexx2 compile`; from now on this checkout keeps them."""
    return looked_for('compile')[0]


def test_a_compilation_is_said_once():
    said = []
    with compiling_said(lambda: said.append('compiling')):
        assert not said
        for step in (1, 2):
            njit(lambda x, step=step: x + step)(1)
    assert said == ['compiling']


def test_a_diagnosis_needs_what_the_command_compiles(compiled, tmp_path):
    """Assert a first diagnosis says that it compiles, one after `flexx2 compile` does not."""
    effects = {'wiggling': {}, 'flying_pixels': {}}
    recordings = tmp_path / 'recordings'
    write_campaign(recordings, seed=3, effects=effects, scale=0.25, recordings=3, frames=6)
    diagnose = ['gap', 'diagnose', str(recordings), '--jobs', '1', '--out']
    needed, said = looked_for(*diagnose, str(tmp_path / 'two'))
    assert len(needed) > 40
    assert needed <= compiled
    assert SAID not in said
    words, env = (
        flexx2_words(*diagnose, tmp_path / 'one'),
        with_cache(os.environ, tmp_path / 'none'),
    )
    with started(words, cwd=ROOT, env=env) as process:
        assert any(SAID in line for line in process.stderr)


def test_the_command_says_whether_it_compiled(monkeypatch, capsys):
    """Assert it of one small loop; test_package.py compiles the camera with `colcon build`."""
    loop = njit(lambda x: x + 1)
    monkeypatch.setattr('flexx2_sim_ros.cli.compiling.warm_up', lambda *of_camera: loop(1))
    assert main(['compile', '--no-effects']) == 0
    assert capsys.readouterr().out.startswith('compiling ...\ncompiled in ')
    assert main(['compile', '--no-effects']) == 0
    assert capsys.readouterr().out == 'everything was compiled before\n'


def test_a_node_says_that_it_compiles(compiled, child_env, tmp_path):
    words = node_words('flexx2_camera', '-r', '__ns:=/fresh')
    said = until(words, 'compiling the camera model', with_cache(child_env, tmp_path))
    assert 'waiting for' not in said
    assert 'compiling' not in until(words, 'waiting for', child_env)


def until(words, wanted, env):
    """Return what a node says until it says what is wanted."""
    said = ''
    with started(words, env=env) as process:
        for line in process.stderr:
            said += line
            if wanted in line:
                return said
    raise AssertionError(said)
