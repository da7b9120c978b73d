"""Recordings from PNG files and from archives of other programs."""

from pathlib import Path
import struct
import zlib

from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_messages import header_stamp
from made_bags import driver_bag
from made_images import counts, EIGHT, folder_of, K, metres, ost, save, SIZE
import numpy as np
from PIL import Image
from programs import convert, converted, refusal
import pytest
from rosbags.rosbag2 import CompressionMode

NAMES = ['1.png', '2.png', '3.png']
AT_25_HZ = [0, 40_000_000, 80_000_000]
DAY = [1700000000500000000, 1700000000750000000, 1700000041250000000]
EPOCH = [1305031102160407000, 1305031102200000000, 1305031103500000000]
MILLISECONDS = [1700000000123000000, 1700000000456000000, 1700000001000000000]


@pytest.mark.parametrize(
    ('names', 'stamps'),
    [
        ('depth_1305031102.160407 depth_1305031102.2 depth_1305031103.5', EPOCH),
        ('1700000000123 1700000000456 1700000001000', MILLISECONDS),
        ('frame2 frame9 frame10', AT_25_HZ),
        ('2023-11-14_22-13-20.5 2023-11-14_22-13-20.75 2023-11-14_22-14-01.25', DAY),
        ('d_20231114_221320_500 d_20231114_221320_750 d_20231114_221401_250', DAY),
        # Serial numbers, or later than the year 2262.
        ('9999999997.5 9999999998.5 9999999999.5', AT_25_HZ),
    ],
)
def test_a_folder_becomes_a_recording(names, stamps, tmp_path):
    names = [f'{name}.png' for name in names.split()]
    folder = folder_of(tmp_path / 'in', names)
    for name, image in zip(names, counts(), strict=True):
        save(folder / 'ir' / name, image // 2)
    known = np.ones(SIZE, np.uint8) * 255
    known[:, :4] = 0
    save(folder / 'mask.png', known)
    rate = ['--rate', '25'] if stamps[0] == 0 else []
    found = converted(folder, '--usecase', 'm', *rate)
    np.testing.assert_array_equal(found.depth, metres())
    np.testing.assert_array_equal(found.K.ravel(), K)
    np.testing.assert_array_equal(found.extra['distortion'], EIGHT[:5])
    np.testing.assert_array_equal(found.amplitude, counts() // 2)
    np.testing.assert_array_equal(found.extra['known'], known > 0)
    assert found.extra['known'].dtype == bool
    assert found.stamp_ns.tolist() == stamps
    assert found.usecase == 'm'


def test_a_single_image_in_other_units_with_a_rational_lens(tmp_path):
    save(tmp_path / 'one.png', counts()[0])
    model = {'distortion_model': 'rational_polynomial'}
    lens = {'distortion_coefficients': {'rows': 1, 'cols': 8, 'data': EIGHT}}
    (tmp_path / 'my.yaml').write_text(ost(**model, **lens))
    mask = tmp_path / 'my_mask.png'
    save(mask, np.eye(*SIZE, dtype=bool))
    options = ['--calibration', tmp_path / 'my.yaml', '--unit', '0.0002', '--mask', mask]
    found = converted(tmp_path / 'one.png', *options)
    np.testing.assert_array_equal(found.depth, metres(0.0002)[:1])
    np.testing.assert_array_equal(found.extra['distortion'], EIGHT)
    np.testing.assert_array_equal(found.extra['known'], np.eye(*SIZE, dtype=bool))


def test_an_archive_with_other_keys(tmp_path):
    source = tmp_path / 'sdk.npz'
    np.savez(source, depth_mm=counts(), ir16=counts() // 2, serial=np.array('x'))
    (tmp_path / 'my.yaml').write_text(ost())
    calibration = ['--calibration', tmp_path / 'my.yaml']
    keys = '--key', 'depth=depth_mm', '--key', 'amplitude=ir16'
    found = converted(source, *keys, *calibration)
    np.testing.assert_array_equal(found.depth, metres())
    np.testing.assert_array_equal(found.amplitude, counts() // 2)
    assert found.extra['serial'] == 'x'
    # A single frame needs no third dimension.
    np.savez(source, z=metres()[0], K=np.reshape(K, (3, 3)))
    np.testing.assert_array_equal(converted(source, '--key', 'depth=z').depth, metres()[:1])


@pytest.mark.parametrize(
    ('name', 'options'),
    [
        ('own.npz', ['--mask', 'mask.png']),
        ('nameless.npz', ['--usecase', 'mode_5_60fps']),
        ('other.npz', ['--key', 'depth=z']),
        ('images', ['--usecase', 'Mode_5_60fps']),
    ],
)
def test_frames_without_stamps_come_at_the_rate_of_the_mode(
    name, options, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    arrays = {'K': np.reshape(K, (3, 3)), 'usecase': 'Mode_5_60fps'}
    np.savez('own.npz', depth=metres(), **arrays)
    np.savez('nameless.npz', depth=metres(), K=arrays['K'])
    np.savez('other.npz', z=metres(), **arrays)
    folder_of(Path('images'), NAMES)
    save(Path('mask.png'), np.eye(*SIZE, dtype=bool))
    assert convert(name, 'bag', *options) == 0
    assert 'taken for 60 Hz, that of Mode_5_60fps' in ' '.join(capsys.readouterr().err.split())
    topic = '/camera/flexx2_camera/depth_image_0'
    stamps = [header_stamp(message.data, topic) for message in Bag('bag').messages({topic})]
    assert stamps == [0, 16_666_667, 33_333_333]
    assert load_recording('bag').stamp_ns.tolist() == stamps
    # A rate that is given has priority.
    assert convert(name, 'slow.npz', *options, '--rate', '10') == 0
    assert load_recording('slow.npz').stamp.tolist() == [0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ('beside', 'storage', 'compressed'),
    [('preview.png', 'mcap', False), ('depth/preview.png', 'sqlite3', True)],
)
def test_a_bag_with_an_image_beside_it_is_a_bag(beside, storage, compressed, tmp_path):
    given = np.where(counts() > 0, metres(), 0).astype(np.float32)
    mode = CompressionMode.FILE if compressed else CompressionMode.NONE
    bag = driver_bag(tmp_path / 'bag', given, storage, compression=mode)
    save(bag / beside, counts()[0])
    found = converted(bag)
    np.testing.assert_array_equal(found.depth, metres())
    assert found.usecase == 'Mode_5_45fps'


def test_images_may_lie_beside_metadata_of_others(tmp_path):
    folder = folder_of(tmp_path / 'in', NAMES)
    (folder / 'metadata.yaml').write_text('licence: none')
    found = converted(folder, '--calibration', folder / 'ost.yaml')
    np.testing.assert_array_equal(found.depth, metres())


def huge():
    """Return a PNG that says it has 60,000 x 60,000 pixels."""

    def chunk(kind, content):
        checksum = struct.pack('>I', zlib.crc32(kind + content))
        return struct.pack('>I', len(content)) + kind + content + checksum

    head = struct.pack('>IIBBBBB', 60_000, 60_000, 16, 0, 0, 0, 0)
    data = zlib.compress(bytes(1000))
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', data) + chunk(b'IEND', b'')


def _image(name, pixels):
    return lambda folder: save(folder / name, np.asarray(pixels))


def _bytes(name, content):
    return lambda folder: (folder / name).write_bytes(content)


@pytest.mark.parametrize('given', ['ost', 'option'])
def test_rectified_images_have_the_projection_of_the_calibration(given, tmp_path):
    folder = folder_of(tmp_path / 'in', NAMES)
    projection = {'data': [50.0, 0, 4, 0, 0, 51, 3, 0, 0, 0, 1, 0]}
    lens = (folder if given == 'ost' else tmp_path) / 'ost.yaml'
    lens.write_text(ost(projection_matrix=projection))
    options = [] if given == 'ost' else ['--calibration', lens]
    found = converted(folder, '--rectified', *options)
    assert found.K.ravel().tolist() == [50.0, 0.0, 4.0, 0.0, 51.0, 3.0, 0.0, 0.0, 1.0]
    assert 'distortion' not in found.extra


def _ost(**changes):
    return lambda folder: (folder / 'ost.yaml').write_text(ost(**changes))


@pytest.mark.parametrize(
    ('spoil', 'said'),
    [
        (_image('2.png', np.ones(SIZE, np.uint8)), '2.png: must be a gray PNG of 16 bits'),
        (_image('2.png', np.ones((*SIZE, 3), np.uint8)), 'got colours'),
        (_image('2.png', np.ones((9, 10), np.uint16)), '2.png: must be 10 x 8 pixels as 1.png'),
        (_bytes('2.png', huge()), 'must be an image of at most'),
        (_bytes('2.png', b''), '2.png: must be a PNG, got'),
        (_bytes('2.png', huge()[:20]), '2.png: must be a PNG, got'),
        (_bytes('ost.yaml', b'a: b'), 'ost.yaml: camera_matrix: must have data'),
        (_bytes('ost.yaml', b'- 1'), 'ost.yaml: must be a YAML mapping'),
        (_bytes('ost.yaml', b'!!python/object:os.system x'), 'cannot be read as YAML'),
        (_bytes('b.yaml', b'a: b'), '--calibration: must be a YAML file'),
        (_ost(camera_matrix=None), 'camera_matrix: must have data'),
        (_ost(camera_matrix={'data': [0.0] * 9}), 'ost.yaml: K: must be'),
        (_ost(image_width=640), 'image_width, image_height: must be 10 x 8'),
        (_ost(image_width='x'), 'image_width, image_height: must be whole'),
        (_ost(distortion_model='equidistant'), 'distortion_model: must be plumb_bob or rational'),
        (_ost(distortion_coefficients={'data': 'x'}), 'distortion_coefficients: must have data'),
        (_image('mask.png', np.ones((9, 9), np.uint8)), 'mask.png: must have the size of depth'),
        (_image('mask.png', np.zeros(SIZE, np.uint8)), 'mask.png: must have a pixel'),
        (lambda folder: (folder / 'ost.yaml').unlink(), '--calibration: must be a YAML file'),
    ],
)
def test_bad_folders_are_refused_in_one_sentence(spoil, said, tmp_path, capsys):
    folder = folder_of(tmp_path / 'in', NAMES)
    spoil(folder)
    error = refusal(capsys, folder, tmp_path / 'out.npz')
    assert said in error
    assert 'Traceback' not in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ['in']


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--key', 'depth'], '--key: must be NAME=OTHER'),
        (['--key', 'depth=z'], '--key: must name a key of'),
        (['--key', 'amplitude=d'], 'depth: must be in the file'),
        (['--key', 'depth=d'], 'K: must be a camera matrix'),
        (['--key', 'depth=text'], 'depth: must be numbers'),
        (['--key', 'depth=d', '--calibration', 'none.yaml'], 'none.yaml: must be a YAML file'),
    ],
)
def test_bad_archives_are_refused_in_one_sentence(options, said, tmp_path, capsys):
    source, out = tmp_path / 'sdk.npz', tmp_path / 'out.npz'
    np.savez(source, d=counts(), text=np.array('x'))
    assert said in refusal(capsys, source, out, *options)
    assert not out.exists()


@pytest.mark.parametrize('compression', ['raw', 'tiff_adobe_deflate'])
def test_a_folder_of_tiff_becomes_a_recording(compression, tmp_path):
    # Whole numbers are millimetres, others metres.
    for name, images in (('u16', counts()), ('i32', counts().astype(np.int32)), ('f32', metres())):
        folder = tmp_path / name / 'depth'
        folder.mkdir(parents=True)
        (folder.parent / 'ost.yaml').write_text(ost())
        for number, image in enumerate(images):
            picture = Image.fromarray(image)
            picture.save(folder / f'{number}.tiff', compression=compression)
        np.testing.assert_array_equal(converted(folder.parent).depth, metres())
        one = converted(folder / '1.tiff', '--calibration', folder.parent / 'ost.yaml')
        np.testing.assert_array_equal(one.depth, metres()[1:2])


@pytest.mark.parametrize(
    ('pixels', 'said'),
    [
        (np.ones(SIZE, np.uint8), '1.tif: must be a gray TIFF of 16 or 32 bits a pixel, got 8'),
        (np.ones((*SIZE, 3), np.uint8), '16 or 32 bits a pixel, got colours'),
        (None, '1.tif: must be a TIFF, got a file that is none or is damaged'),
    ],
)
def test_a_tiff_that_is_no_depth_is_refused(pixels, said, tmp_path, capsys):
    path = tmp_path / '1.tif'
    if pixels is None:
        save(path.with_suffix('.png'), counts()[0])
        path.with_suffix('.png').rename(path)  # Another file under this name.
    else:
        Image.fromarray(pixels).save(path)
    (tmp_path / 'ost.yaml').write_text(ost())
    assert said in refusal(capsys, path, tmp_path / 'out.npz')


def test_a_tiff_of_several_images_is_refused(tmp_path, capsys):
    first, *others = (Image.fromarray(image) for image in counts())
    first.save(tmp_path / '1.tif', save_all=True, append_images=others)
    (tmp_path / 'ost.yaml').write_text(ost())
    said = refusal(capsys, tmp_path / '1.tif', tmp_path / 'out.npz')
    assert '1.tif: must have one image, got several' in said


@pytest.mark.parametrize(('name', 'single'), [('0.pgm', True), ('depth/0.EXR', False)])
def test_other_images_are_refused_with_a_way_out(name, single, tmp_path, capsys):
    file = tmp_path / 'in' / name
    file.parent.mkdir(parents=True)
    file.write_bytes(b'')
    said = refusal(capsys, file if single else tmp_path / 'in', tmp_path / 'out.npz')
    assert f'{name}: must be a gray PNG or TIFF of 16 bits, or an .npz file' in said


def test_each_view_of_a_folder_becomes_a_recording(tmp_path, capsys):
    names = ['v1.png', 'v2.png', 'v3.png']
    folder = folder_of(tmp_path / 'in', names)
    for name, image in zip(names, counts(), strict=True):
        save(folder / 'ir' / name, image // 2)
    out = tmp_path / 'views'
    assert convert(folder, out, '--views', '--usecase', 'm') == 0
    for name, depth, gray in zip(names, metres(), counts() // 2, strict=True):
        found = load_recording((out / name).with_suffix('.npz'))
        np.testing.assert_array_equal(found.depth, depth[None])
        np.testing.assert_array_equal(found.amplitude, gray[None])
        assert found.usecase == 'm'
    said = refusal(capsys, out / 'v1.npz', tmp_path / 'again', '--views', '--usecase', 'm')
    assert '--views: must come with a folder of images or a data set, got' in said


def test_each_folder_of_images_becomes_a_recording(tmp_path):
    for name in ('near', 'far'):
        folder_of(tmp_path / 'in' / name, NAMES)
    assert convert(tmp_path / 'in', tmp_path / 'views', '--views', '--usecase', 'm') == 0
    assert sorted(file.name for file in (tmp_path / 'views').iterdir()) == ['far.npz', 'near.npz']
