"""Depth as other programs write it: what means no depth, units, compressed images."""

import struct

from flexx2_sim_ros.recording import load_recording
from made_bags import header, image, info, make, MATRIX, write
from made_images import encoded as png
from made_images import ost, save
import numpy as np
from programs import converted, refusal
import pytest

SIZE = 8, 10


@pytest.mark.parametrize('form', ['bag', 'big-endian bag', 'folder', 'npz', 'other npz'])
def test_the_largest_count_of_16_bits_is_no_depth(form, tmp_path):
    depth = np.full((2, *SIZE), 1500, np.uint16)
    depth[:, :3], depth[:, 3] = 65535, 65534
    source, options = tmp_path / 'source', []
    if form == 'folder':
        for number, frame in enumerate(depth):
            save(source / f'{number}.png', frame)
        (source / 'ost.yaml').write_text(ost())
    elif 'bag' in form:
        kind = '>u2' if 'big' in form else '<u2'
        entries = [info('/d/camera_info', 0, SIZE)]
        entries += [
            image('/d/image', n, frame.astype(kind), '16UC1') for n, frame in enumerate(depth)
        ]
        write(source, entries)
    else:
        source = source.with_suffix('.npz')
        np.savez(source, depth=depth, K=MATRIX)
        options = ['--unit', 0.001] if 'other' in form else []
    found = converted(source, *options).depth
    assert np.isnan(found[:, :3]).all()
    np.testing.assert_allclose(found[:, 3], 65.534, rtol=1e-6)
    np.testing.assert_allclose(found[:, 4:], 1.5, rtol=1e-6)


COMPRESSED = 'sensor_msgs/msg/CompressedImage'


def rvl(depth):
    """Return depth as the codec of compressed_depth_image_transport writes it."""
    nibbles = []

    def put(value):
        while value > 7:
            nibbles.append(8 | (value & 7))
            value >>= 3
        nibbles.append(value)

    flat, at, last = [int(value) for value in depth.ravel()], 0, 0
    while at < len(flat):
        start = at
        while at < len(flat) and not flat[at]:
            at += 1
        put(at - start)
        start = at
        while at < len(flat) and flat[at]:
            at += 1
        put(at - start)
        for value in flat[start:at]:
            put((value - last) << 1 if value >= last else ((last - value) << 1) - 1)
            last = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        int(''.join(f'{digit:x}' for digit in nibbles[i : i + 8]), 16)
        for i in range(0, len(nibbles), 8)
    ]
    return struct.pack(f'<II{len(words)}I', depth.shape[1], depth.shape[0], *words)


def compressed(form, content, stamp=0):
    """Return a message of compressed depth."""
    data = np.frombuffer(struct.pack('<iff', 0, 0, 0) + content, np.uint8)
    message = make(COMPRESSED, header(stamp), form, data)
    return ('/d/image/compressedDepth', COMPRESSED, stamp, message)


@pytest.mark.parametrize(
    ('form', 'encode'),
    [
        ('16UC1; compressedDepth', png),
        ('16UC1; compressedDepth png', png),
        ('mono16; compressedDepth png', png),
        ('16UC1; compressedDepth rvl', rvl),
    ],
)
def test_compressed_depth_of_16_bits_is_read_without_loss(form, encode, tmp_path):
    depth = np.random.default_rng(1).integers(0, 65535, (2, *SIZE)).astype(np.uint16)
    depth[:, 3:5, 2:] = 0
    depth[1, -1] = 0
    entries = [info('/d/camera_info', 0, SIZE)]
    entries += [compressed(form, encode(frame), number) for number, frame in enumerate(depth)]
    found = converted(write(tmp_path / 'bag', entries)).depth
    expected = np.where(depth > 0, depth * np.float32(0.001), np.nan)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ('form', 'content', 'reason'),
    [
        ('32FC1; compressedDepth png', png(np.ones(SIZE, np.uint16)), "got '32FC1; compressedD"),
        ('16UC1; jpeg', png(np.ones(SIZE, np.uint16)), "got '16UC1; jpeg'"),
        ('16UC1; compressedDepth png', png(np.ones(SIZE, np.uint16))[:40], 'must be a PNG'),
        ('16UC1; compressedDepth png', png(np.ones((8192, 8192), np.uint16)), 'image of at most'),
        ('16UC1; compressedDepth rvl', struct.pack('<II', 1 << 16, 1 << 16), 'must be 1 to'),
        ('16UC1; compressedDepth rvl', rvl(np.ones(SIZE, np.uint16))[:12], 'must be RVL'),
        ('16UC1; compressedDepth rvl', struct.pack('<III', 10, 8, 0x7FFFFFFF), 'must be RVL'),
        ('16UC1; compressedDepth rvl', struct.pack('<III', 10, 8, 0xFFFFFFFF), 'must be RVL'),
        ('16UC1; compressedDepth rvl', b'', 'must be 1 to'),
    ],
)
def test_other_compressed_depth_is_refused_with_the_reason(
    form, content, reason, tmp_path, capsys
):
    entries = [info('/d/camera_info', 0, SIZE), compressed(form, content)]
    bag = write(tmp_path / 'bag', entries)
    said = refusal(capsys, bag, tmp_path / 'out.npz')
    assert "got 'no camera'; /d/image/compressedDepth: " in said
    assert reason in said


