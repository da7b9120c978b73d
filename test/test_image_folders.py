"""Recordings from PNG files and from archives of other programs."""

import json
from pathlib import Path
import struct
import zlib

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_messages import header_stamp
from flexx2_sim_ros.recording.calibration import read_calibration
from made_bags import driver_bag
from made_images import counts, EIGHT, folder_of, K, metres, ost, save, SIZE
import numpy as np
from PIL import Image
import pytest
from rosbags.rosbag2 import CompressionMode


def convert(*arguments):
    return main(['convert', *map(str, arguments)])


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
    out = tmp_path / 'out.npz'
    rate = ['--rate', '25'] if stamps[0] == 0 else []
    assert convert(folder, out, '--usecase', 'm', *rate) == 0
    found = load_recording(out)
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
    out = tmp_path / 'out.npz'
    options = ['--calibration', tmp_path / 'my.yaml', '--unit', '0.0002', '--mask', mask]
    assert convert(tmp_path / 'one.png', out, *options) == 0
    found = load_recording(out)
    np.testing.assert_array_equal(found.depth, metres(0.0002)[:1])
    np.testing.assert_array_equal(found.extra['distortion'], EIGHT)
    np.testing.assert_array_equal(found.extra['known'], np.eye(*SIZE, dtype=bool))


