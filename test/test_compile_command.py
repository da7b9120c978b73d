"""`flexx2 compile`, and what a first diagnosis says that has to compile."""

import os

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.camera.compiling import compiling_said
from numba import njit
from programs import flexx2_words, ROOT, started

SAID = 'compiling: takes a minute or two, once (flexx2 compile does it ahead)'


def test_a_compilation_is_said_once():
    said = []
    with compiling_said(lambda: said.append('compiling')):
        assert not said
        for step in (1, 2):
            njit(lambda x, step=step: x + step)(1)
    assert said == ['compiling']


def test_a_diagnosis_compiles_what_the_command_compiles(tmp_path):
    """Assert the first diagnosis says so once, and one after `flexx2 compile` does not."""
    effects = {'wiggling': {}, 'flying_pixels': {}}
    recordings = tmp_path / 'recordings'
    write_campaign(recordings, seed=3, effects=effects, scale=0.25, recordings=3, frames=6)

    def command(*words, cache):
        env = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / cache)}
        return started(flexx2_words(*words), cwd=ROOT, env=env)

    diagnose = ['gap', 'diagnose', str(recordings), '--out']
    with command(*diagnose, str(tmp_path / 'one'), cache='none') as process:
        assert any(SAID in line for line in process.stderr)
    with command('compile', cache='full') as process:
        assert 'error' not in process.communicate()[1]
    with command(*diagnose, str(tmp_path / 'two'), cache='full') as process:
        said = process.communicate()[1]
    assert process.returncode == 0, said
    assert SAID not in said
