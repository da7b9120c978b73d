"""Terminal escapes in files are shown escaped: in errors, notes, tables and logs."""

import zipfile

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError, printable
from flexx2_sim_ros.recording import RecordingWriter
from made_bags import depths, image, info, make, write
import numpy as np
from programs import run_flexx2
import pytest

# Changes the title and the colour, goes up a line, and turns the direction of writing.
EVIL = '\x1b]0;owned\x07\x1b[31m\x1b[1A\x9b1m\u202e\r[red]'


def is_safe(text):
    """Say whether text has nothing that a terminal obeys."""
    return all(letter.isprintable() or letter in '\n\t' for letter in text)


def test_printable_text_stays_unchanged():
    assert printable('σ = 1 °\n\tüé 深度') == 'σ = 1 °\n\tüé 深度'
    assert is_safe(printable(EVIL))
    assert is_safe(str(InputError(EVIL + '\udc80')))


def test_convert_shows_escapes_escaped(tmp_path, capsys):
    path = tmp_path / 'evil.npz'
    with RecordingWriter(path, 1, 4, 5) as writer:
        writer.add_depth(depths(1, 4, 5))
        for key, value in {'K': np.eye(3), 'stamp': np.zeros(1), 'usecase': EVIL}.items():
            writer.add_array(key, value)
    assert main(['convert', str(path), str(tmp_path / 'out.npz')]) == 0
    with zipfile.ZipFile(path, 'a') as archive:
        archive.writestr(EVIL.replace('\r', ''), b'')
    assert main(['convert', str(path), str(tmp_path / 'out.npz')]) == 2
    text = capsys.readouterr().err
    assert is_safe(text)
    assert text.count(r'\x1b]0;owned\x07') == 2
    assert '[red]' in text, 'and it is no markup'


@pytest.mark.usefixtures('ros')
def test_replay_shows_names_in_bags_escaped(child_env, tmp_path):
    pixels = depths(1, 4, 5)[0]
    text = make('std_msgs/msg/String', EVIL)
    bag = write(
        tmp_path / 'bag',
        [
            image(f'/a{EVIL}/depth', 1, pixels),
            image(f'/a{EVIL}/other', 1, pixels),
            info(f'/a{EVIL}/camera_info', 1, (4, 5)),
            (f'/b{EVIL}', 'std_msgs/msg/String', 1, text),
            ('/c', 'std_msgs/msg/String', 1, text),
        ],
    )
    done = run_flexx2('replay', bag, '--wait', '0', env=child_env, timeout=60, cwd=tmp_path)
    said = done.stdout + done.stderr
    assert 'Traceback' not in said
    assert r'\x1b]0;owned' in said
    # rclpy colours its log by itself.
    assert '\x1b]' not in said
    assert '\x9b' not in said
