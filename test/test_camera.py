"""The camera as a whole: what its users rely on."""

import doctest
import math

from boards import board, K
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.camera import camera as pipeline
from flexx2_sim_ros.camera.frame import gray_image
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.philox import camera_key, fill_normals, stamp_words, STREAM_AXIAL
import numpy as np
import pytest
from small_scenes import FIELDS, same

MEASURED = ('Mode_5_30fps', 'Mode_5_60fps', 'Mode_9_30fps')
SHAPE = (24, 32)
REACH = 9  # pixels: five standard deviations of the largest sigma_x


def normals(shape, seed, name, stamp_ns):
    out = np.empty(math.prod(shape), np.float32)
    fill_normals(camera_key(seed, name), *stamp_words(stamp_ns), STREAM_AXIAL, out)
    return out.reshape(shape)


def scene():
    """Return a small scene with an edge, a slant and a hole."""
    depth = np.linspace(1.0, 1.3, SHAPE[1]) * np.ones(SHAPE)
    depth[6:18, 10:22] = 0.8
    depth[:4, 25:] = np.nan
    return depth


@pytest.mark.parametrize('turn', ['yaw', 'pitch'])
@pytest.mark.parametrize('angle', [0, 75])
@pytest.mark.parametrize('usecase', MEASURED)
def test_slanted_planes_get_axial_noise_and_nothing_else(usecase, angle, turn):
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
    np.testing.assert_allclose(frame.amplitude[seen], (cosine / target.depth**2)[seen], rtol=5e-3)


V, U = np.mgrid[:172, :224]


@pytest.mark.parametrize(
    ('usecase', 'edge'),
    [
        *(('Mode_9_30fps', edge) for edge in (0, 20, 90, -45, 'disc', 'strip')),
        ('Mode_5_30fps', 'disc'),
    ],
)
def test_edge_pixels_show_one_of_the_two_surfaces(usecase, edge):
    front = board(1.0, 30).depth
    angle = math.radians(edge) if isinstance(edge, int) else 0
    mask = {'strip': abs(U - 100) < 2, 'disc': np.hypot(U - 110, V - 80) < 50}.get(
        edge, (U - 111.5) * math.cos(angle) + (V - 85) * math.sin(angle) < 0
    )
    clean = np.where(mask, front, np.float32(2.1))
    camera = Camera(usecase, seed=9)
    sigmas = [camera.capture(depth, K, 0).sigma for depth in (front, np.full_like(front, 2.1))]
    moved = 0
    for stamp in range(8):
        frame = camera.capture(clean, K, stamp, np.where(mask, 1.0, 0.2))
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
        # What is seen brings its own sigma and its own reflectivity.
        behind = seen > 1.9
        np.testing.assert_allclose(
            frame.sigma[valid], np.where(behind, *sigmas[::-1])[valid], rtol=0.15
        )
        assert ((frame.amplitude * seen**2 > 0.3) ^ behind)[valid].all()
    assert moved > 8 * 90


@pytest.mark.parametrize('turned', [False, True])
def test_edges_move_alone_and_thin_objects_as_a_whole(turned):
    """Correlations beyond 6 standard errors of n samples: false failure 2e-9 each."""
    clean = np.full((60, 120), 2.0)
    clean[:, 20:24] = 1.0  # a pole
    clean[:, 60:90] = 1.0  # a board
    frames = (
        Camera('Mode_9_30fps', seed=3)
        .capture(clean.T if turned else clean, K, np.arange(400))
        .depth
    )
    near = (np.swapaxes(frames, 1, 2) if turned else frames) < 1.5
    pole, left, right = near[..., :40], near[..., 40:75], near[..., 75:]
    assert (pole.sum(-1) == 4).all()
    pole_shift = pole.argmax(-1) - 20.0
    left_shift, right_shift = left.argmax(-1) - 20.0, right.sum(-1) - 15.0
    shifts = [pole_shift, left_shift, right_shift]
    for shift in shifts:
        assert shift.std() == pytest.approx(1.649, rel=0.03)  # 6.5 standard errors
        assert 6 <= np.abs(shift).max() <= REACH  # 20 of 24,000 reach 6: all miss it at 1e-9
        assert abs(shift.mean()) < 6 * 1.649 / math.sqrt(shift.size)
    pairs = [(one, other) for i, one in enumerate(shifts) for other in shifts[:i]]
    pairs += [(shift[:, 1:], shift[:, :-1]) for shift in shifts]  # lines
    pairs += [(shift[1:], shift[:-1]) for shift in shifts]  # frames
    for one, other in pairs:
        correlation = np.corrcoef(one.ravel(), other.ravel())[0, 1]
        assert abs(correlation) < 6 / math.sqrt(one.size)


