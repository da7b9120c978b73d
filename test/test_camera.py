"""The camera as a whole: what its users rely on."""

import doctest
import math

from boards import board, K
from flexx2_sim_ros.camera import Camera, flexx2, pipeline
from flexx2_sim_ros.camera.philox import camera_key, fill_normals, stamp_words, STREAM_AXIAL
from flexx2_sim_ros.errors import InputError
import numpy as np
import pytest

FIELDS = ('depth', 'sigma', 'amplitude', 'confidence')
MEASURED = ('Mode_5_30fps', 'Mode_5_60fps', 'Mode_9_30fps')
SHAPE = (24, 32)
REACH = 9  # pixels: five standard deviations of the largest sigma_x


def normals(shape: tuple, seed: int, name: str, stamp_ns: int) -> np.ndarray:
    out = np.empty(math.prod(shape), np.float32)
    fill_normals(camera_key(seed, name), *stamp_words(stamp_ns), STREAM_AXIAL, out)
    return out.reshape(shape)


def scene() -> np.ndarray:
    """Return a small scene with an edge, a slant and a hole."""
    depth = np.linspace(1.0, 1.3, SHAPE[1]) * np.ones(SHAPE)
    depth[6:18, 10:22] = 0.8
    depth[:4, 25:] = np.nan
    return depth


def assert_same(one: pipeline.Frame, other: pipeline.Frame) -> None:
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), field)


@pytest.mark.parametrize('turn', ['yaw', 'pitch'])
@pytest.mark.parametrize('angle', [0, 20, 45, 60, 75])
@pytest.mark.parametrize('usecase', MEASURED)
def test_slanted_planes_get_axial_noise_and_nothing_else(usecase: str, angle: int,
                                                         turn: str) -> None:
    target = board(1.0, angle, turn=turn)
    frame = Camera(usecase, seed=2, name='n').capture(target.depth, K, -5)
    mode = flexx2().mode(usecase)
    seen = (target.depth > 0.5) & (target.incidence < math.radians(80))
    seen &= target.depth + 7 * mode.noise.sigma_z(target.depth, target.incidence) < mode.range_max
    assert seen.sum() > 10_000
    noise = frame.depth - target.depth
    wanted = frame.sigma * normals(target.depth.shape, 2, 'n', -5)
    np.testing.assert_allclose(noise[seen], wanted[seen], rtol=0, atol=1e-6)
    model = mode.noise.sigma_z(target.depth, target.incidence)
    np.testing.assert_allclose(frame.sigma[seen], model[seen], rtol=5e-3)
    cosine = np.cos(target.incidence)
    np.testing.assert_allclose(frame.amplitude[seen], (cosine / target.depth ** 2)[seen],
                               rtol=5e-3)


V, U = np.mgrid[:172, :224]


@pytest.mark.parametrize('usecase', MEASURED)
@pytest.mark.parametrize('edge', [0, 20, 45, 70, 90, -45, 'board', 'disc', 'strip'])
def test_edge_pixels_show_one_of_the_two_surfaces(usecase: str, edge: object) -> None:
    front = board(1.0, 30).depth
    angle = math.radians(edge) if isinstance(edge, int) else 0
    mask = {'board': (abs(U - 110) < 40) & (abs(V - 80) < 30), 'strip': abs(U - 100) < 2,
            'disc': np.hypot(U - 110, V - 80) < 50}.get(
                edge, (U - 111.5) * math.cos(angle) + (V - 85) * math.sin(angle) < 0)
    clean = np.where(mask, front, np.float32(2.1))
    camera = Camera(usecase, seed=9)
    moved = 0
    for stamp in range(20):
        frame = camera.capture(clean, K, stamp)
        valid = np.isfinite(frame.depth)
        assert valid.mean() > 0.99  # Mode_5: noise beyond 2.4 m
        seen = frame.depth - frame.sigma * normals(clean.shape, 9, '', stamp)
        own = np.abs(seen - clean) < 1e-5
        other = np.zeros_like(own)
        for shift in range(-REACH, REACH + 1):
            for axis in (0, 1):
                source = np.roll(clean, shift, axis)
                other |= (np.abs(seen - source) < 1e-5) & (np.roll(mask, shift, axis) != mask)
        assert (own | other | ~valid).all()
        moved += (other & ~own & valid).sum()
    assert moved > 20 * 90


