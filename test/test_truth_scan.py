"""Ground truth from a scan: real files of a blind camera, in a room that is known as a mesh."""

from dataclasses import replace
from pathlib import Path

from browser import chromium
from campaigns import among
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth import make_truth, RoomRequest
from flexx2_sim_ros.truth.alignment import (
    AlignedPixels,
    ErrorColumns,
    NO_ERRORS,
    PosedImage,
    view_of,
)
from flexx2_sim_ros.truth.clean import apart, Clean, KNOWN, render
from flexx2_sim_ros.truth.from_room import roughness
from flexx2_sim_ros.truth.joint import Solution, solve
from flexx2_sim_ros.truth.observation import Observation, observe
from flexx2_sim_ros.truth.registration import register, views_of
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.run import GivenRecording
from flexx2_sim_ros.truth.shared import _hidden_by_bounce, estimate
from flexx2_sim_ros.truth.verdict import room_error
import numpy as np
import pytest
from scans import (
    box,
    errors,
    HEIGHT,
    record,
    RECORDINGS,
    rough,
    scaled,
    SMALL_K,
    text,
    truth,
    WIDTH,
)
from scipy import ndimage
import trimesh

PHONE = {'deviceScaleFactor': 1, 'mobile': True}


@pytest.fixture(scope='module')
def rng():
    return np.random.default_rng(5)


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """Return a folder with `in/` and `room.ply` of a camera without effects."""
    folder = tmp_path_factory.mktemp('plain')
    return folder, record(folder, {})


def registered(folder, number, guess):
    """Return the views of a recording that is registered from a rough pose."""
    path = folder / 'in' / f'{number}.npz'
    with np.load(path) as archive:
        uptime = archive['uptime']
    request = RoomRequest(recordings=(), out=Path(), room=folder / 'room.ply')
    given = GivenRecording(path, request, uptime=uptime)
    return views_of((number, given, register(given, tuple(guess.numbers()))))


def joint(folder, camera, rng):
    """Return what a fit from 5 cm and 3 degrees off finds, and its pose errors in metres."""
    true = [Pose(*camera.poses(i)[0]) for i in range(RECORDINGS)]
    views = []
    for i, pose in enumerate(true):
        views += registered(folder, i, rough((pose.R, pose.t), rng))
    solution, found = estimate(views)
    motions = [true[view.recording].motion_to(view.pose) for view in solution.views]
    return found, np.linalg.norm([motion[:3] for motion in motions], axis=1)


# Metres: the median of four recordings at a quarter of the camera's pixels. Multipath and
# wiggling bend whole surfaces; a pose that is fitted alone is off by 5 to 40 mm there, and by 10
# to 30 mm with a wrong lens and while the camera warms up.
@pytest.mark.parametrize(
    ('effects', 'most'),
    [
        ({'flying_pixels': 1.0}, 0.003),
        ({'low_signal_dropout': 1.0}, 0.003),
        ({'offset': 5.0}, 0.003),
        ({'wiggling': 3.0}, 0.008),
        ({'multipath': 1.0}, 0.010),
        ({'range_wrap': 1.0}, 0.003),
        ({'intrinsics_error': 1.0}, 0.003),
        ({'warm_up_drift': 1.0}, 0.003),
    ],
)
def test_poses_are_right_whatever_the_camera_does_wrong(tmp_path, rng, effects, most):
    camera = record(tmp_path, effects)
    found, wrong = joint(tmp_path, camera, rng)
    assert np.median(wrong) < most
    offset = found['offset']
    if offset['verdict'] == 'identified':
        bias = camera.camera.effects[0].parameters.get('bias', 0.0)
        drifts = 'warm_up_drift' in effects
        assert offset['metres'] == pytest.approx(0.0 if drifts else bias, abs=0.004)
    for name in ('intrinsics_error', 'warm_up_drift'):
        if name in effects:
            assert found[name]['verdict'] == 'identified'


def test_one_recording_cannot_tell_a_wave_from_its_pose(tmp_path, rng):
    camera = record(tmp_path, {'wiggling': 3.0})
    _, found = estimate(registered(tmp_path, 0, rough(camera.poses(0)[0], rng)))
    assert 'wiggling' not in found


