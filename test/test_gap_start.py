"""`flexx2 gap start`: questions, and the commands that it prints and runs."""

import io
from pathlib import Path
import shlex
import shutil
import subprocess

from flexx2_sim_ros.cli.main import main
from made_images import folder_of
import numpy as np
import pytest
from real_frames import DATA
import yaml

BOARD = DATA.parent / 'cases' / 'real' / 'k2_board_strip'
NAMES = ['v1.png', 'v2.png', 'v3.png']


@pytest.fixture
def ran(monkeypatch, tmp_path):
    """Keep the commands in place of running them, except for conversions."""
    monkeypatch.chdir(tmp_path)
    commands = []

    def keep(words, check):
        commands.append(shlex.join(words[3:]))
        status = main(words[3:]) if words[3] == 'convert' else 0
        return subprocess.CompletedProcess(words, status)

    monkeypatch.setattr(subprocess, 'run', keep)
    return commands


def start(monkeypatch, answers, *options):
    monkeypatch.setattr('sys.stdin', io.StringIO(answers))
    return main(['gap', 'start', *options])


def test_piped_answers_lead_from_images_to_a_diagnosis(ran, monkeypatch, capsys):
    folder_of(Path('images'), NAMES)
    answers = 'images\nkinect_v2\n\nplanes\n\n'
    assert start(monkeypatch, answers) == 0
    camera = '--profile kinect_v2'
    convert = f'convert images gap/recordings --views --usecase depth_30fps {camera}'
    assert ran == [convert]
    said = capsys.readouterr().err
    assert f'$ flexx2 {convert}' in said
    assert 'planes.yaml: fill in what you measured, and run this command again' in said
    form = Path('gap/planes.yaml')
    blank = {'plane 1': {'distance': '___', 'box': '___'}}
    assert yaml.safe_load(form.read_text())['recordings'] == dict.fromkeys(
        ('v1', 'v2', 'v3'), blank
    )
    ran.clear()
    assert start(monkeypatch, answers) == 0
    assert ran == [
        convert,
        f'gap truth gap/recordings --planes gap/planes.yaml --out gap/campaign {camera}',
        f'gap diagnose gap/campaign --out gap/diagnosis {camera}',
    ]


def test_recordings_that_have_ground_truth_need_none(ran, monkeypatch):
    Path('known').mkdir()
    np.savez('known/a.npz', depth=np.ones((2, 8, 8)), clean_depth=np.ones((2, 8, 8)))
    assert start(monkeypatch, 'known\n\n\n') == 0
    assert ran == ['gap diagnose known --out gap/diagnosis --profile flexx2']


def test_options_leave_no_question(ran, monkeypatch):
    Path('bags').mkdir()
    more = '--trajectory poses.txt --clock-offset 0'
    options = '--profile', '', '--scan', 'a b.ply', '--out', 'o', '--options', more
    assert start(monkeypatch, '', 'bags', *options) == 0
    assert ran == [
        f"gap truth bags --scan 'a b.ply' --out o/campaign {more}",
        'gap diagnose o/campaign --out o/diagnosis',
    ]
    ran.clear()
    assert start(monkeypatch, '', 'bags', '--profile', '', '--none', '--out', 'o') == 0
    assert ran == ['gap diagnose bags --out o/diagnosis']


@pytest.mark.parametrize(
    ('answers', 'options', 'said'),
    [
        ('', [], 'answer: must not be empty: Where are the recordings'),
        ('nowhere\n', [], 'RECORDINGS: must be a folder, got nowhere'),
        ('.\n\nfloor\n', [], 'ground truth: must be one of planes, board, scan, scene, none, got'),
        ('.\n', ['--options', "'"], '--options: must be options, got'),
        ('.\n\nscan\n', [], 'answer: must not be empty: Where is the file?'),
    ],
)
def test_a_wrong_answer_is_one_sentence(answers, options, said, ran, monkeypatch, capsys):
    np.savez('a.npz', depth=np.ones((2, 8, 8)))
    assert start(monkeypatch, answers, *options) == 2
    assert said in capsys.readouterr().err
    assert ran == []


def test_the_owner_of_a_kinect_types_one_command(monkeypatch, tmp_path):
    if not BOARD.is_dir():
        pytest.skip(f'{BOARD} is not there')
    shutil.copytree(BOARD, tmp_path / 'k2', copy_function=shutil.copyfile)
    monkeypatch.chdir(tmp_path)
    options = 'k2', '--profile', 'kinect_v2', '--planes', 'k2/board.yaml'
    assert start(monkeypatch, '\n', *options) == 0
    (row,) = yaml.safe_load(Path('gap/campaign/truth.yaml').read_text())['recordings']
    assert (row['name'], row['verdict']) == ('v0001.npz', 'used')
    assert Path('gap/diagnosis/report.html').is_file()
