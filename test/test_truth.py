"""What a recording says of its ground truth: unknown pixels, accuracy, constraints."""

from flexx2_sim_ros.camera import flexx2, Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.axes import AXES, axes_of
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.data.prior import covariance_of, factor
from flexx2_sim_ros.gap.data.unknown import fill, plane_shifts
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.recording.opening import load_recording, open_recording
from flexx2_sim_ros.recording.truth import accuracy_of, read_truth, Truth
import numpy as np
import pytest

SHAPE = 56, 56
K = flexx2().intrinsics.matrix.copy()
K[:2] *= 0.25
K[:2, 2] -= 0.375
MODE = flexx2().mode('Mode_9_30fps')
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
SLANTED = (1 / (0.5 + 0.002 * U - 0.001 * V)).astype(np.float32)


def write(path, **arrays):
    """Write a recording of a slanted plane that stands still."""
    content = {
        'depth': np.tile(SLANTED, (4, 1, 1)),
        'clean_depth': SLANTED,
        'K': K,
        'stamp': np.arange(4) / 30,
        'usecase': MODE.name,
        **arrays,
    }
    np.savez(path, **content)
    return path


def two_planes():
    """Return the left and the right half as planes, each known to 3 mm and 0.5 degrees."""
    plane = np.where(U < 28, 1, 2).astype(np.uint8)
    std = np.tile([0.003, np.radians(0.5), np.radians(0.5)], 2)
    return {'plane': plane, 'plane_covariance': np.diag(std**2)}


def test_ground_truth_survives_a_bag(tmp_path):
    known = U > 10
    truth = Truth(
        known,
        np.float32(0.002) * np.ones(SHAPE, np.float32),
        1e-6 * np.eye(6),
        **two_planes(),
        plane_names=('wall', 'floor'),
    )
    path = write(tmp_path / 'one.npz', **truth.arrays())
    convert(path, tmp_path / 'bag')
    convert(tmp_path / 'bag', tmp_path / 'again.npz')
    for one in (path, tmp_path / 'bag', tmp_path / 'again.npz'):
        reader = open_recording(one)
        found = read_truth(one, reader.arrays, reader.shape)
        assert found.plane_names == ('wall', 'floor')
        assert set(found.arrays()) == set(truth.arrays())
        for key, value in truth.arrays().items():
            assert np.array_equal(found.arrays()[key], value), key
            assert key in load_recording(one).extra
    said = accuracy_of(truth)
    assert said.unknown == pytest.approx(11 / 56)
    assert said.sigma == pytest.approx(0.002)
    assert (said.pose, said.planes) == (pytest.approx(0.001), 2)
    assert (said.offset, said.tilt) == (pytest.approx(0.003), pytest.approx(0.5))


@pytest.mark.parametrize(
    ('arrays', 'message'),
    [
        ({'known': np.ones(SHAPE, np.uint8)}, 'known: must be bool'),
        ({'known': np.ones((3, *SHAPE), bool)}, r'got bool of shape \(3, 56, 56\)'),
        ({'clean_sigma': np.array(-0.001)}, 'clean_sigma: must be 0 to 10 m, got -0.001'),
        ({'clean_sigma': np.full(SHAPE, np.nan)}, 'clean_sigma: must be 0 to 10 m, got nan'),
        ({'clean_sigma': np.array('1 mm')}, 'clean_sigma: must be metres'),
        ({'pose_covariance': np.eye(3)}, r'pose_covariance: must be numbers \(6, 6\)'),
        ({'pose_covariance': np.full((6, 6), np.inf)}, 'pose_covariance: must be finite'),
        ({'pose_covariance': -np.eye(6)}, 'pose_covariance: must be positive semi-definite'),
        ({'pose_covariance': np.triu(np.ones((6, 6)))}, 'pose_covariance: must be symmetric'),
        ({'plane': np.ones(SHAPE, np.uint8)}, 'plane_covariance: must be given where plane is'),
        ({'plane_covariance': np.eye(3)}, 'plane: must be given where plane_covariance is'),
        ({**two_planes(), 'plane': np.ones(SHAPE)}, 'plane: must be uint8'),
        ({**two_planes(), 'plane_covariance': np.eye(3)}, r'must be numbers \(6, 6\)'),
        (
            {**two_planes(), 'plane_names': np.array(['wall'])},
            r'plane_names: must be strings \(2,',
        ),
    ],
)
def test_impossible_ground_truth_is_refused(arrays, message, tmp_path):
    path = write(tmp_path / 'one.npz', **arrays)
    reason = check(path, None)
    assert isinstance(reason, str)
    assert reason.startswith(f'{path}: ')
    with pytest.raises(InputError, match=message):
        raise InputError(reason)