@pytest.mark.parametrize(
    ('bias', 'said'),
    [(0.004, 'bounced light adds 6 mm; a smaller offset'), (-0.004, 'adds 6 mm'), (0.007, '')],
)
def test_bounced_light_hides_an_offset_that_is_smaller(bias, said):
    views = [
        PosedImage(
            0,
            Path(),
            AlignedPixels(np.zeros((4, 2)), *np.ones((3, 4)), (), *np.zeros((2, 4), int), bounce),
            Pose(np.eye(3), np.zeros(3)),
        )
        for bounce in (np.array([0.02, -0.01, 0.0, 0.01]), np.full(4, 0.03))
    ]
    # A mean of 20 mm, of which the gain is 0.3.
    values = np.array([bias, 0.3])
    solution = Solution(ErrorColumns(), values, 0 * values, tuple(views), (), ())
    found = _hidden_by_bounce(solution)
    assert said in found
    assert bool(found) == bool(said)


@pytest.mark.parametrize('factor', [1.0, 1.006])
def test_a_scan_of_the_wrong_scale_is_told(tmp_path, plain, rng, factor):
    folder, camera = plain
    mesh = trimesh.load_mesh(folder / 'room.ply', process=False)
    scaled(mesh, factor).export(tmp_path / 'room.ply')
    (tmp_path / 'in').symlink_to(folder / 'in')
    found = joint(tmp_path, camera, rng)[0]
    if factor == 1:
        assert 'fraction' not in found['depth_scale']
    else:
        # A prior of 0.5 % pulls it towards none.
        assert found['depth_scale']['fraction'] == pytest.approx(1 / factor - 1, abs=0.002)


def test_a_scale_is_the_cameras_only_where_that_of_the_scan_is_known(tmp_path, rng):
    camera = record(tmp_path, {'depth_scale': 1.0})
    room, poses = tmp_path / 'room.ply', [camera.poses(i)[0] for i in range(RECORDINGS)]
    given = [f'--pose={text(rough(pose, rng))}' for pose in poses]
    for scale in ([], ['--scale-error', '0.02'], ['--scale-error', '0.001']):
        table = truth(tmp_path / 'out', tmp_path / 'in', '--scan', room, *given, *scale)
        undecided = [row['effect'] for row in table['cannot_decide'] if row.get('confounded')]
        assert undecided == ([] if '0.001' in scale else ['offset', 'depth_scale'])
        if '0.02' in scale:
            continue
        found = diagnose(tmp_path / 'out', **among('depth_scale', 'wiggling', 'amplitude_bias'))
        if scale:
            assert [row['name'] for row in found['effects']] == ['depth_scale']
        else:
            assert (found['verdict'], found['effects']) == ('unknown', [])
            assert 'depth_scale' in [row['name'] for row in found['alternatives']]


def test_without_a_pose_it_is_right_or_doubtful(tmp_path, plain):
    folder, camera = plain
    table = make_truth(
        RoomRequest(recordings=(folder / 'in',), room=folder / 'room.ply', out=tmp_path / 'out')
    )
    right = 0
    for i, row in enumerate(table['recordings']):
        true = Pose(*camera.poses(i)[0])
        motion = true.motion_to(Pose.from_numbers(np.array(row['pose'])))
        good = bool(np.linalg.norm(motion[:3]) < 0.01)
        assert good or row['verdict'] != 'used'
        right += good
    assert right >= 2


def test_the_roughness_of_a_scan_is_seen_through_noise_and_bias(rng):
    v, u = np.mgrid[:96, :128]
    rays = np.stack([(u - 64) / 100, (v - 48) / 100], axis=-1)
    length = np.sqrt(1 + (rays**2).sum(axis=-1))
    depth = 1 / (0.6 + 0.3 * rays[..., 0])  # A tilted wall.
    cosine = 1 / (np.hypot(0.6, 0.3) * depth * length)
    known = np.full(depth.shape, KNOWN, np.uint8)
    clean = Clean(depth, np.arccos(cosine), None, known, np.zeros(depth.shape))
    noise = np.full(depth.shape, 0.002)
    for scatter in (0.0, 0.004):
        bumps = scatter * rng.standard_normal(depth.shape) / (cosine * length)
        seen = depth + 0.03 / length + bumps + noise * rng.standard_normal(depth.shape)
        found = roughness(clean, Observation(rays, seen, noise, ()))
        assert found == pytest.approx(scatter, abs=0.0005)