def test_noise_is_a_function_of_seed_name_and_stamp_alone():
    camera = Camera('Mode_9_30fps', seed=4, name='left')
    stamps = np.array([0, 7, 10**18, -3, 2**33])
    batch = camera.capture(scene(), K, stamps)
    assert batch.depth.shape == (5, *SHAPE)
    singles = [camera.capture(scene(), K, int(stamp)) for stamp in reversed(stamps)][::-1]
    for field in FIELDS:
        wanted = [getattr(single, field) for single in singles]
        np.testing.assert_array_equal(getattr(batch, field), wanted)
    again = Camera('mode_9_30FPS', seed=4, name='left')
    assert same(again.capture(scene(), K, int(stamps[1])), singles[1])
    for other in (Camera('Mode_9_30fps', seed=5, name='left'), Camera(seed=4, name='right')):
        noise = other.capture(scene(), K, 0).depth - scene()
        assert not np.isclose(noise, singles[0].depth - scene(), atol=1e-7).any()


def test_arguments_broadcast():
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


def test_stamps_in_nanoseconds_and_in_seconds():
    camera = Camera(seed=1)
    for seconds, nanoseconds in (
        (1.5, 1_500_000_000),
        (-0.25, -250_000_000),
        (1e-9, 1),
        (np.float32(2.0), np.uint64(2 * 10**9)),
        (3.0, np.int16(0)),
    ):
        equal = int(nanoseconds) == round(float(seconds) * 1e9)
        one, other = (camera.capture(scene(), K, stamp) for stamp in (seconds, nanoseconds))
        assert same(one, other) == equal


@pytest.mark.parametrize('usecase', ['Mode_5_30fps', 'Mode_9_30fps'])
def test_depth_outside_the_range_is_invalid_before_and_after_the_noise(usecase):
    mode = flexx2().mode(usecase)
    for limit, outside in ((mode.range_min, -1e-3), (mode.range_max, 1e-3)):
        frame = Camera(usecase).capture(np.full(SHAPE, limit + outside), K, 0)
        assert np.isnan(frame.depth).all()
        frame = Camera(usecase).capture(np.full(SHAPE, limit), K, 0)
        invalid = np.isnan(frame.depth)
        assert 0.25 < invalid.mean() < 0.75  # half of 768 pixels: 13 standard deviations
        depth = frame.depth[~invalid]
        assert ((depth >= mode.range_min - 1e-6) & (depth <= mode.range_max + 1e-6)).all()
        assert np.isnan(frame.sigma[invalid]).all()
        assert not np.stack([frame.amplitude, frame.confidence])[:, invalid].any()
        assert ((frame.confidence >= 0) & (frame.confidence <= 1)).all()


@pytest.mark.parametrize(
    'nothing', [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-45, 1e-9, 1e10, 3.4e38, 1e39, 1e300]
)
def test_depth_that_is_not_a_distance_is_invalid(nothing):
    clean = np.full(SHAPE, 1.0)
    clean[12, 16] = clean[3:5, 3:5] = nothing
    frame = Camera(seed=3).capture(clean, K, 0)
    # The holes' edges move as one, so that all of them stay.
    assert np.isnan(frame.depth).sum() == np.isnan(frame.sigma).sum() == 5
    assert not frame.amplitude[np.isnan(frame.depth)].any()
    assert np.isfinite(frame.amplitude).all()
    assert np.isfinite(frame.confidence).all()


def test_inputs_of_any_number_type_are_read_and_not_changed():
    clean = np.repeat([[2.0, 4.0], [3.0, 2.5]], 12, axis=1).repeat(9, axis=0)
    whole = np.rint(clean)
    shade = np.linspace(0, 1, clean.size).reshape(clean.shape)
    for values, copies in (
        (
            clean,
            [clean.astype(kind) for kind in ('f2', '>f4', 'f8', '>f8', 'g')]
            + [
                np.asfortranarray(clean),
                clean.repeat(2, 1)[:, ::2],
                clean[::-1].copy()[::-1],
                clean.tolist(),
            ],
        ),
        (whole, [whole.astype(kind) for kind in ('u1', 'i2', '>u2', 'u4', 'i8')]),
    ):
        wanted = Camera(seed=1).capture(values.astype(np.float32), K, 0, shade.astype('f4'))
        for copy in copies:
            if isinstance(copy, np.ndarray):
                copy.flags.writeable = False
            frame = Camera(seed=1).capture(copy, K.tolist(), 0, shade)
            assert same(frame, wanted)
            assert {getattr(frame, field).dtype for field in FIELDS} == {np.dtype(np.float32)}


@pytest.mark.parametrize(('kind', 'nothing'), [('u2', 65535), ('i4', -1)])
def test_whole_millimetres_are_refused(kind, nothing):
    clean = np.full(SHAPE, 1500, kind)
    clean[:8], clean[8:12] = 0, nothing
    with pytest.raises(InputError, match='^clean_depth: must be metres.*millimetres'):
        Camera().capture(clean, K, 0)


