"""Ground truth from planes: what a tape measure and a set square say of a corner."""

import re
import shutil

from bench.planes import (
    corner,
    describe,
    FRAMES,
    HEIGHT,
    K,
    LASER,
    MODE,
    NAMES,
    RAYS,
    record,
    seen,
    TAPE,
    VIEWS,
    WIDTH,
)
from campaigns import among, change
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.data.hidden import hidden_effects
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth import make_truth, PlaneRequest
from flexx2_sim_ros.truth.plane_constraints import Constraints, PlacedPlanes, settle
from flexx2_sim_ros.truth.plane_file import Angle, Measured
import numpy as np
import pytest
from scans import refused, truth
from scipy.spatial.transform import Rotation
import yaml

KEPT = 'offset', 'wiggling', 'multipath', 'pose_error'
# Few effects make a diagnosis short.
WITHOUT = [name for name in registry() if name not in KEPT]


def seen_by(path, clean, planes, alter=lambda depth: None):
    """Record clean depth, write a file of planes, and return what is said of the recording."""
    stamp = np.arange(FRAMES) / 30
    depth = Camera(MODE, seed=1).capture(clean.astype(np.float32), K, stamp).depth
    alter(depth)
    np.savez(path / 'wall.npz', depth=depth, K=K, stamp=stamp, usecase=MODE)
    (row,) = make(path / 'wall.npz', planes_yaml(path, planes), path / 'out')['recordings']
    return row


def planes_yaml(folder, planes):
    """Write a file of planes."""
    path = folder / 'planes.yaml'
    path.write_text(yaml.safe_dump({'schema': 1, 'planes': planes}))
    return path


def make(recordings, planes, out):
    return make_truth(PlaneRequest(recordings=(recordings,), planes=planes, out=out))


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """Return recordings of a camera without an effect."""
    return record(tmp_path_factory.mktemp('plain') / 'in')


@pytest.fixture(scope='module')
def biased(tmp_path_factory):
    """Return recordings of a camera with an offset of 8 mm."""
    return record(tmp_path_factory.mktemp('biased') / 'in', 0.008)


@pytest.fixture(scope='module')
def measured(plain, tmp_path_factory):
    """Return a folder with their ground truth in `out`, by planes that a laser measured."""
    return with_laser(plain, tmp_path_factory.mktemp('measured'))


@pytest.fixture(scope='module')
def measured_biased(biased, tmp_path_factory):
    """Return the same for the camera with an offset."""
    return with_laser(biased, tmp_path_factory.mktemp('measured_biased'))


def with_laser(recordings, folder):
    make(recordings, describe(folder / 'planes.yaml', taped=LASER), folder / 'out')
    return folder


def table_of(folder):
    return yaml.safe_load((folder / 'out' / 'truth.yaml').read_text())


def test_a_tape_decides_an_offset(biased, tmp_path):
    """Assert it beside a bias by amplitude, whose constant could stand for it."""
    table = make(biased, describe(tmp_path / 'planes.yaml', taped=TAPE), tmp_path / 'out')
    assert table['kind'] == 'planes'
    assert [row['verdict'] for row in table['recordings']] == ['used'] * len(VIEWS)
    assert 'offset' not in [row['effect'] for row in table['cannot_decide']]
    found = diagnose(tmp_path / 'out', **among(*KEPT, 'amplitude_bias'))
    assert found['verdict'] in ('identified', 'partly')
    assert [row['name'] for row in found['effects']] == ['offset']
    # It is all there, though planes may turn about the camera, and with it change their depth.
    depth = found['gap']['wasserstein_mm']
    assert depth['before'] == pytest.approx(8, abs=1.5)
    assert depth['after'] < 1


def test_planes_without_a_distance_leave_the_offset_open(biased, tmp_path):
    table = make(biased, describe(tmp_path / 'planes.yaml', taped=None), tmp_path / 'out')
    assert {'offset', 'pose_error'} <= {row['effect'] for row in table['cannot_decide']}


def test_measured_planes_of_a_right_camera_are_no_false_alarm(measured):
    found = diagnose(measured / 'out', without=WITHOUT)
    assert found['verdict'] in ('none', 'not_decidable')
    assert found['effects'] == []


