"""The check on withheld effects, as a user runs it, on a few small cases."""

from dataclasses import replace
import json

from campaigns import all_but
from flexx2_sim_ros.cli.main import main
import pytest
from study.benchmark import make_design, score

# What a filter over frames is taken for.
RIVALS = 'excess_noise', 'heavy_tails', 'motion_artefact', 'spatial_filter', 'pose_error'


def few(*how):
    """
    Return the first quick case of each kind: only they are realised and have baselines.

    The single effect is looked for among those that it is taken for, and no effect among all.
    """
    cases = {planned.group: planned for planned in reversed(make_design(*how))}
    single, none = cases['single'], cases['none']
    return [replace(single, without=tuple(all_but(*RIVALS, *single.effects))), none]


def test_the_quick_benchmark_is_right(tmp_path, monkeypatch, capsys):
    """Assert it of a single effect and none; test_gap_diagnosis.py has a pair and a novel one."""
    monkeypatch.setattr('study.benchmark.runner.make_design', few)
    # In this process: two would each compile the blind camera and the diagnosis.
    assert main(['gap', 'benchmark', '--quick', '--out', str(tmp_path), '--jobs', '1']) == 0
    assert 'single effects, strength 1: correct' in capsys.readouterr().out
    assert (tmp_path / 'benchmark.md').is_file()
    assert (tmp_path / 'benchmark_confusion.png').is_file()
    for path in (tmp_path / 'results').iterdir():
        assert json.loads(path.read_text())['error'] is None
    scores = score(tmp_path)
    # The seeds are the same in every run.
    assert [answer.right for answer in scores.answers] == [True] * 2
    (single,) = scores.of('single')
    assert single.predicted == pytest.approx(single.realised, abs=0.3)
    assert single.overlap > 0.35
