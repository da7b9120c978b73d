"""Which recording would settle what a diagnosis leaves open."""

import json
from pathlib import Path
from typing import Any

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.planning.next_recording import information, suggest
import numpy as np
import pytest


def write_diagnosis(folder: Path, **changed: Any) -> Path:
    """Write what a diagnosis with alternatives writes."""
    table = {
        'schema': 1,
        'verdict': 'identified',
        'effects': [{'name': 'multipath', 'parameters': {'gain': 1.0}}],
        'alternatives': [],
        'not_decidable': [],
        'recordings': [],
        'settings': {'usecase': 'Mode_9_30fps', 'pose_prior': [0.01, 0.5], 'known': {}},
        **changed,
    }
    folder.mkdir()
    (folder / 'diagnosis.json').write_text(json.dumps(table))
    (folder / 'effects.yaml').write_text('schema: 1\neffects:\n  multipath: {}\n')
    return folder


def test_a_corner_tells_multipath_from_an_offset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = {'name': 'offset', 'parameters': {'bias': 0.005}, 'instead_of': ['multipath']}
    folder = write_diagnosis(tmp_path / 'diagnosis', alternatives=[other])
    assert main(['gap', 'next', str(folder), '--jobs', '1']) == 0
    table = json.loads((folder / 'next.json').read_text())
    assert list(table['explanations']) == ['multipath', 'offset', 'none of them']
    rows = table['ranking']
    assert rows[0]['scene'] == 'corner'
    assert 'multipath' in rows[0]['best_told_apart']
    bits = [row['bits'] for row in rows]
    assert bits == sorted(bits, reverse=True)
    assert max(bits) <= table['most_bits']
    # A frontal wall cannot show multipath: there is nothing that light bounces from.
    by_name = {row['scene']: np.array(row['separations']) for row in rows}
    assert by_name['wall_1m'][0, 2] < 0.1 * by_name['corner'][0, 2]
    assert 'corner' in capsys.readouterr().err


def test_a_diagnosis_that_leaves_nothing_open_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='must leave something open'):
        suggest(write_diagnosis(tmp_path / 'sure'))
    nothing = {'verdict': 'none', 'effects': []}
    with pytest.raises(InputError, match='must have alternatives'):
        suggest(write_diagnosis(tmp_path / 'none', **nothing))


def test_information_is_between_nothing_and_all() -> None:
    assert information(np.zeros((4, 4))) == 0
    apart = 1e4 * (1 - np.eye(4))
    assert information(apart) == pytest.approx(2.0)
    one_apart = np.where(np.add.outer(np.arange(4) == 0, np.arange(4) == 0), 1e4, 0)
    one_apart[0, 0] = 0
    assert 0 < information(one_apart) < 1
