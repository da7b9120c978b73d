"""Incidence angles and depth jumps, against scenes whose answer is known."""

import math

from flexx2_sim_ros.camera import depth_from_z_buffer, flexx2, Intrinsics, ray_length
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.surface import analyse, tangents
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
import numpy as np
import pytest

FLEXX2 = flexx2().intrinsics
CAMERAS = [
    FLEXX2,
    Intrinsics(640, 480, 554.0, 560.0, 319.5, 239.5),
    Intrinsics(57, 33, 40.0, 75.0, 5.0, 30.0),
    Intrinsics(64, 48, 90.0, 60.0, -20.0, 70.0),
]
# Planes through (0, 0, 1.5 m), by the slopes of their normal: level, a yaw, a pitch, both, steep.
SLOPES = [(0, 0), (0.6, 0), (0, -0.8), (1, 1), (-1.7, 0.5), (0.4, 4)]


def plane(camera, normal, distance):
    """Return depth and incidence of the plane normal . X = distance; NaN where it is unseen."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    rays = np.stack([x, y, np.ones_like(u)], axis=-1)
    facing = rays @ (normal / np.linalg.norm(normal))
    cosine = np.abs(facing) / np.linalg.norm(rays, axis=-1)
    depth = np.where(facing * distance > 0, distance / facing, np.nan)
    return depth, np.arccos(np.clip(cosine, 0, 1))


def tilted(slopes, distance=1.5, camera=FLEXX2):
    normal = np.array([*slopes, 1.0])
    return plane(camera, normal, distance / np.linalg.norm(normal))


def look(depth, camera=FLEXX2):
    return analyse(np.ascontiguousarray(depth, np.float32), camera, flexx2().sensor)


def worst(surface, truth, where):
    """Return the largest error of the incidence angle, degrees."""
    return math.degrees(np.abs(surface.incidence - truth)[where].max(initial=0))


def borders(labels):
    """Return where neighbours in a row, and in a column, have different labels."""
    rows, columns = np.zeros((2, *labels.shape), np.uint8)
    rows[:, :-1] = labels[:, 1:] != labels[:, :-1]
    columns[:-1] = labels[1:] != labels[:-1]
    return rows, columns


def assert_jumps(surface, labels):
    """Assert that jumps are where neighbours have different labels, and nowhere else."""
    rows, columns = borders(labels)
    np.testing.assert_array_equal(surface.row_jumps, rows)
    np.testing.assert_array_equal(surface.column_jumps, columns)


def thin(labels):
    """Return which pixels lie in a row's or column's run of one or two pixels of one label."""
    padded = np.pad(labels.astype(np.int8), 2, constant_values=-1)
    height, width = labels.shape
    out = np.zeros(labels.shape, bool)
    for dy, dx in ((0, 1), (1, 0)):
        before2, before, after, after2 = (
            padded[2 + k * dy : 2 + k * dy + height, 2 + k * dx : 2 + k * dx + width] == labels
            for k in (-2, -1, 1, 2)
        )
        out |= ~((before2 & before) | (before & after) | (after & after2))
    return out


@pytest.mark.parametrize('camera', CAMERAS, ids=lambda camera: f'{camera.width}')
@pytest.mark.parametrize('seed', range(8))
def test_planes_up_to_80_degrees(camera, seed):
    rng = np.random.default_rng(seed)
    # The angle at a pixel drawn from the whole image, the direction at random.
    x = (rng.uniform(0, camera.width) - camera.cx) / camera.fx
    y = (rng.uniform(0, camera.height) - camera.cy) / camera.fy
    ray = np.array([x, y, 1.0])
    ray /= np.linalg.norm(ray)
    angle, aside = math.radians(10 * seed + 10), np.cross(ray, rng.normal(size=3))
    normal = math.cos(angle) * ray + math.sin(angle) * aside / np.linalg.norm(aside)
    depth, truth = plane(camera, normal, rng.uniform(0.3, 5) * math.cos(angle))
    seen = (truth < math.radians(80)) & (depth < 20)
    assert seen.sum() > 100
    surface = look(np.where(seen, depth, np.nan), camera)
    assert_jumps(surface, seen)
    assert worst(surface, truth, seen & ~thin(seen)) < 1


@pytest.mark.parametrize('slopes', SLOPES)
def test_tangents_of_planes(slopes):
    depth, truth = tilted(slopes)
    seen = (truth < math.radians(80)) & (depth < 20)
    image = np.where(seen, depth, np.nan).astype(np.float32)
    inverse, *found = tangents(image, flexx2().sensor)
    inside = seen & ~thin(seen)
    np.testing.assert_array_equal(inverse[2:-2, 2:-2][inside], 1 / image[inside])
    # Inverse depth is (slopes . (x/z, y/z) + 1) / 1.5 m.
    for one, slope, focal in zip(found, slopes, (FLEXX2.fx, FLEXX2.fy), strict=True):
        np.testing.assert_allclose(one[inside], slope / focal / 1.5, atol=2e-6)


@pytest.mark.parametrize('distance', [1.0, 2.0, 4.0])
@pytest.mark.parametrize('slopes', SLOPES)
def test_planes_in_whole_millimetres(slopes, distance):
    """Rounding to 1 mm moves single angles by degrees; what is made of them, sigma_z, hardly."""
    depth, truth = tilted(slopes, distance)
    seen = (truth < math.radians(80)) & (depth > 0.5) & (depth < 7)
    surface = look(np.where(seen, np.rint(depth * 1000) / 1000, np.nan))
    assert_jumps(surface, seen)
    inside = seen & ~thin(seen)
    for mode in flexx2().modes:
        ratio = mode.noise.sigma_z(depth[inside], surface.incidence[inside]) / mode.noise.sigma_z(
            depth[inside], truth[inside]
        )
        assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.01)
        assert np.abs(ratio - 1).max() < 0.25


V, U = np.mgrid[:172, :224]
SHAPES = {
    'upright': U < 100,
    'level': V < 90,
    'diagonal': U + V < 200,
    'other': U - V < 33,
    'slanted': 3 * U + V < 400,
    'disc': np.hypot(U - 110.3, V - 80.2) < 50.4,
}


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize(('front', 'back'), [(0, 1), (1, 0), (3, 1), (2, 4), (4, 2), (5, 0)])
def test_slopes_are_not_computed_across_a_jump(shape, front, back):
    near, near_truth = tilted(SLOPES[front], 1.0)
    far, far_truth = tilted(SLOPES[back], 3.0)
    mask = SHAPES[shape]
    truth = np.where(mask, near_truth, far_truth)
    depth = np.where(mask, near, far)
    # Both surfaces in view, clearly apart.
    valid = np.isfinite(near) & np.isfinite(far) & (truth < math.radians(80)) & (near < 7)
    valid &= (far < 7) & (np.fmax(near, far) / np.fmin(near, far) > 1.05)
    labels = np.where(valid, mask, 2)
    surface = look(np.where(valid, depth, np.nan))
    rows, columns = borders(labels)
    clear = valid & ~thin(labels)
    for found, wanted in ((surface.row_jumps, rows), (surface.column_jumps, columns)):
        assert not ((found != wanted) & (clear | (wanted != 0))).any()
    assert valid.sum() > 5000
    assert worst(surface, truth, clear) < 1


# One pixel half-way between two surfaces is left out: it looks the same as a steep one.
STRIPS = [
    (2, 1, 2),
    (1, 2, 1),
    (2, 1.94, 2),
    (1, 1.05, 1),
    (1, 1.5, 2),
    (2, 1, math.nan),
    (math.nan, 1, math.nan),
]


@pytest.mark.parametrize(
    ('width', 'depths'),
    [
        *((width, depths) for width in (1, 2, 3) for depths in STRIPS),
        *((width, (1, 1.04, 1.08)) for width in (2, 3)),
    ],
)
def test_thin_strips(width, depths):
    line = np.repeat(depths, (20, width, 20))
    labels = np.repeat([0, 1, 2], (20, width, 20))
    for turned in (False, True):
        depth, where = np.tile(line, (9, 1)), np.tile(labels, (9, 1))
        depth, where = (depth.T, where.T) if turned else (depth, where)
        height, columns = depth.shape
        surface = look(depth, Intrinsics(columns, height, 210.0, 210.0, columns / 2, height / 2))
        assert_jumps(surface, where)
        v, u = np.mgrid[:height, :columns]
        off_axis = np.arctan(np.hypot(v - height / 2, u - columns / 2) / 210)
        assert worst(surface, off_axis, np.isfinite(depth)) < 1


@pytest.mark.parametrize(('one', 'two'), [(0, 1), (0, 3), (1, 4), (3, 4), (2, 5)])
@pytest.mark.parametrize('fold', [np.fmin, np.fmax])
def test_creases_are_not_taken_for_jumps(one, two, fold):
    first, first_truth = tilted(SLOPES[one])
    second, second_truth = tilted(SLOPES[two])
    valid = np.isfinite(first) & np.isfinite(second) & (first < 7) & (second < 7)
    depth = np.where(valid, fold(first, second), np.nan)
    surface = look(depth)
    assert_jumps(surface, valid)
    on_first = depth == first
    truth = np.where(on_first, first_truth, second_truth)
    assert worst(surface, truth, valid & ~thin(np.where(valid, on_first, 2))) < 12
    clear = valid.copy()
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            clear &= np.roll(on_first, step, axis) == on_first
            clear &= np.roll(valid, step, axis)
    assert worst(surface, truth, clear) < 1


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    npst.arrays(
        np.float32,
        npst.array_shapes(min_dims=2, max_dims=2, max_side=9),
        elements=st.floats(width=32) | st.sampled_from([np.nan, 1.0, 1.01, 2.0]),
    ),
    st.floats(1.0, 1e4),
    st.floats(-1e4, 1e4),
)
def test_any_image_is_analysed_without_an_error(depth, focal, centre):
    height, width = depth.shape
    surface = look(depth, Intrinsics(width, height, focal, 2 * focal, centre, -centre))
    assert ((surface.cos_incidence >= 0) & (surface.cos_incidence <= 1)).all()
    assert np.isfinite(surface.inverse_depth).all()
    assert max(surface.row_jumps.max(), surface.column_jumps.max()) <= 1
    assert not (surface.row_jumps[:, -1].any() | surface.column_jumps[-1].any())


@pytest.mark.parametrize(('near', 'far'), [(0.01, 50.0), (0.1, 5.0), (0.02, 1000.0)])
def test_a_z_buffer_becomes_depth(near, far):
    z = np.linspace(near, min(far, 7.0), 20, dtype=np.float32).reshape(4, 5)
    # What OpenGL writes for a surface at depth z, in single precision.
    x = (far + near - 2 * far * near / z.astype(float)) / (far - near)
    buffer = ((x + 1) / 2).clip(0, 1).astype(np.float32)
    buffer[0, -1] = 1.0
    depth = depth_from_z_buffer(buffer, near, far)
    assert depth.dtype == np.float32
    assert np.isnan(depth[0, -1])
    step = 2.0**-24 * z**2 / near * (1 + near / far)  # half of what the buffer can tell apart
    off = np.abs(depth - z)[np.isfinite(depth)]
    assert (off <= 1.1 * step[np.isfinite(depth)] + 1e-6).all()


@pytest.mark.parametrize(
    ('buffer', 'near', 'far', 'said'),
    [
        ([[0.5]], 1.0, 1.0, 'near, far: must be 0 < near < far'),
        ([[0.5]], 0.0, 1.0, 'near, far: must be 0 < near < far'),
        ([[0.5]], 0.1, np.inf, 'near, far: must be 0 < near < far'),
        ([[1.5]], 0.1, 10.0, 'buffer: must be a z-buffer'),
        ([[-0.1]], 0.1, 10.0, 'buffer: must be a z-buffer'),
        ([[np.nan]], 0.1, 10.0, 'buffer: must be a z-buffer'),
    ],
)
def test_a_z_buffer_is_refused(buffer, near, far, said):
    with pytest.raises(InputError, match=said):
        depth_from_z_buffer(buffer, near, far)


@pytest.mark.parametrize('camera', CAMERAS)
def test_a_range_becomes_depth(camera):
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    ranges = 1.5 * np.sqrt(x**2 + y**2 + 1)
    np.testing.assert_allclose(ranges / ray_length(camera.matrix, u.shape), 1.5, rtol=1e-6)