@pytest.mark.parametrize('turned', [False, True])
def test_edges_move_alone_and_thin_things_as_a_whole(turned: bool) -> None:
    """Correlations beyond 6 standard errors of n samples: false failure 2e-9 each."""
    clean = np.full((60, 120), 2.0)
    clean[:, 20:24] = 1.0  # a pole
    clean[:, 60:90] = 1.0  # a board
    frames = Camera('Mode_9_30fps', seed=3).capture(
        clean.T if turned else clean, K, np.arange(400)).depth
    near = (np.swapaxes(frames, 1, 2) if turned else frames) < 1.5
    pole, left, right = near[..., :40], near[..., 40:75], near[..., 75:]
    assert (pole.sum(-1) == 4).all()
    pole_shift = pole.argmax(-1) - 20.0
    left_shift, right_shift = left.argmax(-1) - 20.0, right.sum(-1) - 15.0
    shifts = [pole_shift, left_shift, right_shift]
    for shift in shifts:
        assert shift.std() == pytest.approx(1.649, rel=0.03)  # 6.5 standard errors
        assert abs(shift.mean()) < 6 * 1.649 / math.sqrt(shift.size)
    pairs = [(one, other) for i, one in enumerate(shifts) for other in shifts[:i]]
    pairs += [(shift[:, 1:], shift[:, :-1]) for shift in shifts]  # lines
    pairs += [(shift[1:], shift[:-1]) for shift in shifts]  # frames
    for one, other in pairs:
        correlation = np.corrcoef(one.ravel(), other.ravel())[0, 1]
        assert abs(correlation) < 6 / math.sqrt(one.size)


def test_noise_is_a_function_of_seed_name_and_stamp_alone() -> None:
    camera = Camera('Mode_9_30fps', seed=4, name='left')
    stamps = np.array([0, 7, 10 ** 18, -3, 2 ** 33])
    batch = camera.capture(scene(), K, stamps)
    assert batch.depth.shape == (5, *SHAPE)
    singles = [camera.capture(scene(), K, int(stamp)) for stamp in reversed(stamps)][::-1]
    scenes = np.stack([scene() + 0.01 * i for i in range(3)])
    wide = camera.capture(scenes[:, None], K, stamps)
    assert wide.depth.shape == (3, 5, *SHAPE)
    back = Camera('mode_9_30FPS', seed=4, name='left').capture(scenes[::-1, None], K, stamps[::-1])
    for field in FIELDS:
        values = getattr(batch, field)
        np.testing.assert_array_equal(values, [getattr(single, field) for single in singles])
        np.testing.assert_array_equal(getattr(wide, field)[0], values)
        np.testing.assert_array_equal(getattr(back, field)[::-1, ::-1], getattr(wide, field))
    for other in (Camera('Mode_9_30fps', seed=5, name='left'), Camera(seed=4, name='right')):
        noise = other.capture(scene(), K, 0).depth - scene()
        assert not np.isclose(noise, singles[0].depth - scene(), atol=1e-7).any()


def test_arguments_broadcast() -> None:
    camera = Camera(seed=1)
    matrices = np.stack([K, K * [[2, 1, 1], [1, 2, 1], [1, 1, 1]]])
    shades = np.stack([np.full(SHAPE, 0.2), np.full(SHAPE, 0.9), np.ones(SHAPE)])[:, None, None]
    all_of = camera.capture(scene(), matrices, np.arange(4)[:, None], shades)
    assert all_of.depth.shape == (3, 4, 2, *SHAPE)
    assert all_of.K.dtype == np.float64
    for i, j, k in np.ndindex(3, 4, 2):
        one = camera.capture(scene(), matrices[k], j, shades[i, 0, 0])
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(all_of, field)[i, j, k], getattr(one, field))
    assert camera.capture(np.ones((0, *SHAPE)), K, 0).depth.shape == (0, *SHAPE)


def test_stamps_in_nanoseconds_and_in_seconds() -> None:
    camera = Camera(seed=1)
    for seconds, nanoseconds in ((1.5, 1_500_000_000), (-0.25, -250_000_000), (1e-9, 1),
                                 (np.float32(2.0), np.uint64(2 * 10 ** 9)), (3.0, np.int16(0))):
        equal = int(nanoseconds) == round(float(seconds) * 1e9)
        one, other = (camera.capture(scene(), K, stamp) for stamp in (seconds, nanoseconds))
        assert np.array_equal(one.depth, other.depth, equal_nan=True) == equal


def test_the_docstrings_example_runs() -> None:
    result = doctest.testmod(pipeline)
    assert result.attempted >= 5
    assert result.failed == 0
