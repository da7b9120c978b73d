"""What each pixel of a clean frame is like: the axes along which a gap is looked for."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.camera.axial import model_sigma
from flexx2_sim_ros.camera.intrinsics import Intrinsics
from flexx2_sim_ros.camera.modes import camera_config, Mode
from flexx2_sim_ros.camera.surface import analyse, PAD
from numba import njit
import numpy as np

TILE_ROWS, TILE_COLUMNS = 22, 28
FINE_STEP = 0.06  # metres; a fourth harmonic at 80 MHz has a period of 0.47 m
FINE_BINS = 64
EDGE_REACH = 3  # pixels from a jump that are looked at as edges
NEAR = 5  # pixels from a jump that are not looked at as surfaces: lateral noise gets there


@dataclass(frozen=True)
class Axis:
    """
    One covariate and its bins.

    Attributes
    ----------
    name, unit : str
    edges : tuple of float
        Between bins, one fewer than there are; empty where bins are classes.
    bins : int
    start : int
        Index of its first bin among those of all axes.
    full : bool
        Whether all channels are looked at along it; otherwise bias and invalid pixels only.

    """

    name: str
    unit: str
    edges: tuple[float, ...]
    bins: int
    start: int
    full: bool


def _axes() -> dict[str, Axis]:
    log = tuple(float(x) for x in np.round(np.geomspace(0.3, 5.6, 11), 3))
    table: list[tuple[str, str, tuple[float, ...], int, bool]] = [
        ('all', '', (), 1, True),
        ('distance', 'm', log, 12, True),
        ('incidence', 'deg', (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 68.0, 75.0), 9, True),
        ('radius', '', (0.2, 0.4, 0.55, 0.7, 0.85), 6, True),
        ('region', '', (), 12, True),
        ('edge', '', (), 16, True),
        ('log_amplitude', 'ln 1/m^2', tuple(-6.0 + 0.75 * i for i in range(13)), 14, True),
        ('concavity', '', (-0.02, -0.005, 0.005, 0.02, 0.05), 6, True),
        ('speed', 'm/s', (-0.8, -0.4, -0.15, -0.03, 0.03, 0.15, 0.4, 0.8), 9, True),
        ('beyond', '', (), 2, False),
        ('fine_distance', 'm', tuple(FINE_STEP * i for i in range(1, FINE_BINS)), FINE_BINS,
         False),
        ('tile', '', (), TILE_ROWS * TILE_COLUMNS, False),
    ]
    axes, start = {}, 0
    for name, unit, edges, bins, full in table:
        axes[name] = Axis(name, unit, edges, bins, start, full)
        start += bins
    return axes


AXES = _axes()
BINS = sum(axis.bins for axis in AXES.values())


@dataclass(frozen=True)
class Scene:
    """
    The covariates of one clean frame.

    Attributes
    ----------
    bins : numpy.ndarray
        (H, W, A) int16, for each axis the pixel's bin among all, -1 for none.
    sigma : numpy.ndarray
        (H, W) float32, the base model's sigma_z, metres.
    clean : numpy.ndarray
        (H, W) float32, NaN where the mode sees nothing.
    inside : numpy.ndarray
        (H, W) bool, surfaces away from jumps.

    """

    bins: np.ndarray
    sigma: np.ndarray
    clean: np.ndarray
    inside: np.ndarray


def look_at(clean: np.ndarray, before: np.ndarray | None, interval: float,
            reflectivity: np.ndarray | None, K: np.ndarray, mode: Mode) -> Scene:  # noqa: N803
    """
    Sort a frame's pixels along all axes.

    Parameters
    ----------
    clean : numpy.ndarray
        (H, W) float32 metres.
    before : numpy.ndarray or None
        The frame before it, if the scene moves.
    interval : float
        Seconds between the two.
    reflectivity : numpy.ndarray or None
        (H, W) in 0..1.
    K : numpy.ndarray
        (3, 3) camera matrix.
    mode : Mode
        For its range and noise.

    Returns
    -------
    Scene

    """
    height, width = clean.shape
    lens = Intrinsics.from_matrix(K, width, height)
    surface = analyse(np.ascontiguousarray(clean), lens)
    noise = mode.noise
    sigma = np.empty((height, width), np.float32)
    model_sigma(surface.inverse_depth, surface.cos_incidence,
                np.array([noise.a, noise.b, noise.c, noise.d, noise.n], np.float32),
                np.float32(camera_config().incidence_cap), sigma)
    bins = np.full((height, width, len(AXES)), -1, np.int16)
    index = {name: i for i, name in enumerate(AXES)}
    with np.errstate(invalid='ignore', divide='ignore'):
        seen = (clean >= mode.range_min) & (clean <= mode.range_max)
        edge = np.full((height, width), -1, np.int16)
        near = np.zeros((height, width), np.bool_)
        _edges(surface.inverse_depth, surface.row_jumps, surface.column_jumps, edge, near)
        inside = seen & ~near

        def put(name: str, values: np.ndarray, where: np.ndarray) -> None:
            axis = AXES[name]
            found = (np.searchsorted(np.array(axis.edges), values) if axis.edges else values)
            bins[where, index[name]] = (axis.start + found[where]).astype(np.int16)

        put('all', np.zeros((height, width), int), inside)
        put('distance', clean, inside)
        put('fine_distance', clean, inside & (clean < FINE_STEP * FINE_BINS))
        put('incidence', np.degrees(surface.incidence), inside)
        v, u = np.mgrid[:height, :width]
        radius = (np.hypot(u - (width - 1) / 2, v - (height - 1) / 2)
                  / math.hypot(width / 2, height / 2))
        put('radius', radius, inside)
        put('region', (v * 3 // height) * 4 + u * 4 // width, inside)
        put('tile', (v * TILE_ROWS // height) * TILE_COLUMNS + u * TILE_COLUMNS // width, inside)
        put('edge', edge, seen & (edge >= 0))
        rho = np.float32(1) if reflectivity is None else reflectivity
        put('log_amplitude', np.log(rho * surface.cos_incidence / clean ** 2), inside)
        bend = _bend(surface.inverse_depth, max(width // 28, 2))
        put('concavity', bend, inside & np.isfinite(bend))
        if before is not None and interval > 0:
            same = np.abs(clean - before) < 0.1 * clean
            put('speed', (clean - before) / np.float32(interval), inside & same)
        # Where the mode should see nothing: because nothing is there, or it is out of range.
        far = (clean > 1.1 * mode.range_max) & (clean > 0)
        put('beyond', np.where(far, 1, 0), (far | ~(clean > 0)) & (edge < 0))
    return Scene(bins, sigma, np.where(seen, clean, np.float32(np.nan)), inside)


@njit(cache=True)
def _edges(p, row_jumps, column_jumps, edge, near):  # type: ignore[no-untyped-def]
    # Classes 4 x (0 near side, 1 far side) x 2 + (0 next to the jump, 1 two to three away),
    # for the four directions in which the other surface lies: right, left, below, above.
    height, width = edge.shape
    reach = EDGE_REACH
    for y in range(height):
        for x in range(width):
            if row_jumps[y, x]:
                here, there = p[y + PAD, x + PAD], p[y + PAD, x + 1 + PAD]
                for k in range(reach):
                    if x - k >= 0:
                        _mark(edge, y, x - k, 0, here < there, k, here)
                    if x + 1 + k < width:
                        _mark(edge, y, x + 1 + k, 1, there < here, k, there)
            if column_jumps[y, x]:
                here, there = p[y + PAD, x + PAD], p[y + 1 + PAD, x + PAD]
                for k in range(reach):
                    if y - k >= 0:
                        _mark(edge, y - k, x, 2, here < there, k, here)
                    if y + 1 + k < height:
                        _mark(edge, y + 1 + k, x, 3, there < here, k, there)
            if row_jumps[y, x] or column_jumps[y, x]:
                for yy in range(max(y - NEAR, 0), min(y + NEAR + 2, height)):
                    for xx in range(max(x - NEAR, 0), min(x + NEAR + 2, width)):
                        near[yy, xx] = True


@njit(inline='always')
def _mark(edge, y, x, direction, far, k, inverse):  # type: ignore[no-untyped-def]
    if inverse > 0 and (edge[y, x] < 0 or (k == 0 and edge[y, x] % 2 == 1)):
        edge[y, x] = (direction * 2 + (1 if far else 0)) * 2 + (0 if k == 0 else 1)


@njit(cache=True)
def _bend(p, step):  # type: ignore[no-untyped-def]
    # How much farther a pixel is than the middle between those `step` beside it, as a share of
    # its distance: positive in concave corners, 0 on planes.
    height, width = p.shape[0] - 2 * PAD, p.shape[1] - 2 * PAD
    out = np.full((height, width), np.nan, np.float32)
    for y in range(step, height - step):
        for x in range(step, width - step):
            here = p[y + PAD, x + PAD]
            total = np.float32(0.0)
            good = here > 0
            for dy, dx in ((0, step), (0, -step), (step, 0), (-step, 0)):
                other = p[y + dy + PAD, x + dx + PAD]
                good &= abs(other - here) < np.float32(0.3) * here
                total += other - here
            if good:
                out[y, x] = np.float32(0.25) * total / here
    return out