def test_masked_pixels_have_no_depth():
    hidden = np.zeros(SHAPE, bool)
    hidden[5:9, 5:9] = True
    for kind in ('f4', 'u1'):
        clean = np.full(SHAPE, 2, kind)
        frame = Camera(seed=1).capture(np.ma.masked_array(clean, hidden), K, 0)
        assert same(frame, Camera(seed=1).capture(np.where(hidden, np.nan, clean), K, 0))


def test_a_channel_axis_is_refused():
    with pytest.raises(InputError, match='^clean_depth: must have shape .* channel axis'):
        Camera().capture(scene()[..., None], K, 0)


def test_reflectivity_scales_the_amplitude_and_is_kept_between_0_and_1():
    full, half, none, bright, unknown = (
        Camera().capture(scene(), K, 0, np.full(SHAPE, value)).amplitude
        for value in (1.0, 0.5, -1.0, 7.0, math.nan)
    )
    np.testing.assert_allclose(half, full / 2, rtol=1e-6)
    np.testing.assert_array_equal(full, Camera().capture(scene(), K, 0).amplitude)
    np.testing.assert_array_equal(bright, full)
    assert not none.any()
    assert not unknown.any()


def matrix_with(row, column, value):
    changed = K.copy()
    changed[row, column] = value
    return changed


GOOD = {'clean_depth': np.ones(SHAPE), 'K': K, 'stamp': 0, 'reflectivity': np.ones(SHAPE)}
BAD = {
    'clean_depth': [3.0, np.ones((0, 5)), np.ones(SHAPE, complex), None, np.ones(SHAPE, bool)],
    'reflectivity': [0.5, np.ones((3, 3)), np.ones(SHAPE, complex)],
    'K': [np.eye(2), K.ravel(), None, K.astype(complex), np.zeros((3, 3)), K * 2, K.T],
    'stamp': [math.nan, 1e12, 2**70, None, 'now', True, 1j],
    'leading': [np.ones((2, *SHAPE))],
}
BAD['clean_depth'] += [np.ones(SHAPE, object), [[1.0, 2.0], [3.0]]]
CHANGES = (0, 0, -210), (1, 1, 0), (0, 0, math.nan), (1, 2, -math.inf), (0, 1, 0.1), (2, 2, 0)
BAD['K'] += [matrix_with(*change) for change in (*CHANGES, (0, 0, 1e-60), (1, 2, 1e60))]


@pytest.mark.parametrize(
    ('field', 'value'), [(field, value) for field, values in BAD.items() for value in values]
)
def test_what_cannot_be_used_is_named(field, value):
    given = {'clean_depth': value, 'stamp': [1, 2, 3]} if field == 'leading' else {field: value}
    with pytest.raises(InputError, match=f'^{field}'):
        Camera().capture(**{**GOOD, **given})


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('usecase', 'Mode_7'),
        ('seed', 'one'),
        ('seed', 1.5),
        ('seed', 2**63),
        ('seed', -(2**63) - 1),
        ('name', 5),
        ('effects', ['blur']),
        *((field, ['x' * 100_000]) for field in ('seed', 'name', 'effects')),
    ],
)
def test_an_impossible_camera_is_refused(field, value):
    """Errors show only the ends of long values."""
    with pytest.raises(InputError, match=f'^{field}') as caught:
        Camera(**{field: value})
    assert len(str(caught.value)) < 500


def test_pixels_are_made_invalid_in_every_image():
    frame = Camera().capture(np.full(SHAPE, 1.5), K, 0)
    where = np.indices(SHAPE).sum(axis=0) % 2 == 0
    frame.make_invalid(where)
    for image in (frame.depth, frame.sigma):
        np.testing.assert_array_equal(np.isnan(image), where)
    for image in (frame.amplitude, frame.confidence):
        np.testing.assert_array_equal(image == 0, where)


def test_the_gray_image_is_the_root_of_the_amplitude():
    amplitude = np.linspace(0.0, 4.0, 400, dtype=np.float32).reshape(20, 20)
    assert gray_image(np.zeros((4, 4), np.float32), None, 2.0).max() == 0
    whole = gray_image(amplitude, 1.0, 4.0)
    assert whole[0, 0] == 0
    assert whole[-1, -1] == 255
    assert int(whole[5, 0]) == pytest.approx(255 * math.sqrt(amplitude[5, 0] / 4.0), abs=0.51)
    # Automatic: as long as is allowed, but at most one pixel in a hundred is white for good.
    assert np.array_equal(gray_image(amplitude, None, 8.0), gray_image(amplitude, 1.0, 8.0))
    automatic = gray_image(amplitude, None, 1.0)
    assert 1 <= (automatic == 255).sum() <= 8
    assert automatic.ravel()[-8] < 255


def test_the_docstrings_example_runs():
    result = doctest.testmod(pipeline)
    assert result.attempted >= 5
    assert result.failed == 0