def test_what_the_ground_truth_hides_is_never_ruled_out(measured, tmp_path):
    shutil.copytree(measured / 'out', tmp_path / 'out')
    file = tmp_path / 'out' / 'truth.yaml'
    table = table_of(tmp_path)
    assert table['absorbed']['offset'] < 0.1
    row = {'effect': 'wiggling', 'reason': 'why', 'absorbed': 0.95, 'settled_by': 'something'}
    file.write_text(yaml.safe_dump({**table, 'cannot_decide': [*table['cannot_decide'], row]}))
    found = diagnose(tmp_path / 'out', without=WITHOUT)
    assert found['verdict'] == 'not_decidable'
    expected = {'name': 'wiggling', 'absorbed': 0.95, 'settled_by': 'something'}
    assert expected in found['not_decidable']
    for wrong, words in (
        ({**row, 'effect': 'no'}, "must be an effect, got 'no'"),
        ({**row, 'absorbed': 2}, 'must be a fraction'),
        (3, 'must be a list of mappings'),
    ):
        file.write_text(yaml.safe_dump({'schema': 1, 'cannot_decide': [wrong]}))
        with pytest.raises(InputError, match=words):
            hidden_effects(tmp_path / 'out')


def test_planes_are_labelled_and_lie_where_the_laser_says(measured_biased):
    for i, (turns, distances) in enumerate(VIEWS):
        clean, which = seen(corner(*turns), distances)
        with np.load(measured_biased / 'out' / f'corner{i}.npz') as file:
            known, plane, depth = file['known'], file['plane'], file['clean_depth']
            assert list(file['plane_names']) == list(NAMES)
            assert file['plane_covariance'].shape == (9, 9)
            assert file['depth'].shape == (FRAMES, HEIGHT, WIDTH)
        assert known.mean() > 0.85
        assert np.array_equal(plane[known] - 1, which[known])
        assert np.isnan(depth[~known]).all()
        # The camera's offset turns what is fitted by half a degree; 6 sigma of the laser besides.
        assert np.abs(depth - clean)[known].max() < 6 * LASER + 0.01
        assert abs(np.median((depth - clean)[known])) < 6 * LASER


def test_reflectivity_of_planes_comes_from_gray_images(plain, tmp_path):
    """Assert it for walls of 0.8 and 0.4 and a floor of 0.2 that the gray image shows."""
    painted, (turns, distances) = np.array([0.8, 0.4, 0.2]), VIEWS[0]
    clean, which = seen(corner(*turns), distances)
    along = np.take_along_axis(RAYS @ corner(*turns).T, which[..., None], axis=-1)[..., 0]
    light = painted[which] * along / np.linalg.norm(RAYS, axis=-1) / clean**2
    path = tmp_path / 'corner0.npz'
    shutil.copy(plain / 'corner0.npz', path)
    change(path, reflectivity=None, amplitude=(40 * light).astype(np.float32))
    table = make(path, describe(tmp_path / 'planes.yaml', taped=LASER), tmp_path / 'out')
    assert table['reflectivity']['gray'] == 'proportional to light'
    recording = open_recording(tmp_path / 'out' / 'corner0.npz').load()
    known = recording.extra['known']
    found = [np.median(recording.reflectivity[known & (which == k)]) for k in range(3)]
    # The 95 % quantile of all pixels is the brightest wall.
    assert found == pytest.approx(painted, rel=0.1)


def test_the_largest_planes_are_found_without_a_hint(plain, tmp_path):
    names = 'first', 'second', 'third', 'fourth'
    path = planes_yaml(tmp_path, [{'name': name} for name in names])
    table = make(plain, path, tmp_path / 'out')
    for row, (_, distances) in zip(table['recordings'], VIEWS, strict=True):
        assert row['verdict'] == 'used'
        assert row['reasons'] == ['fourth: not found']
        found = sorted(plane['distance_m'] for plane in row['planes'])
        assert found == pytest.approx(sorted(distances), abs=0.003)


