"""The covariates of each pixel of a clean frame, sorted into bins."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
import math

from flexx2_sim_ros.gap.calibration.data import BINNING
from flexx2_sim_ros.gap.data.axes import AXES, Axes, ENDLESS, TILE_COLUMNS, TILE_ROWS
from flexx2_sim_ros.gap.data.frames import surface_of
from flexx2_sim_ros.gap.data.pixel_kernels import (
    concavity,
    EDGE_REACH,
    mark_creases,
    mark_edges,
    NEAR,
    put_in_bins,
    runs_of,
    surfaces_at,
)
from flexx2_sim_ros.gap.data.unknown import away, judged
from flexx2_sim_ros.physics.axial import sigma_image
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.surface import Surface
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np


@dataclass(frozen=True)
class PixelCovariates:
    """
    The covariates of one clean frame.

    * `runs`: (N, 3) int16, sorted by row. Each run is a stretch of a row in the same bin: first
      column, column after the last, and index among the bins of all axes.
    * `first`: (H + 1,) int32, index of the first run of each row.
    * `sigma`: (H, W) float32, the base model's sigma_z, metres.
    * `trusted`: largest sigma_z, metres, that says how depth errors are distributed: see
      `trusted_sigma`.
    * `clean`: (H, W) float32, NaN where the mode measures nothing.
    * `inside`: (H, W) bool, surfaces away from jumps and sharp bends.
    * `ray`: (H, W) float32, distance along the pixel's ray as a multiple of its depth.
    * `compared`: (H, W) bool, pixels that are compared: ground truth is known at and around them.
    * `ends`: (2, H, W) float32 metres, how near and how far the surfaces around compared pixels
      up to 3 px from a jump are; NaN elsewhere.
    """

    runs: np.ndarray
    first: np.ndarray
    sigma: np.ndarray
    trusted: float
    clean: np.ndarray
    inside: np.ndarray
    ray: np.ndarray
    compared: np.ndarray
    ends: np.ndarray

    def places(self, name: str) -> np.ndarray:
        """Return the bin of each pixel along an axis, (H, W) int16 from 0, -1 for none."""
        axis = AXES[name]
        place = self.runs[:, 2] - axis.start
        mine = (place >= 0) & (place < axis.bins)
        rows = np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))[mine]
        start, end = self.runs[mine, :2].astype(int).T
        length = end - start
        before = np.cumsum(length) - length
        columns = np.arange(length.sum()) + np.repeat(start - before, length)
        out = np.full(self.clean.shape, -1, np.int16)
        out[np.repeat(rows, length), columns] = np.repeat(place[mine], length)
        return out


def look_at(
    clean: np.ndarray,
    before: np.ndarray | None,
    interval: float,
    reflectivity: np.ndarray | None,
    K: np.ndarray,
    mode: Mode,
    axes: Axes,
    border: int = 0,
    known: np.ndarray | None = None,
) -> PixelCovariates:
    """
    Sort the pixels of a frame into the bins of all axes.

    * `clean`: (H, W) float32 metres.
    * `before`: (H, W) float32 metres, the frame `interval` seconds before it, if the scene moves.
    * `reflectivity`: (H, W) in 0..1.
    * `K`: (3, 3) camera matrix.
    * `border`: width of the image's border that is left out, pixels.
    * `known`: (H, W) bool, where `clean` is known; everywhere when left out. Elsewhere its values
      are filled in and not compared.
    """
    height, width = clean.shape
    lens = Intrinsics.from_matrix(K, width, height)
    surface = surface_of(clean, K, mode.sensor)
    compared = _compared(lens, mode.sensor, border, known)
    edge, inside = _edges_and_surfaces(surface, compared, known)
    with np.errstate(invalid='ignore', divide='ignore'):
        # At the ends of the range, millimetres of the pose decide whether there is a depth.
        nearest, farthest = mode.range_min + BINNING.limit, mode.range_max - BINNING.limit
        seen = compared & (clean >= nearest) & (clean <= farthest)
        inside &= seen
        bins = _Bins(axes, AXES, (height, width))
        bins.put_surfaces(surface, clean, reflectivity, inside)
        fine = axes['fine_distance'].edges
        bins.put('fine_distance', clean, inside & (clean < fine[-1] + fine[0]))
        bend = concavity(surface.inverse_depth, max(width // BINNING.bend_step, 2))
        bins.put('concavity', bend, inside & np.isfinite(bend))
        at_jump = seen & (edge >= 0)
        bins.put_classes('edge', edge, at_jump)
        if before is not None and interval > 0:
            speed = speed_of(clean, before, interval)
            bins.put('speed', speed, inside & np.isfinite(speed))
        # Pixels that should have no depth: there is no surface, or it is out of range.
        far = (clean > BINNING.beyond * mode.range_max) & (clean > 0)
        no_return = (far | ~(clean > 0)) & (edge < 0) & compared
        bins.put_classes('beyond', far.astype(np.int16), no_return)
        compared_depth = np.where(seen, clean, np.float32(np.nan))
    runs, first = runs_of(bins.values)
    return PixelCovariates(
        runs,
        first,
        sigma_image(surface, mode.noise, reflectivity),
        trusted_sigma(mode),
        compared_depth,
        inside,
        _rays(*(float(v) for v in K[:2].ravel()), height, width),
        compared,
        surfaces_at(compared_depth, at_jump),
    )


def trusted_sigma(mode: Mode) -> float:
    """
    Return up to which sigma_z, metres, the noise of the phase is in proportion the noise of depth.

    With more noise, depths of several frequencies get whole wavelengths wrong, and depths of one
    wrap. sigma_z is then no measure of their errors. Infinite for a camera without frequencies.
    """
    wavenumbers = [4 * math.pi * f / SPEED_OF_LIGHT for f in mode.modulation_hz]
    return BINNING.phase_noise / math.hypot(*wavenumbers) if wavenumbers else math.inf


class _Bins:
    # (A, H, W) int16 bins of a frame's pixels along some axes, -1 for none.
    def __init__(self, axes: Axes, names: Iterable[str], size: tuple[int, ...]) -> None:
        self._axes = axes
        self._index = {name: i for i, name in enumerate(names)}
        self.values = np.full((len(self._index), *size), -1, np.int16)

    def put(self, name: str, covariate: np.ndarray, where: np.ndarray) -> None:
        axis, out = self._axes[name], self.values[self._index[name]]
        put_in_bins(covariate, where, np.array(axis.edges), axis.start, out)

    def put_classes(self, name: str, classes: np.ndarray | int, where: np.ndarray) -> None:
        out = self.values[self._index[name]]
        np.copyto(out, self._axes[name].start + classes, where=where)

    def put_surfaces(
        self,
        surface: Surface,
        clean: np.ndarray,
        reflectivity: np.ndarray | None,
        where: np.ndarray,
    ) -> None:
        # What each pixel has by itself.
        for name, places in _places(*clean.shape).items():
            if name in self._index:
                np.copyto(self.values[self._index[name]], places, where=where)
        self.put('distance', clean, where)
        self.put('incidence', np.degrees(surface.incidence), where)
        self.put('log_amplitude', log_amplitude(surface, clean, reflectivity), where)


def _compared(
    lens: Intrinsics, sensor: Sensor, border: int, known: np.ndarray | None
) -> np.ndarray:
    # (H, W) bool, pixels that may be compared: not at the border, not outside the lens, known.
    height, width = lens.height, lens.width
    compared = np.zeros((height, width), bool)
    compared[border : height - border, border : width - border] = True
    outside = sensor.outside(lens)
    if outside is not None:
        compared &= ~outside
    if known is not None:
        compared &= judged(known, NEAR)
    return compared


def _edges_and_surfaces(
    surface: Surface, compared: np.ndarray, known: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    # (H, W) class of the edge, -1 for none; (H, W) bool, away from jumps and sharp bends.
    edge, near = np.full(compared.shape, -1, np.int16), np.zeros(compared.shape, np.bool_)
    mark_edges(surface.inverse_depth, surface.row_jumps, surface.column_jumps, edge, near)
    mark_creases(surface.inverse_depth, BINNING.crease, near)
    if known is not None:
        # A jump beside unknown pixels may be an artefact of the filled values.
        edge[~away(known, EDGE_REACH + 1)] = -1
    return edge, ~near


def log_amplitude(
    surface: Surface, clean: np.ndarray, reflectivity: np.ndarray | None
) -> np.ndarray:
    """Return the logarithm of each pixel's amplitude in 1/m^2, (H, W)."""
    rho = np.float32(1) if reflectivity is None else reflectivity
    return np.asarray(np.log(rho * surface.cos_incidence / clean**2))


