"""Checksums: a flipped bit is an error or a note, and never other values."""

from pathlib import Path
import shutil
import sqlite3
import zipfile

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from made_bags import COUNT, depths, driver_bag, every_kind, unlike
import numpy as np
import pytest

FLIPS = 60
KINDS = ('mcap', 'db3', 'folder', 'stored', 'deflated')


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Write the same recording in every way."""
    return every_kind(tmp_path_factory.mktemp('whole'))


@pytest.mark.parametrize('kind', KINDS)
def test_flipped_bits_are_detected(kind, whole, tmp_path):
    source = load_recording(whole[kind])
    assert source.notes == ()
    target = tmp_path / whole[kind].name
    rng = np.random.default_rng(5)
    seen = 0
    for index in range(FLIPS):
        if whole[kind].is_dir():
            shutil.copytree(whole[kind], target, dirs_exist_ok=True)
            # Half of the flips go to metadata.yaml.
            file = sorted(target.iterdir())[index % 2]
        else:
            file = shutil.copyfile(whole[kind], target)
        data = bytearray(file.read_bytes())
        at = int(rng.integers(len(data)))
        # The first and last kilobytes hold the structure: a third of the flips go there.
        at = (at, at % 2048, len(data) - 1 - at % 2048)[int(rng.integers(3))] % len(data)
        data[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(data)
        try:
            found = load_recording(target)
        except InputError:
            seen += 1
            continue
        damage = [note for note in found.notes if 'damaged' in note or 'not whole' in note]
        seen += bool(damage)
        assert damage or not unlike(found, source), (file.name, at, unlike(found, source))
    assert seen > FLIPS / 6


def test_a_message_of_a_wrong_checksum_is_left_out(whole, tmp_path):
    path = Path(shutil.copyfile(whole['db3'], tmp_path / 'one.db3'))
    with sqlite3.connect(path) as connection:
        last = connection.execute(
            'SELECT max(messages.id) FROM messages JOIN topics ON topics.id = topic_id '
            "WHERE name LIKE '%depth_image_0'"
        ).fetchone()[0]
        connection.execute('UPDATE messages SET timestamp = timestamp + 1 WHERE id = ?', (last,))
    connection.close()
    recording = load_recording(path)
    assert len(recording.depth) == COUNT - 1
    assert any('the checksums of 1 messages are wrong' in note for note in recording.notes)


def test_a_removed_message_is_reported(whole, tmp_path):
    path = Path(shutil.copyfile(whole['db3'], tmp_path / 'one.db3'))
    with sqlite3.connect(path) as connection:
        connection.execute('DELETE FROM messages WHERE id = (SELECT max(id) FROM messages)')
    connection.close()
    assert any('1 messages are missing' in note for note in load_recording(path).notes)


def test_an_array_is_read_to_its_checksum(whole, tmp_path):
    # A shape of fewer frames: all that it asks for is there, and the rest has the checksum.
    path = tmp_path / 'short.npz'
    with zipfile.ZipFile(whole['stored']) as old, zipfile.ZipFile(path, 'w') as new:
        for name in old.namelist():
            new.writestr(
                name, old.read(name).replace(b'(12, ', b'(11, ').replace(b'(12,)', b'(11,)')
            )
    with pytest.raises(InputError, match=f'{path}: .*shape'):
        load_recording(path)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_without_checksums_is_reported(storage, tmp_path):
    bag = driver_bag(tmp_path / 'bag', depths(2, 43, 56), storage)
    assert [note for note in load_recording(bag).notes if 'no checksums' in note]