def test_noise_that_neighbours_share_is_no_other_thing(rng):
    """Assert it for a noisy camera with a filter, and a box that is nearer than noise makes it."""
    rays, flat = np.zeros((60, 80, 2)), np.full((60, 80), 3.0)
    known = np.full(flat.shape, KNOWN, np.uint8)
    noise = ndimage.gaussian_filter(rng.standard_normal(flat.shape), 2)
    depth = flat + 0.1 * noise / noise.std()
    depth[20:40, 20:40] -= 1.2
    sigma = np.full(flat.shape, 0.1)
    found = apart(Clean(flat, flat, None, known, sigma), Observation(rays, depth, sigma, ()))
    assert (found[22:38, 22:38] == -1).all()
    found[18:42, 18:42] = 0
    assert not found.any()


def test_a_campaign_is_written_with_what_is_known_of_it(tmp_path, plain, rng, capsys):
    folder, camera = plain
    out = tmp_path / 'out'
    poses = [rough(camera.poses(i)[0], rng) for i in range(RECORDINGS)]
    words = folder / 'in', '--scan', folder / 'room.ply', '--jobs', '2'
    table = truth(out, *words, *[f'--pose={text(pose)}' for pose in poses])
    assert [row['verdict'] for row in table['recordings']] == ['used'] * RECORDINGS
    hidden = {row['effect']: row.get('absorbed') for row in table['cannot_decide']}
    assert hidden['pose_error'] == 1.0
    assert 'time_offset' not in hidden  # Nothing moves.
    assert table['reflectivity']['kind'] == 'relative'
    assert table['room_rough_mm'] < 1  # The mesh is exact.
    said = ' '.join(capsys.readouterr().err.split())
    assert '--room-error: 1 mm (estimated: ' in said
    assert 'so that depth errors below 2 mm do not count as a gap' in said
    assert 'recordings and room differ by ' in said
    assert 'differ by 0.0 mm' not in said
    for i in range(RECORDINGS):
        recording = open_recording(out / f'{i}.npz').load()
        told = camera.camera.scenes.clean(i)[0]
        known = recording.extra['known']
        assert recording.clean_depth is not None
        assert known.dtype == bool
        assert known.mean() > 0.9
        error = np.abs(recording.clean_depth - told)[known]
        assert np.nanmedian(error) < 0.002
        assert np.nanpercentile(error, 95) < 0.02  # Beside the edges.
        assert recording.extra['clean_sigma'].shape == (HEIGHT, WIDTH)
        assert recording.reflectivity is not None
        ratio = (recording.reflectivity / camera.camera.scenes.clean(i)[1])[known]
        assert 0.5 < np.nanmedian(ratio) < 2.0  # Relative: bright walls are taken for white.
        assert np.nanpercentile(np.abs(ratio / np.nanmedian(ratio) - 1), 80) < 0.2
        covariance = recording.extra['pose_covariance']
        assert np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance)[0] > 0
        with np.load(folder / 'in' / f'{i}.npz') as source:
            assert np.array_equal(recording.depth, source['depth'], equal_nan=True)
            assert np.array_equal(recording.stamp, source['stamp'])
    with chromium(tmp_path) as page:
        page.call('Emulation.setDeviceMetricsOverride', width=390, height=844, **PHONE)
        page.open((out / 'truth.html').as_uri())
        assert page.evaluate('[...document.images].every(one => one.naturalWidth)')
        assert page.evaluate('document.images.length') == 3 * RECORDINGS
        # It fits a phone.
        assert page.evaluate('document.documentElement.scrollWidth') <= 390


