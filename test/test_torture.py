"""The long measurements of `bench`, for a moment."""

from pathlib import Path

from bench.journal import Journal
from programs import measured


def test_an_interrupted_journal_resumes(tmp_path: Path) -> None:
    path = tmp_path / 'runs' / 'files.jsonl'
    Journal(path, seed=1).add({'index': 0})
    with path.open('a') as file:
        file.write('{"index": 1, "outc')  # Killed in the middle of a line.
    again = Journal(path, seed=1)
    assert list(again) == [{'index': 0}]
    again.add({'index': 1})
    assert len(Journal(path, seed=1)) == 2


def test_a_journal_of_other_settings_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / 'files.jsonl'
    Journal(path, seed=1).add({'index': 0})
    assert len(Journal(path, seed=2)) == 0


def test_two_cameras_report_every_lost_image(child_env: dict[str, str], tmp_path: Path) -> None:
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
