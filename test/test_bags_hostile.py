"""Bags whose files are whole and whose content lies: an error that names it, or all else read."""

import io
import os
import sqlite3

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_messages import BYTES, encode_bytes
from flexx2_sim_ros.recording.convert import convert
from made_bags import (
    depths,
    DRIVER,
    driver_cloud,
    driver_entries,
    EPOCH,
    IMAGE,
    info,
    PLUGINS,
    same,
    TYPES,
    write,
)
import numpy as np
import pytest
from rosbags.rosbag2 import Writer

COUNT = 3
DEPTH = depths(COUNT, 6, 8)
CARRIED = '/recording'


def npy(array):
    """Return an array as a file."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def header(shape, descr='|u1'):
    """Return the header of an array's file."""
    text = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b'\x93NUMPY\x01\x00' + len(text).to_bytes(2, 'little') + text


def write_raw(path, first):
    """Write the driver's bag with other messages, given as bytes, before its own."""
    with Writer(path, version=9, storage_plugin=PLUGINS['mcap']) as writer:
        connections = {}
        rows = [(topic, kind, EPOCH, data) for topic, kind, data in first]
        rows += [
            (topic, kind, time, bytes(TYPES.serialize_cdr(message, kind)))
            for topic, kind, time, message in driver_entries(DEPTH)[1:]
        ]
        for topic, kind, time, data in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], time, data)
    return path


@pytest.mark.parametrize(('offset', 'step'), [(16, 16), (14, 16), (100_000, 16), (0, 0)])
def test_a_cloud_whose_depth_is_outside_of_its_points(tmp_path, offset, step):
    entry = driver_cloud(f'{DRIVER}/point_cloud_0', EPOCH, DEPTH[0])
    cloud = entry[3]
    for field in cloud.fields:
        field.offset = offset
    cloud.point_step = step
    cloud.data = cloud.data[: step * DEPTH[0].size]
    bag = write(tmp_path / 'bag', [info(f'{DRIVER}/camera_info', EPOCH, (6, 8)), entry])
    with pytest.raises(InputError, match='fields: z must end within the point_step'):
        load_recording(bag)


@pytest.mark.parametrize(
    ('key', 'content', 'said'),
    [
        ('x', header('(1000000000000,)'), 'x: cannot be read as a plain array'),
        ('x', header('(' * 3000 + ')' * 3000), 'x: cannot be read as a plain array'),
        ('x', b'PK\x03\x04 another kind of file', 'x: cannot be read as a plain array'),
        ('usecase', header('()', '<U1') + b'\xff\xff\xff\x7f', 'usecase: cannot be read'),
        ('stamp', npy(np.float64(3)), r'stamp: must be finite numbers \(T,\)'),
        ('depth', npy(DEPTH), 'depth: must be the images of '),
    ],
    ids=['huge', 'deep', 'archive', 'text', 'one stamp', 'depth'],
)
def test_an_array_longer_than_its_message_is_refused(tmp_path, key, content, said):
    arrays = {'depth': b'', 'K': npy(np.eye(3)), 'stamp': npy(np.arange(3.0)), key: content}
    bag = write_raw(
        tmp_path / 'bag', [(CARRIED, BYTES, encode_bytes(*item)) for item in arrays.items()]
    )
    with pytest.raises(InputError, match=said) as error:
        load_recording(bag)
    assert str(bag) in str(error.value)
    assert len(str(error.value)) < 600


def test_a_broken_image_of_another_topic_is_noted(tmp_path):
    bag = write_raw(tmp_path / 'bag', 2 * [('/other/image', IMAGE, b'\0\1\0\0abc')])
    recording = load_recording(bag)
    assert same(recording.depth, DEPTH)
    assert sum('/other/image: cannot be decoded' in note for note in recording.notes) == 1


@pytest.mark.parametrize('make', [os.mkfifo, os.mkdir])
def test_pipes_and_folders_in_place_of_files_are_refused(tmp_path, make):
    make(tmp_path / 'a.mcap')
    with pytest.raises(InputError, match='a.mcap: must be a file, got something else'):
        load_recording(tmp_path)


ENDLESS = """
    ALTER TABLE messages RENAME TO other;
    CREATE VIEW messages AS WITH RECURSIVE row(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM row)
        SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM row;
"""


@pytest.mark.parametrize(
    ('change', 'frames'),
    [
        ("UPDATE topics SET name = x'00ff' WHERE id = 1", 0),
        ("UPDATE messages SET timestamp = 'abc' WHERE id = 9", 1),
        ('UPDATE messages SET data = 5000000000 WHERE id = 9', 1),
        (ENDLESS, 0),
    ],
    ids=['topic', 'time', 'data', 'endless'],
)
@pytest.mark.parametrize('cut', [False, True])
def test_values_that_sqlite_does_not_check(tmp_path, change, frames, cut):
    path = write(tmp_path / 'bag', driver_entries(DEPTH)[1:], 'sqlite3') / 'bag.db3'
    connection = sqlite3.connect(path)
    connection.executescript(change)
    connection.close()
    if cut:
        with path.open('ab') as file:
            file.write(bytes(100))
    if not frames:
        with pytest.raises(InputError, match='no complete message'):
            load_recording(path)
        return
    recording = load_recording(path)
    assert same(recording.depth, DEPTH[: len(recording.depth)])
    assert frames <= len(recording.depth) < COUNT
    assert any('cut off or damaged' in note for note in recording.notes)


def test_two_cameras_of_one_file_name_are_refused(tmp_path):
    entries = [
        entry
        for number, node in enumerate(('/front/left/flexx2_camera', '/front_left/flexx2_camera'))
        for entry in driver_entries(DEPTH + number, node)[1:]
    ]
    bag = write(tmp_path / 'bag', sorted(entries, key=lambda entry: entry[2]))
    with pytest.raises(InputError, match='--camera: must be one of front/left, front_left'):
        convert(bag, tmp_path / 'out.npz')
    assert not list(tmp_path.glob('out*'))
    convert(bag, tmp_path / 'out.npz', 'front/left')
    assert same(load_recording(tmp_path / 'out.npz').depth, DEPTH)
