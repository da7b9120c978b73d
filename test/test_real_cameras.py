"""The commands of the page on real cameras; skipped where their frames are not."""

import json
from pathlib import Path
import re
import shlex
import subprocess
import sys

from flexx2_sim_ros.cli.main import main
import pytest
from real_frames import DATA

PAGE = Path(__file__).parent.parent / 'docs' / 'benchmark.md'


def blocks(title, language):
    """Return the code of a section of the page."""
    section = PAGE.read_text(encoding='utf-8').split(f'## {title}')[1].split('\n## ')[0]
    return re.findall(rf'```{language}\n(.*?)```', section, re.DOTALL)


def need(data):
    """Skip the test where a file of frames is not there."""
    if not (DATA / data).is_file():
        pytest.skip(f'{DATA / data} is not there')


def run_section(title):
    """Run the commands of a section in the current folder."""
    for command in ''.join(blocks(title, 'bash')).splitlines():
        program, *words = shlex.split(command.replace('../shared/data', str(DATA)))
        if program == 'mkdir':
            Path(*words).mkdir()
        else:
            alone = ['--jobs', '1'] if words[0] == 'gap' else []
            assert main([*words, *alone]) == 0, command


def test_the_latency_of_a_drones_sensor_is_found(tmp_path, monkeypatch):
    need('vl53l5cx_flights.npz')
    monkeypatch.chdir(tmp_path)
    (profile,) = blocks('VL53L5CX', 'yaml')
    Path('vl53l5cx.yaml').write_text(profile)
    run_section('VL53L5CX')
    table = json.loads(Path('flights_diagnosis/diagnosis.json').read_text())
    effects = {row['name']: row['parameters'] for row in table['effects']}
    # 80 to 115 ms by the smallest residual of each flight: the middle, to 20 %.
    assert effects['time_offset']['latency'] == pytest.approx(0.0975, rel=0.2)


def test_boards_seen_by_a_kinect_are_filtered(tmp_path, monkeypatch):
    need('kinect2_chessboard.npz')
    monkeypatch.chdir(tmp_path)
    (planes,) = blocks('Kinect v2', 'yaml')
    Path('boards.yaml').write_text(planes)
    (program,) = blocks('Kinect v2', 'python')
    program = program.replace('../shared/data', str(DATA))
    subprocess.run([sys.executable, '-c', program], check=True)
    run_section('Kinect v2')
    table = json.loads(Path('boards_diagnosis/diagnosis.json').read_text())
    effects = {row['name']: row['parameters'] for row in table['effects']}
    assert table['verdict'] == 'partly'
    # Correlations of neighbours are 0.64 to 0.68.
    assert 'spatial_filter' in effects
    # Its depth comes in whole millimetres, which hardly change what it measures.
    if 'quantisation' in effects:
        assert effects['quantisation']['step'] == pytest.approx(0.001, rel=0.1)
    # What loses pixels is light beyond the full well: dark squares have all of theirs.
    assert 'low_signal_dropout' not in effects
    # The pose of a free plane is fitted to it.
    assert 'pose_error' not in {*effects, *(row['name'] for row in table['alternatives'])}
    low, high = table['gap']['interval']
    assert low <= table['gap']['shrink'] <= high
    assert table['gap']['shrink'] > 0.1
    # Nothing was measured of the boards.
    assert 'offset' in {row['name'] for row in table['not_decidable']}
    (board,) = blocks('What the gap of the Kinect', 'python')
    Path('board.py').write_text(board)
    run_section('What the gap of the Kinect')
    table = json.loads(Path('boards_cost/cost.json').read_text())
    assert table['ranking'][0]['effect'] == 'amplitude_bias'
    (distance, _) = table['consumers'][0]['measures']
    # Dark squares measure farther than white ones.
    assert distance['effects']['amplitude_bias']['share'] > 0.2
