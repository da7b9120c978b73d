"""The check on withheld effects, as a user runs it, on a few small cases."""

import json

from flexx2_sim_ros.cli.main import main
from study.benchmark import make_design, score


def test_the_quick_benchmark_reaches_its_floors(tmp_path, monkeypatch, capsys):
    """Assert it of every second case: four single effects, a pair, a novel one and none."""
    monkeypatch.setattr('study.benchmark.runner.make_design', lambda *how: make_design(*how)[::2])
    # In this process: two would each compile the blind camera and the diagnosis.
    assert main(['gap', 'benchmark', '--quick', '--out', str(tmp_path), '--jobs', '1']) == 0
    assert 'single effects, strength 1: correct' in capsys.readouterr().out
    assert (tmp_path / 'benchmark.md').is_file()
    assert (tmp_path / 'benchmark_confusion.png').is_file()
    for path in (tmp_path / 'results').iterdir():
        assert json.loads(path.read_text())['error'] is None
    scores = score(tmp_path)
    # Floors, below what is found: all seeds are the same in every run, but not every machine's
    # arithmetic.
    assert len(scores.of('single')) == 4
    assert sum(answer.right for answer in scores.of('single')) >= 3
    assert scores.of('none')[0].right
    assert scores.of('novel')[0].right
    assert scores.of('pair')[0].right
    realised = [a for a in scores.answers if a.realised == a.realised]
    assert all(abs(a.predicted - a.realised) < 0.3 for a in realised)
    assert sum(a.overlap for a in scores.of('single')) / 4 > 0.35
