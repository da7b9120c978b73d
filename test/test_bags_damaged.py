"""What is left of a damaged recording: whole first frames and a note, or a clear error."""

import os
import shutil
import sqlite3
import subprocess
import sys
import zipfile

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, open_recording
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.recording.reader import uptime_of
from flexx2_sim_ros.recording.truth import read_truth
from made_bags import (
    COUNT,
    depths,
    driver_bag,
    driver_entries,
    EPOCH,
    every_kind,
    MATRIX,
    same,
    SECOND,
    unlike,
    write,
)
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode

FLIPS = 60
KINDS = ('mcap', 'db3', 'folder', 'stored', 'deflated')


def change(path, statement):
    """Change a bag as one that knows nothing of its checksums."""
    with sqlite3.connect(path) as connection:
        connection.execute(statement)
    connection.close()


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Write bags of 12 frames: 70 kB each with its cloud, two or three chunks in MCAP."""
    folder = tmp_path_factory.mktemp('whole')
    depth = depths(COUNT, 86, 112)
    return {
        'mcap': driver_bag(folder / 'm', depth) / 'm.mcap',
        'zstd': driver_bag(folder / 'z', depth, compression=CompressionMode.STORAGE) / 'z.mcap',
        'sqlite3': driver_bag(folder / 's', depth, 'sqlite3') / 's.db3',
    }


def attempt(path):
    """Return a recording, or None where there is a clear error."""
    try:
        return load_recording(path)
    except InputError as error:
        text = str(error)
    assert str(path) in text
    return None


def check_prefix(path):
    """Return how many frames of a bag there are, which have to be the first ones, and notes."""
    recording = attempt(path)
    if recording is None:
        return 0, ''
    count = len(recording.depth)
    assert count
    assert same(recording.depth, depths(COUNT, 86, 112)[:count])
    assert recording.stamp_ns.tolist() == [EPOCH + i * 22_222_000 for i in range(count)]
    assert same(recording.K, MATRIX)
    return count, '\n'.join(recording.notes)


@pytest.mark.parametrize('kind', ['mcap', 'zstd', 'sqlite3'])
def test_cut_off_anywhere(kind, whole, tmp_path):
    data = whole[kind].read_bytes()
    size = len(data)
    starts = 0, 1, 7, 8, 9, 60, 99, 100, 511, 4095, 4096, 4097
    ends = (size - left for left in (4097, 100, 37, 8, 1))
    cuts = sorted({*starts, *ends, *np.linspace(0, size - 1, 4 * COUNT).astype(int).tolist()})
    counts = []
    for cut in cuts:
        path = tmp_path / f'{cut}{whole[kind].suffix}'
        path.write_bytes(data[:cut])
        count, notes = check_prefix(path)
        counts.append(count)
        assert not count or 'cut off' in notes
        assert not count or 'messages over' in notes
        assert not path.with_name(path.name + '-journal').exists()
        assert path.read_bytes() == data[:cut], 'the bag is left as it is'
    assert counts == sorted(counts), 'more of the file is more frames'
    if kind == 'mcap':  # Frames of a chunk that was being written count.
        assert counts[-1] == COUNT
        assert len(set(counts)) == COUNT + 1
    else:
        assert counts[-1] >= COUNT - 3


@pytest.mark.parametrize(
    ('storage', 'metadata'),
    [('mcap', 'missing'), ('sqlite3', 'missing'), ('mcap', 'cut'), ('sqlite3', 'nonsense')],
)
def test_without_metadata(storage, metadata, tmp_path):
    bag = driver_bag(tmp_path / 'bag', depths(COUNT, 86, 112), storage)
    file = bag / 'metadata.yaml'
    text = file.read_text()
    file.write_text({'missing': '', 'cut': text[:200], 'nonsense': '\x00:[1'}[metadata])
    if metadata == 'missing':
        file.unlink()
    count, notes = check_prefix(bag)
    assert count == COUNT
    assert str(bag) in notes


def test_split_bag_without_metadata(tmp_path):
    depth = depths(COUNT, 86, 112)
    entries = driver_entries(depth)
    folder = tmp_path / 'bag'
    folder.mkdir()
    for number in range(COUNT):  # bag_10 comes after bag_9
        rows = [entries[0], *entries[1 + 5 * number : 6 + 5 * number]]
        part = write(tmp_path / f'part_{number}', rows)
        (part / f'part_{number}.mcap').rename(folder / f'bag_{number}.mcap')
    last = folder / f'bag_{COUNT - 1}.mcap'
    last.write_bytes(last.read_bytes()[:-40])
    assert check_prefix(folder)[0] == COUNT


WRITER_THAT_DIES = """
import os, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute('PRAGMA journal_mode=' + sys.argv[2])
connection.execute('PRAGMA cache_size=5')
connection.execute('PRAGMA synchronous=OFF')
rows = connection.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY id').fetchall()
connection.execute('BEGIN')
connection.execute('DELETE FROM messages')
connection.executemany('INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)', {rows})
{end}
os._exit(9)
"""


@pytest.mark.parametrize(
    ('journal', 'suffix', 'end', 'frames'),
    [
        ('DELETE', '-journal', '', COUNT),  # what was not committed is taken back
        ('WAL', '-wal', 'connection.execute("COMMIT")', 7),
    ],
)  # and what was committed is there
def test_a_bag_of_a_killed_writer_is_read(journal, suffix, end, frames, whole, tmp_path):
    path = tmp_path / 'bag.db3'
    path.write_bytes(whole['sqlite3'].read_bytes())
    program = WRITER_THAT_DIES.format(rows='rows[:1 + 5 * 7]', end=end)
    done = subprocess.run([sys.executable, '-c', program, path, journal], check=False)
    assert done.returncode == 9
    left = path.with_name(path.name + suffix)
    before = path.read_bytes(), left.read_bytes()
    assert before[1]
    count, notes = check_prefix(path)
    assert count == frames
    assert 'journal' in notes
    assert (path.read_bytes(), left.read_bytes()) == before, 'the bag is left as it is'


def test_arrays_of_a_cut_off_bag_fit_the_frames_that_are_left(tmp_path):
    depth = depths(COUNT, 86, 112)
    each = {
        'stamp': np.arange(COUNT) / 8,
        'received': np.arange(COUNT) / 8 + 0.5,
        'uptime': np.arange(COUNT) / 8 + 60,
        'known': depth > 1,
        'clean_sigma': depth / 1000,
        'incidence': depth / 5,
        'reflectivity_spread': depth / 10,
        'reflectivity': depth.astype('f8') / 10,  # No image: it is an array as well.
    }
    common = {'clean_depth': depth[0] + 1, 'plane': np.zeros((86, 112), np.uint8), 'K': MATRIX}
    common |= {'plane_covariance': np.zeros((0, 0)), 'curve': np.arange(COUNT)}
    np.savez(tmp_path / 'in.npz', depth=depth, **each, **common)
    path = tmp_path / 'cut.mcap'
    convert(tmp_path / 'in.npz', path)
    os.truncate(path, path.stat().st_size * 9 // 10)
    reader = open_recording(path)
    count = len(reader.stamp)
    assert 0 < count < COUNT
    for key, array in each.items():
        assert same(reader.arrays[key], array[:count]), key
    for key, array in common.items():
        assert same(reader.arrays[key], array), key
    uptime = uptime_of(reader)
    assert uptime is not None
    assert len(uptime) == count
    assert same(read_truth(path, reader.arrays, reader.shape).known, each['known'][:count])


@pytest.mark.parametrize('key', ['stamp', 'stamp_ns'])
def test_arrays_stay_with_their_frames_where_one_in_the_middle_is_lost(key, tmp_path):
    depth = depths(COUNT, 9, 7)
    # The simulation was reset on the way.
    stamps = np.arange(COUNT) % 8 * SECOND // 8
    each = {key: stamps if key == 'stamp_ns' else stamps / 1e9, 'uptime': np.arange(COUNT) / 8}
    each['known'] = depth > 1
    np.savez(tmp_path / 'in.npz', depth=depth, K=MATRIX, clean_depth=depth + 1, **each)
    path = tmp_path / 'bag.db3'
    convert(tmp_path / 'in.npz', path)
    # As by a flipped bit: their checksums are wrong then.
    change(
        path,
        'UPDATE messages SET timestamp = timestamp + 1 WHERE id IN (SELECT messages.id FROM '
        'messages JOIN topics ON topics.id = topic_id WHERE name LIKE "%depth_image_0" '
        'ORDER BY messages.id LIMIT 2 OFFSET 3)',
    )
    left = [0, 1, 2, *range(5, COUNT)]
    recording = load_recording(path)
    assert same(recording.depth, depth[left])
    assert recording.stamp_ns.tolist() == stamps[left].tolist()
    assert same(recording.clean_depth, depth[left] + 1)
    for name in ('uptime', 'known'):
        assert same(recording.extra[name], each[name][left]), name


@pytest.fixture(scope='module')
def every(tmp_path_factory):
    """Write the same recording in every way."""
    return every_kind(tmp_path_factory.mktemp('every'))


@pytest.mark.parametrize('kind', KINDS)
def test_flipped_bits_are_detected(kind, every, tmp_path):
    source = load_recording(every[kind])
    assert source.notes == ()
    target = tmp_path / every[kind].name
    rng = np.random.default_rng(5)
    seen = 0
    for index in range(FLIPS):
        if every[kind].is_dir():
            shutil.copytree(every[kind], target, dirs_exist_ok=True)
            # Half of the flips go to metadata.yaml.
            file = sorted(target.iterdir())[index % 2]
        else:
            file = shutil.copyfile(every[kind], target)
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


def test_a_message_of_a_wrong_checksum_is_left_out(every, tmp_path):
    path = shutil.copyfile(every['db3'], tmp_path / 'one.db3')
    change(
        path,
        'UPDATE messages SET timestamp = timestamp + 1 WHERE id = (SELECT max(messages.id) FROM '
        "messages JOIN topics ON topics.id = topic_id WHERE name LIKE '%depth_image_0')",
    )
    recording = load_recording(path)
    assert len(recording.depth) == COUNT - 1
    assert any('the checksums of 1 messages are wrong' in note for note in recording.notes)


def test_a_removed_message_is_reported(every, tmp_path):
    path = shutil.copyfile(every['db3'], tmp_path / 'one.db3')
    change(path, 'DELETE FROM messages WHERE id = (SELECT max(id) FROM messages)')
    assert any('1 messages are missing' in note for note in load_recording(path).notes)


def test_an_array_is_read_to_its_checksum(every, tmp_path):
    # A shape of fewer frames: all that it asks for is there, and the rest has the checksum.
    path = tmp_path / 'short.npz'
    with zipfile.ZipFile(every['stored']) as old, zipfile.ZipFile(path, 'w') as new:
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
