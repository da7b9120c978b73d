"""The short form of the measurements of `bench`: each runs and prints figures."""

from pathlib import Path
import re
import runpy
import sys

from bench.journal import Journal
from programs import measured, run_python
import pytest

# `soak` and `torture_node` have tests of their own; `batch`, `gap` and `torture_files` take half a
# minute each.
SHORT = 'model', 'effects', 'exposure', 'agreement', 'bags', 'torture_kill'


def run(words, folder, env):
    """Run Python in a folder, where it leaves its files."""
    return run_python('-m', *words, cwd=folder, env=env)


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """Return a function that runs a measurement here, and returns what it prints."""

    def run_here(name, *words):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, 'argv', [name, *words])
        runpy.run_module(f'bench.{name}', run_name='__main__')
        return capsys.readouterr().out

    return run_here


def test_an_offset_is_found_with_ground_truth_that_a_tape_makes(printed):
    said = printed('owner', '--effects', 'offset', '--kinds', 'corners')
    assert re.search(r'^\| corners \| 1 \| 1 \| 1 \| 0 \|', said, re.M)


def test_measurements_run_for_a_moment(child_env, tmp_path):
    for library in ('warp', 'mujoco', 'rosbags'):
        pytest.importorskip(library)
    done = run(['bench', '--short', *SHORT], tmp_path, child_env)
    assert done.returncode == 0, done.stderr
    parts = done.stdout.split('\n== ')[1:]
    assert [part.partition('\n')[0] for part in parts] == list(SHORT)
    for part in parts:
        assert any(sign.isdigit() for sign in part.partition('\n')[2]), part
    assert (tmp_path / 'build' / 'torture' / 'kills.jsonl').is_file()


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['benchmark_answers'], 'slowest: '),
        (['mount', 'none'], '| `none` | '),
        (['absorbed', '--effects', 'offset', '--only', 'corners'], '| offset | 0.00 | 1.00 |'),
    ],
)
def test_a_measurement_with_options_of_its_own_prints_figures(words, said, printed):
    assert said in printed(*words)


def test_copied_noise_is_drawn_beside_that_of_the_camera(printed, tmp_path):
    for library in ('warp', 'matplotlib'):
        pytest.importorskip(library)
    table = printed('copied_noise', 'copied.png')
    page = Path(__file__).resolve().parents[1] / 'docs' / 'batch.md'
    assert table[table.index('| |') :] in page.read_text()
    assert (tmp_path / 'copied.png').read_bytes().startswith(b'\x89PNG')


def test_an_unknown_measurement_is_refused(child_env, tmp_path):
    done = run(['bench', 'modle'], tmp_path, child_env)
    assert done.returncode == 2
    assert 'NAME: must be of model, effects' in done.stderr


def test_an_interrupted_journal_resumes(tmp_path):
    path = tmp_path / 'runs' / 'files.jsonl'
    Journal(path, seed=1).add({'index': 0})
    with path.open('a') as file:
        file.write('{"index": 1, "outc')  # Killed in the middle of a line.
    again = Journal(path, seed=1)
    assert list(again) == [{'index': 0}]
    again.add({'index': 1})
    assert len(Journal(path, seed=1)) == 2


def test_two_cameras_report_every_lost_image(child_env, tmp_path):
    """Assert every image is received or counted as lost, and published or counted as dropped."""
    result = measured(
        f'bench.soak.run(minutes=0.1, seed=5, out=Path({str(tmp_path)!r}))', child_env
    )
    for name in ('left', 'right'):
        camera = result[name]
        assert camera['sent'] > 0, (tmp_path / f'{name}.log').read_text()
        assert camera['silent'] == 0
        assert camera['unaccounted'] == 0
        assert camera['read'] > 0
