"""What each pixel of a clean frame is like: the axes along which a gap is looked for."""

from dataclasses import dataclass
from functools import lru_cache
import math

from flexx2_sim_ros.effects.ray import ray_length
from flexx2_sim_ros.gap.calibration.constants import BINNING
from flexx2_sim_ros.gap.data.unknown import away, judged
from flexx2_sim_ros.physics.axial import model_sigma, scale_by_surface
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
from flexx2_sim_ros.physics.surface import analyse, PAD
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode, Profile
from flexx2_sim_ros.profiles.sensor import Sensor
from numba import njit
import numpy as np

TILE_ROWS, TILE_COLUMNS = BINNING.tiles
# Compiled code takes constants from its module.
EDGE_REACH, NEAR = BINNING.edge_reach, BINNING.near_jump
CREASE_NEAR, _BEND = BINNING.near_crease, np.float32(BINNING.bend)


@dataclass(frozen=True)
class Axis:
    """
    One covariate and its bins.

    Attributes
    ----------
    name, unit : str
    edges : tuple of float
        Between bins, one fewer than there are; empty where bins are classes, and in `AXES` where
        they depend on the camera.
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


Axes = dict[str, Axis]


def _axes(distances: tuple[float, ...], fine: tuple[float, ...]) -> Axes:
    first, step, number = BINNING.amplitudes
    table: list[tuple[str, str, tuple[float, ...], int, bool]] = [
        ('all', '', (), 1, True),
        ('distance', 'm', distances, BINNING.distance_edges + 1, True),
        ('incidence', 'deg', BINNING.incidences, 9, True),
        ('radius', '', BINNING.radii, 6, True),
        ('region', '', (), 12, True),
        ('edge', '', (), 16, True),
        (
            'log_amplitude',
            'ln 1/m^2',
            tuple(first + step * i for i in range(number)),
            number + 1,
            True,
        ),
        ('concavity', '', BINNING.concavities, 6, True),
        ('speed', 'm/s', BINNING.speeds, 9, True),
        ('beyond', '', (), 2, False),
        ('fine_distance', 'm', fine, BINNING.fine_bins, False),
        ('tile', '', (), TILE_ROWS * TILE_COLUMNS, False),
    ]
    axes, start = {}, 0
    for name, unit, edges, bins, full in table:
        axes[name] = Axis(name, unit, edges, bins, start, full)
        start += bins
    return axes


# What is the same for all cameras: names and numbers of bins.
AXES = _axes((), ())
# Those along which every pixel with a distance has its place.
ENDLESS = (
    'all',
    'distance',
    'incidence',
    'radius',
    'region',
    'log_amplitude',
    'fine_distance',
    'edge',
)
BINS = sum(axis.bins for axis in AXES.values())


def axes_of(camera: Profile) -> Axes:
    """
    Return all axes for a camera.

    Parameters
    ----------
    camera : Profile
        Its range, over all modes, gives the bins of distance; its highest modulation frequency
        those of fine distance, its range where there is none.

    """
    return _axes_between(
        min(mode.range_min for mode in camera.modes),
        max(mode.range_max for mode in camera.modes),
        max(camera.modulation_hz, default=0.0),
    )


@lru_cache(maxsize=8)
def _axes_between(nearest: float, farthest: float, frequency: float) -> Axes:
    last = BINNING.farthest_share * farthest
    first = min(max(BINNING.nearest_share * nearest, last / BINNING.span), 0.9 * last)
    log = tuple(float(x) for x in np.round(np.geomspace(first, last, BINNING.distance_edges), 3))
    step = (
        SPEED_OF_LIGHT / (2 * frequency) / BINNING.fine_a_period
        if frequency
        else last / BINNING.fine_bins
    )
    step = max(round(step, 2), 0.01)
    return _axes(log, tuple(step * i for i in range(1, BINNING.fine_bins)))


@dataclass(frozen=True)
class PixelCovariates:
    """
    The covariates of one clean frame.

    Attributes
    ----------
    runs : numpy.ndarray
        (N, 3) int16, by rows: pixels side by side that are in one bin: the first column, the one
        after the last, the bin among those of all axes.
    first : numpy.ndarray
        (H + 1,) int32, where each row's runs start.
    sigma : numpy.ndarray
        (H, W) float32, the base model's sigma_z, metres.
    clean : numpy.ndarray
        (H, W) float32, NaN where the mode sees nothing.
    inside : numpy.ndarray
        (H, W) bool, surfaces away from jumps.
    ray : numpy.ndarray
        (H, W) float32, how much longer the rays are than depth.
    compared : numpy.ndarray
        (H, W) bool, pixels that are looked at: their ground truth and that around them is known.

    """

    runs: np.ndarray
    first: np.ndarray
    sigma: np.ndarray
    clean: np.ndarray
    inside: np.ndarray
    ray: np.ndarray
    compared: np.ndarray


def look_at(
    clean: np.ndarray,
    before: np.ndarray | None,
    interval: float,
    reflectivity: np.ndarray | None,
    K: np.ndarray,
    mode: Mode,  # noqa: N803
    axes: Axes,
    border: int = 0,
    known: np.ndarray | None = None,
) -> PixelCovariates:
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
        For its range, noise and sensor.
    axes : dict of str to Axis
        The camera's.
    border : int
        Pixels along the image's border that are not looked at.
    known : numpy.ndarray, optional
        (H, W) bool, where ``clean`` is known; elsewhere it only stands in. Everywhere when left
        out.

    Returns
    -------
    PixelCovariates

    """
    height, width = clean.shape
    lens = Intrinsics.from_matrix(K, width, height)
    surface = analyse(np.ascontiguousarray(clean), lens, mode.sensor)
    noise = mode.noise
    sigma = np.empty((height, width), np.float32)
    model_sigma(
        surface.inverse_depth,
        surface.cos_incidence,
        np.array([noise.a, noise.b, noise.c, noise.d, noise.n], np.float32),
        np.float32(noise.incidence_cap),
        sigma,
    )
    if noise.surfaces is not None and reflectivity is not None:
        scale_by_surface(
            surface.inverse_depth,
            surface.cos_incidence,
            np.ascontiguousarray(reflectivity, np.float32),
            noise.surfaces.coefficients,
            sigma,
        )
    bins = np.full((len(AXES), height, width), -1, np.int16)
    index = {name: i for i, name in enumerate(AXES)}
    with np.errstate(invalid='ignore', divide='ignore'):
        seen = (clean >= mode.range_min) & (clean <= mode.range_max)
        edge = np.full((height, width), -1, np.int16)
        near = np.zeros((height, width), np.bool_)
        _edges(surface.inverse_depth, surface.row_jumps, surface.column_jumps, edge, near)
        _creases(surface.inverse_depth, BINNING.crease, near)
        compared = np.zeros((height, width), bool)
        compared[border : height - border, border : width - border] = True
        outside = mode.sensor.outside(lens)
        if outside is not None:
            compared &= ~outside
        if known is not None:
            compared &= judged(known, NEAR)
            # A jump beside the unknown may be that of what only stands in.
            edge[~away(known, EDGE_REACH + 1)] = -1
        seen &= compared
        inside = seen & ~near

        def put(name: str, values: np.ndarray, where: np.ndarray) -> None:
            axis = axes[name]
            _put(values, where, np.array(axis.edges), axis.start, bins[index[name]])

        fine = axes['fine_distance'].edges
        put('distance', clean, inside)
        put('fine_distance', clean, inside & (clean < fine[-1] + fine[0]))
        put('incidence', np.degrees(surface.incidence), inside)
        for name, places in _places(height, width).items():
            np.copyto(bins[index[name]], places, where=inside)
        np.copyto(bins[index['edge']], AXES['edge'].start + edge, where=seen & (edge >= 0))
        rho = np.float32(1) if reflectivity is None else reflectivity
        put('log_amplitude', np.log(rho * surface.cos_incidence / clean**2), inside)
        bend = _bend(surface.inverse_depth, max(width // BINNING.bend_step, 2))
        put('concavity', bend, inside & np.isfinite(bend))
        if before is not None and interval > 0:
            same = np.abs(clean - before) < BINNING.same_surface * clean
            put('speed', (clean - before) / np.float32(interval), inside & same)
        # Where the mode should see nothing: because nothing is there, or it is out of range.
        far = (clean > BINNING.beyond * mode.range_max) & (clean > 0)
        np.copyto(
            bins[index['beyond']],
            AXES['beyond'].start + far.astype(np.int16),
            where=(far | ~(clean > 0)) & (edge < 0) & compared,
        )
    runs, first = _runs(bins)
    return PixelCovariates(
        runs,
        first,
        sigma,
        np.where(seen, clean, np.float32(np.nan)),
        inside,
        _rays(*(float(v) for v in K[:2].ravel()), height, width),
        compared,
    )


def sort_everywhere(
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    K: np.ndarray,  # noqa: N803
    sensor: Sensor,
    axes: Axes,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Sort all of a frame's pixels along `ENDLESS`, edges and what is out of range included.

    Parameters
    ----------
    clean : numpy.ndarray
        (H, W) float32 metres.
    reflectivity : numpy.ndarray or None
        (H, W) in 0..1.
    K : numpy.ndarray
        (3, 3) camera matrix.
    sensor : Sensor
        For its thresholds of depth jumps.
    axes : dict of str to Axis
        The camera's.

    Returns
    -------
    tuple of numpy.ndarray
        (A, H, W) int16 bins, -1 for none, and (H, W) incidence in degrees.

    """
    height, width = clean.shape
    surface = analyse(
        np.ascontiguousarray(clean), Intrinsics.from_matrix(K, width, height), sensor
    )
    bins = np.full((len(ENDLESS), height, width), -1, np.int16)
    incidence = np.degrees(surface.incidence)
    edge, near = np.full((height, width), -1, np.int16), np.zeros((height, width), np.bool_)
    _edges(surface.inverse_depth, surface.row_jumps, surface.column_jumps, edge, near)
    rho = np.float32(1) if reflectivity is None else reflectivity
    with np.errstate(invalid='ignore', divide='ignore'):
        seen = np.isfinite(clean) & (clean > 0)
        values = {
            'distance': clean,
            'fine_distance': clean,
            'incidence': incidence,
            'log_amplitude': np.log(rho * surface.cos_incidence / clean**2),
        }
    places = _places(height, width)
    for out, name in zip(bins, ENDLESS, strict=True):
        axis = axes[name]
        if name == 'edge':
            np.copyto(out, axis.start, where=seen & (edge >= 0))
        elif name in places:
            np.copyto(out, places[name], where=seen)
        else:
            _put(values[name], seen, np.array(axis.edges), axis.start, out)
    return bins, incidence


@lru_cache(maxsize=4)
def _rays(
    fx: float, skew: float, cx: float, other: float, fy: float, cy: float, height: int, width: int
) -> np.ndarray:
    matrix = np.array([[fx, skew, cx], [other, fy, cy], [0, 0, 1]])
    return ray_length(matrix, (height, width))


@lru_cache(maxsize=4)
def _places(height: int, width: int) -> dict[str, np.ndarray]:
    # Bins that are a matter of the place in the image alone, (H, W) int16.
    v, u = np.mgrid[:height, :width]
    radius = np.hypot(u - (width - 1) / 2, v - (height - 1) / 2) / math.hypot(
        width / 2, height / 2
    )
    places = {
        'all': np.zeros((height, width), int),
        'radius': np.searchsorted(np.array(AXES['radius'].edges), radius),
        'region': (v * 3 // height) * 4 + u * 4 // width,
        'tile': (v * TILE_ROWS // height) * TILE_COLUMNS + u * TILE_COLUMNS // width,
    }
    return {name: (AXES[name].start + place).astype(np.int16) for name, place in places.items()}


@njit(cache=True)
def _put(values, where, edges, start, out):
    # Like numpy.searchsorted, NaN last; neighbours are mostly in the same bin.
    i = 0
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if where[y, x]:
                value = values[y, x]
                while i > 0 and value <= edges[i - 1]:
                    i -= 1
                while i < edges.size and not value <= edges[i]:
                    i += 1
                out[y, x] = start + i


@njit(cache=True)
def _runs(bins):
    axes, height, width = bins.shape
    first = np.zeros(height + 1, np.int32)
    out = np.empty((axes * height * width, 3), np.int16)
    count = 0
    for y in range(height):
        for a in range(axes):
            start = 0
            for x in range(1, width + 1):
                if x == width or bins[a, y, x] != bins[a, y, start]:
                    if bins[a, y, start] >= 0:
                        out[count, 0], out[count, 1], out[count, 2] = start, x, bins[a, y, start]
                        count += 1
                    start = x
        first[y + 1] = count
    return out[:count].copy(), first


@njit(cache=True)
def _edges(p, row_jumps, column_jumps, edge, near):
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


@njit(cache=True)
def _creases(p, share, near):
    # Where a surface bends so much from pixel to pixel that it depends on where between pixels it
    # does whether a jump is seen there.
    height, width = near.shape
    reach = CREASE_NEAR
    for y in range(height):
        for x in range(width):
            j, i = y + PAD, x + PAD
            here = p[j, i]
            if here <= 0:
                continue
            bent = False
            if p[j, i - 1] > 0 and p[j, i + 1] > 0:
                bent |= abs(p[j, i + 1] + p[j, i - 1] - 2 * here) > share * here
            if p[j - 1, i] > 0 and p[j + 1, i] > 0:
                bent |= abs(p[j + 1, i] + p[j - 1, i] - 2 * here) > share * here
            if bent:
                for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
                    for xx in range(max(x - reach, 0), min(x + reach + 1, width)):
                        near[yy, xx] = True


@njit(inline='always')
def _mark(edge, y, x, direction, far, k, inverse):
    if inverse > 0 and (edge[y, x] < 0 or (k == 0 and edge[y, x] % 2 == 1)):
        edge[y, x] = (direction * 2 + (1 if far else 0)) * 2 + (0 if k == 0 else 1)


@njit(cache=True)
def _bend(p, step):
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
                good &= abs(other - here) < _BEND * here
                total += other - here
            if good:
                out[y, x] = np.float32(0.25) * total / here
    return out