def speed_of(clean: np.ndarray, before: np.ndarray, interval: float) -> np.ndarray:
    """Return how fast surfaces move away, (H, W) m/s; NaN where they are not the same."""
    same = np.abs(clean - before) < BINNING.same_surface * clean
    return np.where(same, (clean - before) / np.float32(interval), np.nan)


def sort_everywhere(
    clean: np.ndarray,
    speed: np.ndarray | None,
    reflectivity: np.ndarray | None,
    K: np.ndarray,
    sensor: Sensor,
    axes: Axes,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Sort all pixels of a frame along `ENDLESS`, including edges and depth out of range.

    `clean` is (H, W) float32 metres; `speed` (H, W) m/s as from `speed_of`, or None in a scene
    that stands still; `reflectivity` (H, W) in 0..1 or None. Return (A, H, W) int16 bins, -1 for
    none, and (H, W) incidence in degrees.
    """
    surface = surface_of(clean, K, sensor)
    edge, near = np.full(clean.shape, -1, np.int16), np.zeros(clean.shape, np.bool_)
    mark_edges(surface.inverse_depth, surface.row_jumps, surface.column_jumps, edge, near)
    bins = _Bins(axes, ENDLESS, clean.shape)
    with np.errstate(invalid='ignore', divide='ignore'):
        seen = np.isfinite(clean) & (clean > 0)
        bins.put_surfaces(surface, clean, reflectivity, seen)
    bins.put('fine_distance', clean, seen)
    bins.put_classes('edge', 0, seen & (edge >= 0))
    if speed is not None:
        bins.put('speed', speed, seen & np.isfinite(speed))
    return bins.values, np.degrees(surface.incidence)


@lru_cache(maxsize=4)
def _rays(
    fx: float, skew: float, cx: float, other: float, fy: float, cy: float, height: int, width: int
) -> np.ndarray:
    matrix = np.array([[fx, skew, cx], [other, fy, cy], [0, 0, 1]])
    return ray_length(matrix, (height, width))


@lru_cache(maxsize=4)
def _places(height: int, width: int) -> dict[str, np.ndarray]:
    # (H, W) int16 bins that depend on the place in the image only.
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