def test_the_command_warns_of_a_frontal_wall(tmp_path, capsys):
    recordings = tmp_path / 'in'
    recordings.mkdir()
    clean = np.full((HEIGHT, WIDTH), 1.2, np.float32)
    stamp = np.arange(FRAMES) / 30
    depth = Camera(MODE, seed=1).capture(clean, K, stamp).depth
    np.savez(recordings / 'wall.npz', depth=depth, K=K, stamp=stamp, usecase=MODE)
    planes, out = tmp_path / 'planes.yaml', tmp_path / 'out'
    # Distances are measured from the front of the housing, 12 mm ahead of the optical centre.
    text = 'schema: 1\norigin: 0.012\nplanes:\n- name: wall\n  distance: {} +- 0.003\n'
    planes.write_text(text.format(1.188))
    table = truth(out, recordings, '--planes', planes)
    said = ' '.join(capsys.readouterr().err.split())
    assert 'wall.npz: used' in said
    assert 'tilted by 40 degrees' in said
    assert table['recordings'][0]['planes'][0]['distance_m'] == pytest.approx(1.2, abs=0.001)
    page = (out / 'truth.html').read_text()
    assert 'data:image/png' in page
    assert 'alt="map of wall.npz"' in page
    planes.write_text(text.format(1.5))
    table = make(recordings, planes, tmp_path / 'far')
    assert table['recordings'][0]['verdict'] == 'doubtful'
    assert 'more than an offset can be' in table['recordings'][0]['reasons'][0]


@pytest.mark.parametrize(
    ('left', 'change', 'outline', 'known', 'words'),
    [
        # A card on a wall reads too far: nothing is seen through a wall.
        (20, 0.2, None, True, 'and stay known'),
        # At the border of the image it may be a door.
        (0, 0.2, None, False, 'between its own are of other things'),
        (0, 0.2, [[-1, -1], [WIDTH, -1], [WIDTH, HEIGHT], [-1, HEIGHT]], True, 'stay known'),
        # What is nearer may be a thing in front of the wall.
        (20, -0.2, None, False, 'show something nearer, which hides it'),
        (20, -0.2, [[-1, -1], [WIDTH, -1], [WIDTH, HEIGHT], [-1, HEIGHT]], True, 'stay known'),
    ],
)
def test_pixels_inside_a_plane_that_contradict_it_are_counted(
    tmp_path, left, change, outline, known, words
):

    def hang_a_card(depth):
        depth[:, 20:40, left : left + 20] += change

    wall = {'name': 'wall', 'distance': '1.2 +- 0.003', 'outline': outline}
    row = seen_by(tmp_path, np.full((HEIGHT, WIDTH), 1.2), [wall], hang_a_card)
    assert row['known'] + sum(row['unknown'].values()) == pytest.approx(1, abs=0.001)
    (said,) = row['reasons']
    assert words in said
    assert int(said.split()[1]) == pytest.approx(400, rel=0.5)  # its border as well
    with np.load(tmp_path / 'out' / 'wall.npz') as file:
        card = file['known'][22:38, left + 2 : left + 18]
    assert card.all() if known else not card.any()
    assert (row['unknown']['hidden'] > 0) == ('nearer' in words)


def test_a_patch_of_a_plane_without_depth_stays_known(tmp_path):
    """Assert it for a patch that saturates, in which a few pixels read too near."""

    def saturate(depth):
        depth[:, 20:40, 20:40] = np.nan
        depth[:, 25:30, 25:30] = 1.0

    clean = np.full((HEIGHT, WIDTH), 1.2)
    assert seen_by(tmp_path, clean, [{'name': 'wall'}], saturate)['known'] == 1


def test_a_plane_is_as_large_as_what_is_seen_of_it(tmp_path):
    """Assert it for two walls in one plane with a gap between them; a box is on one."""
    clean = np.full((HEIGHT, WIDTH), 1.2)
    clean[:, 50:60] = 2.0
    row = seen_by(tmp_path, clean, [{'name': 'wall', 'box': [80, 20, 100, 60]}])
    with np.load(tmp_path / 'out' / 'wall.npz') as file:
        known = file['known']
    assert not known[:, :60].any()
    assert known[:, 68:].all()
    assert row['unknown']['outside'] == pytest.approx(60 / WIDTH, abs=0.05)


def test_a_plane_that_bends_is_doubtful(tmp_path):
    """Assert it for a wall that turns by 14 degrees, too little for a second wall."""
    u = np.arange(WIDTH)
    clean = np.tile(1.5 - 0.004 * np.maximum(u - 56, 0), (HEIGHT, 1))
    row = seen_by(tmp_path, clean, [{'name': 'wall'}])
    assert row['verdict'] == 'doubtful'
    assert re.match(r'wall: the recording bends it by \d+ mm rms', row['reasons'][0])