@pytest.mark.parametrize(
    ('depth', 'infrared', 'encoding', 'options'),
    [
        ('/cam1/depth_image', '/cam1/ab_image', '16UC1', []),
        ('/cam1/depth_image', '/cam1/ab_image', 'mono16', []),
        ('/k/sd/image_depth', '/k/sd/image_ir', '16UC1', []),
        ('/device_0/Depth_0/image/data', '/device_0/Infrared_1/image/data', 'mono16', []),
        ('/one', '/other', '16UC1', ['--infrared', '/other']),
        ('/one', '/other', 'mono16', ['--camera', '/one', '--infrared', '/other']),
    ],
)
def test_depth_and_infrared_of_one_encoding(depth, infrared, encoding, options, tmp_path):
    seen, bright = np.full(SIZE, 1500, np.uint16), np.full(SIZE, 77, np.uint16)
    bag = write(
        tmp_path / 'bag',
        [
            info('/info/camera_info', 0, SIZE),
            image(depth, 0, seen, encoding),
            image(infrared, 0, bright, encoding),
        ],
    )
    found = converted(bag, *options)
    np.testing.assert_allclose(found.depth, 1.5, rtol=1e-6)
    assert found.amplitude is not None
    assert (found.amplitude == 77).all()


def test_a_camera_that_is_not_found_is_said_with_the_reason_for_each_topic(tmp_path, capsys):
    pixels, lossy = np.ones(SIZE, np.uint16), np.ones(160, np.uint8)
    bag = write(
        tmp_path / 'bag',
        [
            info('/color/camera_info', 0, (4, 6)),
            image('/depth/image', 0, pixels, '16UC1'),
            image('/ir/image', 0, pixels, '16UC1'),
            image('/color/image', 0, pixels.astype(np.uint8), 'mono8'),
            ('/lossy/compressed', COMPRESSED, 0, make(COMPRESSED, header(0), 'jpeg', lossy)),
        ],
    )
    said = refusal(capsys, bag, tmp_path / 'out.npz')
    for reason in (
        '/depth/image: no camera info has its size 10 x 8 and frame ',
        '/ir/image: 16UC1 under this name is no depth',
        '/color/image: mono8 under this name is no depth',
        '/lossy/compressed: compressed with loss',
    ):
        assert reason in said
    said = refusal(capsys, bag, tmp_path / 'out.npz', '--infrared', '/none')
    assert '--infrared: must be the topic of an image of' in said


def test_a_camera_is_found_by_a_later_message(tmp_path):
    """A driver sends an empty camera info before it has read its calibration."""
    entries = [info('/d/camera_info', 0, (0, 0), np.zeros((3, 3)))]
    for stamp in (1, 2):
        entries += [
            info('/d/camera_info', stamp, SIZE),
            image('/d/image', stamp, np.full(SIZE, 1500, np.uint16), '16UC1'),
        ]
    found = converted(write(tmp_path / 'bag', entries))
    np.testing.assert_array_equal(found.K, MATRIX)