@pytest.mark.parametrize(
    ('wrong', 'count', 'least', 'most', 'said'),
    [
        (0.0, 4, 0.001, 0.001, 'estimated: '),
        (0.0016, 4, 0.0013, 0.0027, 'estimated: '),
        (0.008, 4, 0.003, 0.003, 'may be an error of the camera'),
        (0.0, 1, 0.003, 0.003, 'few flat patches are seen'),
    ],
)
def test_the_error_of_a_room_is_what_recordings_show_of_it(
    tmp_path, wrong, count, least, most, said
):
    """Assert it for walls that are bent by waves of 0.7 m, and a camera with 4 mm of noise."""
    (middle, _), rng = box(tmp_path), np.random.default_rng(1)
    path, shape = tmp_path / 'room.ply', (48, 64) if count > 1 else (24, 32)
    v, u = np.mgrid[: shape[0], : shape[1]]
    rays = np.stack([(u - shape[1] / 2) / 50, (v - shape[0] / 2) / 50], axis=-1)
    views = []
    for i in range(count):
        pose = middle.moved(np.array([0.1 * i, 0, -0.1 * i, 0.1 * i, 0.3 * i, 0]))
        hits = load_room(path).cast(pose, rays.reshape(-1, 2))
        points = np.column_stack([rays.reshape(-1, 2), np.ones(u.size)]) * hits.depth[:, None]
        wave = np.sin((pose.t + points @ pose.R.T) @ np.full(3, 9 / np.sqrt(3)))
        bent = hits.depth + wrong * np.sqrt(2) * wave / -hits.slant(rays.reshape(-1, 2))
        depth = bent.reshape(shape) + rng.normal(0, 0.004, shape)
        image = Observation(rays, depth, np.full(shape, 0.004), ())
        views.append(replace(view_of(path, image, 5000, pose), recording=i))
    error, words = room_error(solve(views, NO_ERRORS))
    assert least <= error <= most
    assert said in words


def test_a_moving_camera_is_followed(tmp_path, rng):
    camera = record(tmp_path, {}, recordings=1, moving=True)
    assert observe(open_recording(tmp_path / 'in' / '0.npz'), None).moving
    guess, out = f'--pose={text(rough(camera.poses(0)[0], rng))}', tmp_path / 'out'
    truth(out, tmp_path / 'in', '--scan', tmp_path / 'room.ply', guess)
    written = open_recording(out / '0.npz').load()
    assert written.reflectivity.shape == written.clean_depth.shape
    # Every frame: a camera that stood still would be off by 10 cm at the end.
    assert errors(out, camera).max() < 0.01


def test_a_pose_that_is_exact_is_written(tmp_path):
    """Assert it for noiseless depth, whose alignment ends with its first step."""
    pose, depth = box(tmp_path)
    np.savez(tmp_path / 'ideal.npz', depth=depth, K=SMALL_K, usecase='Mode_9_30fps')
    out, words = tmp_path / 'out', ('--scan', tmp_path / 'room.ply', f'--pose={text(pose)}')
    (row,) = truth(out, tmp_path / 'ideal.npz', *words)['recordings']
    assert row['verdict'] != 'refused'
    assert row['residual_mm'] < 0.1
    page = (out / 'truth.html').read_text()
    assert page.count('data:image/png') == 3
    assert '<polyline' not in page


def test_a_mujoco_scene_is_a_room_too(tmp_path, plain):
    boxes = ''.join(
        f'<geom type="box" size="{size}" pos="{pos}"/>'
        for size, pos in (
            ('2 2.5 .1', '0 0 -.1'),
            ('.1 2.5 1.3', '2 0 1.2'),
            ('2 .1 1.3', '0 2.5 1.2'),
            ('.3 .2 .4', '1.2 1.0 .4'),
            ('.2 .3 .2', '1.5 -.4 1.2'),
        )
    )
    ball = '<geom type="sphere" size=".3" pos="1.3 .3 .3"/>'
    path = tmp_path / 'room.xml'
    path.write_text(f'<mujoco><worldbody>{boxes}{ball}</worldbody></mujoco>')
    R = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # along +x
    pose = Pose(R, np.array([-1.0, 0.2, 0.9])).moved(np.array([0, 0, 0, -0.2, 0.2, 0]))
    reader = open_recording(plain[0] / 'in' / '0.npz')
    clean = render(load_room(path), pose, observe(reader, None).still.rays, 0.0)
    assert clean.known.all()  # A model has no holes: nothing is nothing.
    noise = np.random.default_rng(0).normal(0, 0.005, (8, HEIGHT, WIDTH))
    depth = (clean.depth + noise).astype(np.float32)
    np.savez(tmp_path / 'r.npz', depth=depth, K=reader.K, stamp=reader.stamp)
    wrong = pose.moved(np.array([0.03, -0.03, 0.03, 0.03, 0, 0.03]))
    words = tmp_path / 'r.npz', '--scene', path, f'--pose={text(wrong)}'
    truth(tmp_path / 'out', *words)
    written = open_recording(tmp_path / 'out' / 'r.npz').load()
    assert written.reflectivity is not None
    assert np.nanmedian(np.abs(written.clean_depth - clean.depth)) < 0.001