def test_an_archive_with_other_keys(tmp_path):
    source, out = tmp_path / 'sdk.npz', tmp_path / 'out.npz'
    np.savez(source, depth_mm=counts(), ir16=counts() // 2, serial=np.array('x'))
    (tmp_path / 'my.yaml').write_text(ost())
    calibration = ['--calibration', tmp_path / 'my.yaml']
    assert (
        convert(source, out, '--key', 'depth=depth_mm', '--key', 'amplitude=ir16', *calibration)
        == 0
    )
    found = load_recording(out)
    np.testing.assert_array_equal(found.depth, metres())
    np.testing.assert_array_equal(found.amplitude, counts() // 2)
    assert found.extra['serial'] == 'x'
    # A single frame needs no third dimension.
    np.savez(source, z=metres()[0], K=np.reshape(K, (3, 3)))
    assert convert(source, out, '--key', 'depth=z') == 0
    np.testing.assert_array_equal(load_recording(out).depth, metres()[:1])


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
    folder_of(Path('images'), ['1.png', '2.png', '3.png'])
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
    assert convert(bag, tmp_path / 'out.npz') == 0
    found = load_recording(tmp_path / 'out.npz')
    np.testing.assert_array_equal(found.depth, metres())
    assert found.usecase == 'Mode_5_45fps'


def test_images_may_lie_beside_metadata_of_others(tmp_path):
    folder = folder_of(tmp_path / 'in', ['1.png', '2.png', '3.png'])
    (folder / 'metadata.yaml').write_text('licence: none')
    lens = folder / 'ost.yaml'
    assert convert(folder, tmp_path / 'out.npz', '--calibration', lens) == 0
    np.testing.assert_array_equal(load_recording(tmp_path / 'out.npz').depth, metres())


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


# As programs write them: fx 211, fy 213, cx 4.5, cy 3.5, and for some k1 0.1.
LENSES = {
    'OpenCV': (
        '%YAML:1.0\n---\ncameraMatrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n'
        '   data: [ 2.11e+02, 0., 4.5, 0.,\n       213., 3.5, 0., 0., 1. ]\n'
        'distortionCoefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n'
        '   data: [ 1.0e-01, 0., 0., 0., 0. ]\n'
    ),
    'a topic': (
        'header:\n  frame_id: cam\nheight: 8\nwidth: 10\ndistortion_model: plumb_bob\n'
        'd:\n- 0.1\n- 0.0\nk:\n- 211.0\n- 0.0\n- 4.5\n- 0.0\n- 213.0\n- 3.5\n- 0.0\n- 0.0\n- 1.0\n'
        '---\nheader:\n  frame_id: cam\n---\n'
    ),
    'Open3D': (
        '{"width": 10, "height": 8,\n\t"intrinsic_matrix": [211, 0, 0, 0, 213, 0, 4.5, 3.5, 1]}'
    ),
    'librealsense': '{"width": 10, "height": 8, "fx": 211, "fy": 213, "ppx": 4.5, "ppy": 3.5}',
    'perception': '{"_cy": 3.5, "_cx": 4.5, "_fy": 213, "_height": 8, "_fx": 211, "_width": 10}',
    'librealsense in Python': (
        '{"width": 10, "height": 8, "fx": 2.11e2, "fy": 213, "ppx": 4.5, "ppy": 3.5,'
        ' "model": "distortion.brown_conrady", "coeffs": [1e-1, 0, 0, 0, 0]}'
    ),
    'Open3D with a pose': (
        '{"class_name": "PinholeCameraParameters", "extrinsic": [1], "intrinsic": '
        '{"width": 10, "height": 8, "intrinsic_matrix": [211, 0, 0, 0, 213, 0, 4.5, 3.5, 1]}}'
    ),
    'rows': '{"K": [[211, 0, 4.5], [0, 213, 3.5], [0, 0, 1]], "D": [[1e-01, 0, 0, 0, 0]]}',
    'Kalibr': (
        'cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]\n'
        '  distortion_model: radtan\n  intrinsics: [211.0, 213.0, 4.5, 3.5]\n'
        '  resolution: [10, 8]\n'
    ),
    'ROS 1': (
        'header: \n  seq: 1\nheight: 8\nwidth: 10\ndistortion_model: "plumb_bob"\nD: [0.1, 0.0]\n'
        'K: [211.0, 0.0, 4.5, 0.0, 213.0, 3.5, 0.0, 0.0, 1.0]\nbinning_x: 0\nroi: \n'
        '  x_offset: 0\n---\n'
    ),
    'of twice the size': (
        'height: 16\nwidth: 20\nk: [422.0, 0.0, 9.5, 0.0, 426.0, 7.5, 0.0, 0.0, 1.0]\n'
        'binning_x: 2\nbinning_y: 2\n'
    ),
    'text of Windows': '\ufeff211 0 4.5\r\n0 213 3.5\r\n0 0 1\r\n',
    **{
        f'OpenCV, {name}': f'K: [211, 0, 4.5, 0, 213, 3.5, 0, 0, 1]\n{name}: [0.1, 0, 0, 0, 0]\n'
        for name in (
            'Distortion_Coefficients',
            'distCoeffs',
            'dist_coeffs',
            'dist_coeff',
            'distortion',
        )
    },
    'text': '# fx 0 cx\n211 0 4.5\n0 213 3.5\n0 0 1\n',
    'four numbers': '211 213 4.5 3.5',
    'text of 4 x 4': '211 0 4.5 0\n0 213 3.5 0\n0 0 1 0\n0 0 0 1\n',
}


@pytest.mark.parametrize('program', LENSES)
def test_a_lens_is_read_from_the_files_of_other_programs(program, tmp_path):
    folder = folder_of(tmp_path / 'in', ['1.png', '2.png', '3.png'])
    lens, out = tmp_path / 'lens.txt', tmp_path / 'out.npz'
    lens.write_text(LENSES[program])
    assert convert(folder, out, '--calibration', lens) == 0
    with np.load(out) as recording:
        K, distortion = recording['K'], recording.get('distortion', np.zeros(5))
    assert K.ravel().tolist() == [211.0, 0.0, 4.5, 0.0, 213.0, 3.5, 0.0, 0.0, 1.0]
    bent = any(word in LENSES[program] for word in ('0.1', '1.0e-01', '1e-'))
    assert distortion[0] == (0.1 if bent else 0.0)


# The raw calibration of a camera's depth sensor: cx, cy, fx, fy, k1 to k6, two zeros, p2, p1.
AZURE = [0.513, 0.517, 0.4928, 0.4929, 0.55, -0.02, -0.003, 0.89, 0.09, -0.01, 0, 0, -7e-5, 2e-5]


def _azure(**changes):
    kind = 'CALIBRATION_LensDistortionModelBrownConrady'
    camera = {
        'Intrinsics': {'ModelParameters': AZURE, 'ModelType': kind},
        'Purpose': 'CALIBRATION_CameraPurposeDepth',
        'SensorHeight': 1024,
        'SensorWidth': 1024,
    }
    colour = {'Purpose': 'CALIBRATION_CameraPurposePhotoVideo'}
    return json.dumps({'CalibrationInformation': {'Cameras': [colour, camera | changes]}})


@pytest.mark.parametrize(
    ('size', 'binning', 'offset'),
    [
        ((576, 640), 1, (192, 180)),
        ((288, 320), 2, (96, 90)),
        ((1024, 1024), 1, (0, 0)),
        ((512, 512), 2, (0, 0)),
    ],
)
def test_the_calibration_of_an_azure_kinect_is_that_of_the_mode(size, binning, offset, tmp_path):
    """Assert the arithmetic of the vendor's SDK for each of its modes."""
    path = tmp_path / 'calibration.json'
    path.write_text(_azure())
    camera = read_calibration(path).intrinsics(size)
    side = 1024 / binning
    expected = [
        AZURE[2] * side,
        AZURE[3] * side,
        AZURE[0] * side - offset[0] - 0.5,
        AZURE[1] * side - offset[1] - 0.5,
    ]
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx(expected)
    assert camera.distortion == (0.55, -0.02, 2e-5, -7e-5, -0.003, 0.89, 0.09, -0.01)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        (_azure(), 'must be 10 x 8, the size of the images, got 1024 x 1024 with roi 640 x 576'),
        (_azure(Purpose='x'), 'CalibrationInformation: must have a depth camera'),
        (_azure(SensorWidth=640), 'SensorWidth, SensorHeight: must be 1024 x 1024'),
        (_azure(Intrinsics={'ModelType': 'Theta'}), 'ModelType: must be CALIBRATION_Lens'),
        (_azure(Intrinsics=None), 'ModelType: must be CALIBRATION_Lens'),
        ('{"CalibrationInformation": []}', 'CalibrationInformation: must have a depth camera'),
        (LENSES['Kalibr'].replace('radtan', 'equi'), 'distortion_model: must be plumb_bob or'),
        (LENSES['OpenCV'] + 'fisheye_model: 1\n', 'distortion_model: must be plumb_bob or'),
        (
            LENSES['librealsense in Python'].replace('n.brown', 'n.inverse_brown'),
            'distortion_model: must be plumb_bob or',
        ),
        ('1 2 3\n4 5 6\n7 8 9\n', 'K: must be [[fx, 0, cx]'),
        ('1 2 3\n', 'must be a YAML mapping'),
        ('K: [[1, 0], [nan, 1e999]]', 'K: must have data, a list of nine numbers'),
        (LENSES['rows'].replace('D', 'distortion_params'), "'distortion_params': must be called"),
        (LENSES['perception'].replace('}', ', "_skew": 3.0}'), 'K: must be [[fx, 0, cx]'),
        ('K: ' + '[' * 5000, 'at most 30 levels'),
    ],
)
def test_other_calibrations_are_refused_in_one_sentence(content, said, tmp_path, capsys):
    folder = folder_of(tmp_path / 'in', ['1.png', '2.png', '3.png'])
    lens = tmp_path / 'lens.txt'
    lens.write_text(content)
    assert convert(folder, tmp_path / 'out.npz', '--calibration', lens) == 2
    assert said in ' '.join(capsys.readouterr().err.split())