@pytest.mark.parametrize('form', ['bag', 'npz'])
def test_depth_along_the_ray_becomes_depth_along_the_axis(form, tmp_path):
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    matrix = np.array([[9.0, 0, 4.5], [0, 9.0, 3.5], [0, 0, 1]])
    along = (2 * np.sqrt(1 + ((u - 4.5) / 9) ** 2 + ((v - 3.5) / 9) ** 2)).astype(np.float32)
    if form == 'npz':
        source = tmp_path / 'in.npz'
        np.savez(source, depth=along[None], K=matrix)
    else:
        camera = info('/d/camera_info', 0, SIZE, matrix, np.zeros(5))
        source = write(tmp_path / 'bag', [camera, image('/d/image', 0, along, '32FC1')])
    np.testing.assert_allclose(converted(source, '--radial').depth, 2.0, rtol=1e-5)


def several(tmp_path, form, stamps):
    """Return a file of frames that show their stamp: 1 m and as many metres as it has ds."""
    depth = np.array([np.full(SIZE, 1 + stamp, np.float32) for stamp in stamps])
    nanoseconds = np.array(stamps, np.int64) * 100_000_000
    if form == 'npz':
        path = tmp_path / 'in.npz'
        clean, known = depth + 1, depth > 0
        np.savez(path, depth=depth, clean_depth=clean, known=known, K=MATRIX, stamp_ns=nanoseconds)
        return path
    entries = [info('/d/camera_info', 0, SIZE)]
    for number, (stamp, frame) in enumerate(zip(nanoseconds.tolist(), depth, strict=True)):
        entries.append(image('/d/image', stamp, frame, '32FC1', received=number))
    return write(tmp_path / 'bag', entries)


@pytest.mark.parametrize('form', ['npz', 'bag'])
@pytest.mark.parametrize(
    ('stamps', 'notes'),
    [
        ([0, 1, 2, 2, 3], ['frames 3 (1 in all): the stamp of another frame']),
        ([0, 0, 1, 1, 2, 3], ['frames 1, 3 (2 in all): the stamp of another frame']),
        ([0, 2, 1, 3], ['frames 2 (1 in all): a stamp before that']),
        ([1, 0, 2, 3], ['frames 1 (1 in all): a stamp before that']),
        ([3, 2, 1, 0], ['frames 1, 2, 3 (3 in all): a stamp before that']),
        ([0, 2, 1, 2, 3], ['frames 3 (1 in all): the st', 'frames 2 (1 in all): a stamp before']),
    ],
)
def test_repeated_frames_are_left_out_and_late_ones_sorted(form, stamps, notes, tmp_path):
    path = several(tmp_path, form, stamps)
    for found in (load_recording(path), converted(path)):
        assert found.stamp_ns.tolist() == [100_000_000 * n for n in sorted(set(stamps))]
        assert (found.depth[:, 0, 0] - 1).tolist() == sorted(set(stamps))
        if form == 'npz':
            assert found.clean_depth is not None
            np.testing.assert_array_equal(found.clean_depth, found.depth + 1)
            assert found.extra['known'].shape == found.depth.shape
    said = [note for note in load_recording(path).notes if ': stamp: ' in note]
    assert len(said) == len(notes)
    for note, part in zip(said, notes, strict=True):
        assert f'{path}: stamp: {part}' in note


@pytest.mark.parametrize(
    ('key', 'scale', 'dtype', 'note'),
    [
        ('depth', 1000, np.float32, 'taken for millimetres'),
        ('depth', 1000, np.float64, 'taken for millimetres'),
        ('clean_depth', 1000, np.float32, 'taken for millimetres'),
        ('clean_depth', 1000, np.uint16, 'taken for millimetres'),
        ('reflectivity', 100, np.float32, 'taken for percent'),
        ('reflectivity', 255, np.uint8, 'taken for bytes'),
    ],
)
@pytest.mark.parametrize('frames', [True, False])
def test_other_units_are_converted_with_a_note(key, scale, dtype, note, frames, tmp_path):
    ramp = np.tile(np.linspace(0.2, 0.8, 80).reshape(SIZE), (2, 1, 1))
    given = {'depth': ramp + 1, 'clean_depth': ramp + 1, 'reflectivity': ramp, 'K': MATRIX}
    wrong = (given[key] * scale).round(2).astype(dtype)
    whole = frames or key == 'depth'
    wanted = given[key] if whole else given[key][0]
    other = {key: wrong if whole else wrong[0]}
    np.savez(tmp_path / 'in.npz', **(given | other))
    found = load_recording(tmp_path / 'in.npz')
    np.testing.assert_allclose(getattr(found, key), wanted, atol=0.006)
    assert [one for one in found.notes if note in one]
    assert found.depth.dtype == np.float32
