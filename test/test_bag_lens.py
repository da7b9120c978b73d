"""Lenses of cameras in bags: given ones, those of a part of the sensor, of rectified images."""

from pathlib import Path

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
from made_bags import camera_entries, depths, driver_bag, image, info, make, MATRIX, write
from made_images import ost
import numpy as np
from programs import convert, converted, refusal
import pytest

SIZE = 172, 224
GIVEN = [200.0, 0.0, 110.0, 0.0, 201.0, 86.0, 0.0, 0.0, 1.0]
BENT = [0.1, -0.2, 0.001, 0.002, 0.05]


@pytest.fixture
def lens(tmp_path):
    path = tmp_path / 'lens.yaml'
    path.write_text(
        ost(
            image_width=224,
            image_height=172,
            camera_matrix={'data': GIVEN},
            projection_matrix={'data': [150.0, 0, 100, 0, 0, 151, 80, 0, 0, 0, 1, 0]},
        )
    )
    return path


def entries(topic='/d/image_raw', where='/d/camera_info', **fields):
    """Return a camera's messages; without a topic for it, there is no camera info."""
    made = []
    for stamp, depth in enumerate(depths(3)):
        made.append(image(topic, stamp, depth))
        if where:
            one = info(where, stamp, SIZE, distortion=np.array(fields.pop('d', BENT)))
            for name, value in fields.items():
                setattr(one[3], name, value)
            made.append(one)
    return made


@pytest.mark.parametrize(
    'fields',
    [
        {'where': ''},
        {'k': np.zeros(9), 'p': np.zeros(12)},
        {'k': np.eye(3).ravel()},
        {'distortion_model': 'thin_prism', 'd': BENT},
        {'height': 480, 'width': 640},
    ],
    ids=['no camera info', 'zeros', 'unit', 'another lens', 'another size'],
)
def test_a_lens_is_given_where_the_bag_has_none_that_can_be_used(fields, lens, tmp_path, capsys):
    bag, out = write(tmp_path / 'bag', entries(**fields)), tmp_path / 'out.npz'
    assert 'flexx2 convert --calibration FILE' in refusal(capsys, bag, out)
    assert not out.exists()
    found = converted(bag, '--calibration', lens)
    assert found.K.ravel().tolist() == GIVEN
    np.testing.assert_array_equal(found.extra['distortion'], BENT)
    assert found.extra['frame_id'] == 'pmd_royale_ros_camera_node_optical_frame'
    np.testing.assert_array_equal(found.depth, depths(3))


@pytest.mark.parametrize(
    ('options', 'row'),
    [
        (['--intrinsics', 200, 201, 110, 86], [200.0, 0.0, 110.0]),
        (['--calibration', 'lens.yaml', '--rectified'], [150.0, 0.0, 100.0]),
    ],
    ids=['numbers', 'the projection of a file'],
)
def test_a_lens_without_distortion_is_given(options, row, lens, tmp_path, monkeypatch):
    monkeypatch.chdir(lens.parent)
    found = converted(write(tmp_path / 'bag', entries(where='')), *options)
    assert found.K[0].tolist() == row
    assert 'distortion' not in found.extra


def test_a_given_lens_replaces_that_of_any_recording(lens, tmp_path):
    """Assert it of the real driver, and of a bag that was converted."""
    bag, again = driver_bag(tmp_path / 'driver', depths(2)), tmp_path / 'again'
    found = converted(bag, '--calibration', lens)
    assert found.K.ravel().tolist() == GIVEN
    assert convert(tmp_path / 'driver.npz', again) == 0
    found = converted(again, '--intrinsics', 211, 212, 111, 85)
    assert found.K[0].tolist() == [211.0, 0.0, 111.0]
    assert 'distortion' not in found.extra


@pytest.mark.parametrize(
    'matrix',
    [
        np.eye(3),
        np.zeros((3, 3)),
        MATRIX / [[1, 1, 224], [1, 1, 172], [1, 1, 1]],
        MATRIX / [[224, 1, 224], [1, 172, 172], [1, 1, 1]],
        MATRIX + [[0, 2, 0], [0, 0, 0], [0, 0, 0]],
    ],
    ids=['unit', 'zeros', 'fractions', 'all fractions', 'skew'],
)
def test_a_matrix_that_is_no_calibration_is_refused(matrix, lens, tmp_path, capsys):
    source = tmp_path / 'r.npz'
    np.savez(source, depth=np.full((3, *SIZE), 1.5, 'f4'), K=matrix)
    assert 'K: must be' in refusal(capsys, source, tmp_path / 'out.npz')
    assert converted(source, '--calibration', lens).K.ravel().tolist() == GIVEN