def test_planes_found_before_an_interruption_are_not_searched_again(plain, measured, tmp_path):
    planes, out = measured / 'planes.yaml', tmp_path / 'out'
    request = PlaneRequest(recordings=(plain,), planes=planes, out=out)

    def stop(text, fraction):
        if text == 'writing':
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_truth(request, stop)
    seen = []
    table = make_truth(request, lambda text, fraction: seen.append(text))
    assert 'finding planes' not in seen
    names = *(f'corner{i}.npz' for i in range(len(VIEWS))), 'truth.html', 'truth.yaml'
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    assert table['recordings'] == table_of(measured)['recordings']
    for i in range(len(VIEWS)):
        resumed, whole = (
            open_recording(folder / f'corner{i}.npz').load() for folder in (out, measured / 'out')
        )
        assert np.array_equal(resumed.clean_depth, whole.clean_depth, equal_nan=True)


def test_no_ground_truth_of_an_earlier_run_stays_unnoticed(plain, tmp_path, capsys):
    recordings, planes, out = (tmp_path / name for name in ('in', 'planes.yaml', 'out'))
    recordings.mkdir()
    for i in range(3):
        shutil.copy(plain / f'corner{i}.npz', recordings)
    content = yaml.safe_load(describe(planes, taped=LASER).read_text())
    told = content['recordings']
    content['recordings'] = {f'corner{i}': told[f'corner{i}'] for i in range(3)}
    planes.write_text(yaml.safe_dump(content))
    assert 'not_of_this_run' not in make(recordings, planes, out)
    # One recording is refused now, another one was removed.
    content['recordings']['corner1'] = {'left': {'seed': [900, 900]}}
    planes.write_text(yaml.safe_dump(content))
    (recordings / 'corner2.npz').unlink()
    table = truth(out, recordings, '--planes', planes)
    said = ' '.join(capsys.readouterr().err.split())
    assert 'corner2 is not among the recordings, and is ignored' in said
    assert table['not_given'] == ['corner2']
    assert 'corner2.npz: is in' in said
    assert [row['verdict'] for row in table['recordings']] == ['used', 'refused']
    assert table['not_of_this_run'] == ['corner2.npz']
    assert table['absorbed']['offset'] == 0  # The distances of all others were measured.
    assert sorted(path.name for path in out.glob('*.npz')) == ['corner0.npz', 'corner2.npz']


def test_planes_settle_where_measurements_agree():
    normals, distances = corner(5, -22, 2), np.array([0.9, 1.0, 0.6])
    wrong = Rotation.from_rotvec([0.01, -0.004, 0.006]).as_matrix()
    placed = PlacedPlanes(
        np.stack([normals[0] @ wrong, normals[1], normals[2] @ wrong.T]),
        distances + 0.02,
        normals * (distances[:, None] + 0.02) + 0.1,
    )
    told = Constraints(
        NAMES,
        tuple(Measured(distance, 0.001) for distance in distances),
        tuple(
            Angle(one, other, Measured(90, 0.1))
            for one, other in (('left', 'right'), ('left', 'floor'), ('right', 'floor'))
        ),
        (0.0, 0.0, 0.0),
    )
    moved, covariance = settle(placed, told)
    assert np.abs(told.errors(moved)[0]).max() < 1
    assert moved.distances == pytest.approx(distances, abs=0.0005)
    assert np.abs(moved.normals @ moved.normals.T - np.eye(3)).max() < np.radians(0.1)
    assert np.linalg.eigvalsh(covariance).min() > 0
    # The laser is the accuracy of a distance, however the planes may tilt.
    assert moved.distance_deviations(covariance) == pytest.approx([0.001] * 3, rel=0.05)
    # Turned together by some degrees: only that is free, and it moves no right angle.
    assert (np.linalg.eigvalsh(covariance) > np.radians(1) ** 2).sum() == 3


@pytest.mark.parametrize(
    ('planes', 'words'),
    [
        ([{'name': 'a', 'seed': [900, 900]}], 'no plane is found where the file says'),
        ([{'name': 'a', 'angles': {'b': 45}}, {'name': 'b'}], 'must be that of the planes'),
    ],
)
def test_planes_that_are_not_seen_are_one_sentence(plain, tmp_path, capsys, planes, words):
    path = planes_yaml(tmp_path, planes)
    said = refused(capsys, tmp_path / 'out', plain / 'corner0.npz', '--planes', path)
    assert words in said