@pytest.mark.parametrize('given', ['ost', 'option'])
def test_rectified_images_have_the_projection_of_the_calibration(given, tmp_path):
    folder, out = folder_of(tmp_path / 'in', ['1.png', '2.png', '3.png']), tmp_path / 'out.npz'
    projection = {'data': [50.0, 0, 4, 0, 0, 51, 3, 0, 0, 0, 1, 0]}
    lens = (folder if given == 'ost' else tmp_path) / 'ost.yaml'
    lens.write_text(ost(projection_matrix=projection))
    options = [] if given == 'ost' else ['--calibration', lens]
    assert convert(folder, out, '--rectified', *options) == 0
    found = load_recording(out)
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
    folder = folder_of(tmp_path / 'in', ['1.png', '2.png', '3.png'])
    spoil(folder)
    out = tmp_path / 'out.npz'
    assert convert(folder, out) == 2
    error = ' '.join(capsys.readouterr().err.split())
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
        (
            ['--key', 'depth=d', '--calibration', 'none.yaml'],
            'none.yaml: must be a YAML file, got no file',
        ),
    ],
)
def test_bad_archives_are_refused_in_one_sentence(options, said, tmp_path, capsys):
    source, out = tmp_path / 'sdk.npz', tmp_path / 'out.npz'
    np.savez(source, d=counts(), text=np.array('x'))
    assert convert(source, out, *options) == 2
    assert said in ' '.join(capsys.readouterr().err.split())
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
        out = tmp_path / 'out.npz'
        assert convert(folder.parent, out) == 0
        np.testing.assert_array_equal(load_recording(out).depth, metres())
        assert convert(folder / '1.tiff', out, '--calibration', folder.parent / 'ost.yaml') == 0
        np.testing.assert_array_equal(load_recording(out).depth, metres()[1:2])


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
    assert convert(path, tmp_path / 'out.npz') == 2
    assert said in ' '.join(capsys.readouterr().err.split())


def test_a_tiff_of_several_images_is_refused(tmp_path, capsys):
    first, *others = (Image.fromarray(image) for image in counts())
    first.save(tmp_path / '1.tif', save_all=True, append_images=others)
    (tmp_path / 'ost.yaml').write_text(ost())
    assert convert(tmp_path / '1.tif', tmp_path / 'out.npz') == 2
    assert '1.tif: must have one image, got several' in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'single'), [('0.pgm', True), ('depth/0.EXR', False)])
def test_other_images_are_refused_with_a_way_out(name, single, tmp_path, capsys):
    file = tmp_path / 'in' / name
    file.parent.mkdir(parents=True)
    file.write_bytes(b'')
    assert convert(file if single else tmp_path / 'in', tmp_path / 'out.npz') == 2
    said = ' '.join(capsys.readouterr().err.split())
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
    assert convert(out / 'v1.npz', tmp_path / 'again', '--views', '--usecase', 'm') == 2
    assert (
        '--views: must come with a folder of images or a data set, got' in capsys.readouterr().err
    )


def test_each_folder_of_images_becomes_a_recording(tmp_path):
    for name in ('near', 'far'):
        folder_of(tmp_path / 'in' / name, ['1.png', '2.png', '3.png'])
    assert convert(tmp_path / 'in', tmp_path / 'views', '--views', '--usecase', 'm') == 0
    assert sorted(file.name for file in (tmp_path / 'views').iterdir()) == ['far.npz', 'near.npz']