def test_planes_of_a_scene_that_moves_are_refused(tmp_path):
    moving = SLANTED + 0.1 * np.arange(4, dtype=np.float32)[:, None, None]
    path = write(tmp_path / 'one.npz', clean_depth=moving, **two_planes())
    with pytest.raises(InputError, match='plane: must come with the clean_depth'):
        read(Found(path, MODE, ()), None)


def test_unknown_pixels_are_filled_and_not_compared(tmp_path):
    known = np.ones(SHAPE, bool)
    known[10:30, 20:30] = False
    known[5, 50] = False
    path = write(tmp_path / 'one.npz', clean_depth=np.where(known, SLANTED, np.nan), known=known)
    recording = read(Found(path, MODE, ()), None)
    assert recording.clean == pytest.approx(SLANTED, rel=1e-4)
    scene = look_at(
        recording.clean, None, 0.0, None, K, MODE, axes_of(flexx2()), known=recording.truth.known
    )
    assert not scene.inside[5:35, 15:35].any()  # An object may be there: its edges reach 5 px.
    assert not scene.inside[4:7, 49:52].any()
    assert scene.inside[5, 48]  # But nothing hides in a single pixel.
    assert np.isnan(scene.clean[~known]).all()
    # Neither edges nor places without a return.
    named = {name: (axis.start, axis.start + axis.bins) for name, axis in AXES.items()}
    for name in ('edge', 'beyond'):
        low, high = named[name]
        assert not ((scene.runs[:, 2] >= low) & (scene.runs[:, 2] < high)).any()


def test_known_pixels_without_a_return_stay_without():
    known = np.ones(SHAPE, bool)
    known[:, 30:40] = False
    clean = np.where(known & (U < 35), SLANTED, np.float32(np.nan))
    filled = fill(clean, known, MODE.sensor)
    assert np.isfinite(filled[:, :35]).all()
    assert np.isnan(filled[:, 35:]).all()
    scene = look_at(filled, None, 0.0, None, K, MODE, axes_of(flexx2()), known=known)
    beyond = scene.runs[scene.runs[:, 2] == AXES['beyond'].start]
    assert len(beyond)
    assert (beyond[:, 0] >= 45).all()


@pytest.mark.parametrize('distortion', [(), (-0.2, 0.05, 0.001, -0.001)])
def test_the_parameters_of_a_plane_move_it(distortion):
    """Assert them against the plane's equation: an offset, and turns about the mean point."""
    known, plane = np.ones(SHAPE, bool), np.ones(SHAPE, np.uint8)
    lens = Intrinsics.from_matrix(K, SHAPE[1], SHAPE[0], distortion)
    rays = np.stack([*pixel_rays(lens), np.ones(SHAPE)], axis=-1)
    slanted = 1 / (rays @ np.array([0.1, 0.3, 0.8]))
    shifts = plane_shifts(slanted, plane, lens, 1, known)
    points = (rays * slanted[..., None]).reshape(-1, 3)
    centre = points.mean(axis=0)
    normal = np.linalg.solve(points.T @ points, points.sum(axis=0))
    normal /= np.linalg.norm(normal)
    first = np.array([1.0, 0, 0]) - normal[0] * normal
    first /= np.linalg.norm(first)
    step = 1e-3
    moved = [(normal @ centre + step) / (rays @ normal)]
    for axis in (first, np.cross(normal, first)):
        turned = normal + step * np.cross(axis, normal)
        moved.append(turned @ centre / (rays @ turned))
    for there, shift in zip(moved, shifts, strict=True):
        assert (there - slanted) / step == pytest.approx(shift, abs=5e-3)


def test_the_prior_of_a_pose_and_planes():
    assert covariance_of(Truth()) is None
    planes = Truth(**two_planes())
    covariance = covariance_of(planes)
    # Planes are given in the camera's frame: its pose has no error besides.
    assert not covariance[:6].any()
    assert covariance[6, 6] == pytest.approx(0.003**2)
    pose = covariance_of(Truth(pose_covariance=np.radians(1) ** 2 * np.eye(6)))
    assert pose[3, 3] == pytest.approx(1.0)  # degrees
    whole = factor(covariance)
    assert whole @ whole.T == pytest.approx(covariance)