def test_all_commands_refuse_it(tmp_path, capsys):
    source, folder = tmp_path / 'in' / 'r.npz', tmp_path / 'in'
    folder.mkdir()
    flat = np.full((3, *SIZE), 1.5, 'f4')
    np.savez(source, depth=flat, clean_depth=flat, K=np.eye(3), usecase='Mode_9_30fps')
    board = tmp_path / 'wall.obj'
    board.write_text('v -1 -1 2\nv 1 -1 2\nv 1 1 2\nv -1 1 2\nf 1 2 3\nf 1 3 4\n')
    out = tmp_path / 'out'
    for command in (
        ['convert', source, out],
        ['simulate', source, out.with_suffix('.npz')],
        ['gap', 'truth', source, '--scan', board, '--out', out],
        ['gap', 'diagnose', folder, '--out', out, '--jobs', 1],
    ):
        assert main([*map(str, command)]) == 2
        assert 'K: must be' in ' '.join(capsys.readouterr().err.split()), command
        assert not list(tmp_path.glob('out*'))


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--intrinsics', 0, 201, 110, 86], '--intrinsics: K: fx: must be'),
        (['--intrinsics', 200, 201, 0.5, 0.5], '--intrinsics: K: must be a calibrated'),
        (['--intrinsics', 200, 201, 110, 86, '--calibration', 'lens.yaml'], 'must be left out'),
        (['--calibration', 'small.yaml'], 'must be 224 x 172, the size of the images, got 10 x 8'),
        (['--calibration', 'none.yaml'], 'none.yaml: must be a YAML file, got no file'),
    ],
)
def test_a_given_lens_that_cannot_be_is_refused(
    options, said, lens, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(lens.parent)
    Path('small.yaml').write_text(ost())
    bag = write(tmp_path / 'bag', entries())
    assert said in refusal(capsys, bag, tmp_path / 'out.npz', *options)
    assert not (tmp_path / 'out.npz').exists()


def test_one_lens_is_not_that_of_two_cameras(lens, tmp_path, capsys):
    both = [*entries('/a/image', ''), *entries('/b/image', '')]
    bag = write(tmp_path / 'bag', both)
    said = refusal(capsys, bag, tmp_path / 'out.npz', '--calibration', lens)
    assert '--calibration: must come with --camera for a bag with several cameras' in said
    assert 'a/image, b/image' in said
    assert converted(bag, '--calibration', lens, '--camera', 'b/image').K[0, 0] == 200.0


@pytest.mark.parametrize(
    ('topic', 'options', 'rectified'),
    [
        ('/d/image_rect', [], True),
        ('/d/image_rect', ['--no-rectified'], False),
        ('/d/image_rect_raw', [], False),
        ('/d/image_raw', [], False),
        ('/d/image_raw', ['--rectified'], True),
    ],
)
def test_a_rectified_image_has_the_projection_matrix(topic, options, rectified, tmp_path):
    projection = np.array([190.0, 0, 112, 0, 0, 192, 86, 0, 0, 0, 1, 0])
    found = converted(write(tmp_path / 'bag', entries(topic, p=projection)), *options)
    assert found.K[0, 0] == (190.0 if rectified else MATRIX[0, 0])
    assert ('distortion' in found.extra) != rectified
    # A bag that was made of it is of the same camera.
    again = tmp_path / 'again'
    assert convert(tmp_path / 'bag.npz', again) == 0
    np.testing.assert_array_equal(load_recording(again).K, found.K)


@pytest.mark.parametrize('sensor', [True, False], ids=['of the sensor', 'of the image'])
def test_a_part_of_the_sensor_is_found_and_read(sensor, tmp_path):
    region = make('sensor_msgs/msg/RegionOfInterest', 0, 0, 344, 448, False)
    scale = np.array([2, 1, 2, 1, 2, 2, 1, 1, 1]) if sensor else 1
    fields = {'binning_x': 2, 'binning_y': 2, 'roi': region, 'k': MATRIX.ravel() * scale}
    bag = write(tmp_path / 'bag', entries(height=344, width=448, **fields))
    found = converted(bag)
    np.testing.assert_allclose(found.K, MATRIX, atol=0.26)
    (note,) = (note for note in load_recording(bag).notes if 'binning' in note)
    assert note.partition(': K: ')[2].startswith('of the full' if sensor else 'taken for')


def test_a_clean_image_may_be_rectified(tmp_path, capsys):
    """Assert that the projection is taken of a simulator's topic image_rect."""
    made = []
    flat = np.full((2, *SIZE), 1.5, 'f4')
    for entry in camera_entries('left', flat, flat):
        topic, kind, stamp, message = entry
        if topic == '/left/clean/camera_info':
            message.d = np.array(BENT)
            message.p = np.hstack([MATRIX, np.zeros((3, 1))]).ravel()
        elif topic == '/left/flexx2_camera/camera_info':
            message.d = np.zeros(5)
        made.append((topic.replace('clean/depth_image', 'clean/image_rect'), kind, stamp, message))
    bag = write(tmp_path / 'bag', made)
    assert load_recording(bag).clean_depth is None
    clean = converted(bag, '--clean', '/left/clean/image_rect').clean_depth
    assert clean is not None
    assert np.isfinite(clean).all()
    assert 'looked up' not in capsys.readouterr().err  # They have the same pixels.


@pytest.mark.parametrize(
    ('options', 'status', 'said'),
    [
        (['--usecase', 'Mode_9_30fps'], 0, ''),
        (['--usecase', 'mode_9_30FPS'], 0, ''),
        (['--usecase', 'Mode_9_31fps'], 0, "'Mode_9_31fps' is a mode of no shipped profile, did"),
        (['--usecase', 'tof'], 0, "'tof' is a mode of no shipped profile (--profile"),
        (['--usecase', 'nfov_unbinned_30fps', '--profile', 'azure_kinect_nfov'], 0, ''),
        (['--usecase', 'Mode_9_31fps', '--profile', 'flexx2'], 2, 'did you mean Mode_9_30fps?'),
        (['--usecase', 'Mode_9_30fps', '--profile', 'kinect_v2'], 2, 'one of depth_30fps, got'),
        (['--profile', 'kinect'], 2, 'profile: must be one of'),
    ],
)
def test_a_mode_is_checked_against_the_cameras(options, status, said, tmp_path, capsys):
    bag, out = write(tmp_path / 'bag', entries()), tmp_path / 'out.npz'
    assert convert(bag, out, *options) == status
    heard = ' '.join(capsys.readouterr().err.split())
    assert said in heard
    assert ('usecase:' in heard) == (said.startswith("'") or 'got' in said or 'mean' in said)
    if '--profile' in options and not status:
        assert load_recording(out).usecase == 'NFOV_unbinned_30fps'
