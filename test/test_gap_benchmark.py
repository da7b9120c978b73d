"""The check on withheld effects, as a user runs it, on a few small cases."""

import json

from flexx2_sim_ros.cli.main import main
from study.benchmark import score


def test_the_quick_benchmark_reaches_its_floors(tmp_path, capsys):
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
    assert sum(answer.right for answer in scores.of('single')) >= 5
    assert sum(answer.wrong for answer in scores.of('single')) <= 1
    assert sum(answer.right for answer in scores.of('none')) >= 1
    assert sum(answer.right for answer in scores.of('novel')) >= 1
    assert scores.of('pair')[0].right
    realised = [a for a in scores.answers if a.realised == a.realised]
    assert all(abs(a.predicted - a.realised) < 0.3 for a in realised)
    assert sum(a.overlap for a in scores.of('single')) / 7 > 0.35
