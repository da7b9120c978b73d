"""The whole analysis: measure every recording of a folder, fit every mode."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
import math
from pathlib import Path

from flexx2_sim_ros.characterize.axial_fit import AxialFit, fit_axial
from flexx2_sim_ros.characterize.edge_jitter import Edge
from flexx2_sim_ros.characterize.measurement import measure, Measurement
from flexx2_sim_ros.characterize.surface_fit import FEWEST_BOARDS, fit_surfaces, SurfaceFit
from flexx2_sim_ros.characterize.tiles import gaussian_kl, whole_noise
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processes import in_processes
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2, Profile
from flexx2_sim_ros.recording.opening import find_recordings
import numpy as np

LATERAL_PERCENTILE = 90  # of all edges: conservative on purpose, as in the paper
# The 90th percentile of fewer edges is the largest of them, and an outlier if it is larger than
# so many medians. ASSUMED
_FEWEST_EDGES, _MOST_MEDIANS = 8, 2.0
_RESAMPLES = 1000
_STEP = 15.0  # degrees between groups of recordings whose names state no angle


@dataclass(frozen=True)
class Divergence:
    """
    Divergence of what was measured from the model, mean over pixels (edges: over rows), nats.

    ``floor`` is what a perfect model would have on average, for the number of frames.
    """

    raw: float
    floor: float

    @property
    def debiased(self) -> float:
        """Return what is the model's."""
        return self.raw - self.floor


@dataclass(frozen=True)
class Cell:
    """
    One recording against its mode's model.

    Attributes
    ----------
    sigma, modelled : float
        Root mean square over its tiles of the measured and the modelled sigma_z, metres.
    axial : Divergence
        Of sigma_z.
    lateral : Divergence or None
        Of sigma_x, mean over its edges; None where no edge was measured over several frames.

    """

    measurement: Measurement
    sigma: float
    modelled: float
    axial: Divergence
    lateral: Divergence | None

    @property
    def angle_group(self) -> float:
        """Return the angle under which it is shown, degrees: stated, or to the nearest 15."""
        if self.measurement.condition is not None:
            return self.measurement.condition.angle_deg
        return round(self.measurement.angle_deg / _STEP) * _STEP


@dataclass(frozen=True)
class ModeResult:
    """
    What was found out about one mode.

    Attributes
    ----------
    axial : AxialFit
        sigma_z.
    sigma_x, sigma_x_error : float
        The 90th percentile of the edges' sigma, and its standard error, pixels; NaN where no edge
        was measured, or few that differ.
    cells : tuple of Cell
        One a recording, by distance and angle.
    surfaces : SurfaceFit or None
        How sigma_z depends on reflectivity; None without boards of several reflectivities.

    """

    usecase: str
    axial: AxialFit
    sigma_x: float
    sigma_x_error: float
    cells: tuple[Cell, ...]
    surfaces: SurfaceFit | None = None

    @property
    def white(self) -> list[Cell]:
        """Return the recordings of the brightest board, to which `axial` is fitted."""
        brightest = max(cell.measurement.reflectivity for cell in self.cells)
        return [cell for cell in self.cells if cell.measurement.reflectivity == brightest]

    @property
    def measurements(self) -> list[Measurement]:
        """Return the recordings."""
        return [cell.measurement for cell in self.cells]

    @property
    def edges(self) -> list[tuple[Measurement, Edge]]:
        """Return all edges, with the recording they are from."""
        return [(m, edge) for m in self.measurements for edge in m.edges]

    @property
    def spatial(self) -> bool:
        """Whether its recordings are single frames."""
        return self.cells[0].measurement.spatial


@dataclass(frozen=True)
class Characterization:
    """
    What a folder of recordings says about a camera.

    Attributes
    ----------
    modes : tuple of ModeResult
        By name.
    left_out : tuple of str
        Why each recording that could not be used was left out; each names its file.
    camera : Profile
        What was known of the camera before.

    """

    folder: Path
    modes: tuple[ModeResult, ...]
    left_out: tuple[str, ...]
    camera: Profile

    @property
    def intrinsics(self) -> Intrinsics:
        """Return the camera's; of crops, the smallest image that holds them all."""
        views = np.array(
            [
                (*m.K[:2, 2], *(np.array(m.size) - m.K[:2, 2]))
                for mode in self.modes
                for m in mode.measurements
            ]
        )
        left, top, right, bottom = views.max(axis=0).tolist()
        first = self.modes[0].measurements[0]
        matrix = np.array([[first.K[0, 0], 0.0, left], [0.0, first.K[1, 1], top], [0.0, 0.0, 1.0]])
        return Intrinsics.from_matrix(
            matrix, round(left + right), round(top + bottom), first.distortion
        )

    @property
    def cropped(self) -> bool:
        """Whether the recordings are crops of one image."""
        return len({_view(m) for mode in self.modes for m in mode.measurements}) > 1

    def mode(self, usecase: str) -> ModeResult:
        """Return one mode's result."""
        return next(mode for mode in self.modes if mode.usecase == usecase)


def characterize(
    folder: Path,
    *,
    box: tuple[int, int, int, int] | None = None,
    camera: str | None = None,
    profile: Profile | None = None,
    workers: int = 1,
    on_done: Callable[[int, int], None] = lambda done, total: None,
) -> Characterization:
    """
    Analyse a folder of recordings.

    Parameters
    ----------
    folder : pathlib.Path
        With ``.npz`` recordings or bags of one camera.
    box : tuple of int, optional
        x0, y0, x1, y1 of the board in every image; found when left out.
    camera : str, optional
        Which camera of bags that have several.
    profile : Profile, optional
        What is known of the camera: range and rate of its modes; the Flexx2 when left out.
    workers : int
        Processes.
    on_done : callable
        Called with how many recordings are done, and how many there are.

    Raises
    ------
    InputError
        When there is no recording that can be used; the message gives each one's reason.

    """
    known = profile or flexx2()
    paths = find_recordings(folder)
    measured, left_out = [], []
    on_done(0, len(paths))
    results = in_processes(partial(measure, box=box, camera=camera, profile=known), paths, workers)
    for done, result in enumerate(results, 1):
        if isinstance(result, InputError):
            left_out.append(str(result))
        else:
            measured.append(_with_hidden_noise(result))
        on_done(done, len(paths))
    # Case tells no two modes of a profile apart.
    spelling = {m.usecase.lower(): m.usecase for m in sorted(measured, key=lambda m: m.usecase)}
    measured = [replace(m, usecase=spelling[m.usecase.lower()]) for m in measured]
    measured.sort(key=lambda m: (m.usecase, m.label, str(m.path)))
    kept = _agreeing(measured, left_out)
    if not kept:
        raise InputError(
            f'{folder}: none of its {len(paths)} recordings can be used:\n  '
            + '\n  '.join(sorted(left_out))
        )
    modes = tuple(
        evaluate(usecase, [m for m in kept if m.usecase == usecase])
        for usecase in sorted({m.usecase for m in kept})
    )
    return Characterization(folder, modes, tuple(sorted(left_out)), known)


def _with_hidden_noise(measurement: Measurement) -> Measurement:
    if not measurement.spatial:
        return measurement
    return replace(measurement, tiles=whole_noise(measurement.tiles))


def _agreeing(measured: list[Measurement], left_out: list[str]) -> list[Measurement]:
    """Keep the recordings of one camera; add to `left_out` why the others are not kept."""
    single = sum(m.spatial for m in measured) > len(measured) / 2
    common = _common(measured)
    number = sum(_view(m)[: len(common)] == common for m in measured)
    with_frames = {
        m.usecase for m in measured if not m.spatial and _view(m)[: len(common)] == common
    }
    kept = []
    for m in measured:
        if _view(m)[: len(common)] != common:
            left_out.append(
                f'{m.path}: K: must be {_describe(common)}, as {number} of the '
                f'{len(measured)} recordings have, got {_describe(_view(m))}'
            )
        elif m.spatial and (not single or m.usecase in with_frames):
            who = 'another recording of its mode has' if single else 'most recordings have'
            left_out.append(f'{m.path}: depth: must have several frames, as {who}, got 1')
        else:
            kept.append(m)
    return kept


def _common(measured: list[Measurement]) -> tuple[float, ...]:
    """Return what most views share: all, or the focal lengths alone if they are crops."""
    if not measured:
        return ()
    views = Counter(_view(m) for m in measured).most_common()
    focal, number = Counter(_view(m)[:2] for m in measured).most_common(1)[0]
    same = [view for view, _ in views if view[:2] == focal]
    most = max(count for view, count in views if view in same)
    return same[0] if 2 * most > number else focal


def _view(measurement: Measurement) -> tuple[float, ...]:
    (fx, _, cx), (_, fy, cy), _ = measurement.K.round(3).tolist()
    lens = np.round(measurement.distortion, 6).tolist()
    return fx, fy, *measurement.size, cx, cy, *lens


def _describe(view: tuple[float, ...]) -> str:
    if len(view) == 2:
        return 'fx {:g}, fy {:g}'.format(*view)
    lens = f', distortion {", ".join(f"{one:g}" for one in view[6:])}' if any(view[6:]) else ''
    return '{2:g} x {3:g} pixels, fx {0:g}, fy {1:g}, cx {4:g}, cy {5:g}'.format(*view) + lens


def evaluate(usecase: str, measurements: list[Measurement]) -> ModeResult:
    """Fit one mode and hold its recordings against the fit."""
    several = [m for m in measurements if not m.spatial] or measurements
    boards = sorted({m.reflectivity for m in several}, reverse=True)
    axial = fit_axial([m.tiles for m in several if m.reflectivity == boards[0]])
    surfaces = None
    if len(boards) >= FEWEST_BOARDS:
        surfaces = fit_surfaces(
            [m.tiles for m in several], [m.reflectivity for m in several], axial
        )
    sigmas = np.array([edge.sigma for m in several for edge in m.edges])
    sigma_x = float(np.percentile(sigmas, LATERAL_PERCENTILE)) if sigmas.size else math.nan
    if 0 < sigmas.size < _FEWEST_EDGES and sigma_x > _MOST_MEDIANS * np.median(sigmas):
        sigma_x = math.nan
    return ModeResult(
        usecase,
        axial,
        sigma_x,
        _percentile_error(sigmas),
        tuple(_cell(m, axial, surfaces, sigma_x) for m in several),
        surfaces,
    )


def _percentile_error(sigmas: np.ndarray) -> float:
    if sigmas.size < 3:
        return math.nan
    draws = np.random.default_rng(0).choice(sigmas, (_RESAMPLES, sigmas.size))
    return float(np.percentile(draws, LATERAL_PERCENTILE, axis=1).std(ddof=1))


def _cell(
    measurement: Measurement, axial: AxialFit, surfaces: SurfaceFit | None, sigma_x: float
) -> Cell:
    tiles = measurement.tiles
    theta = np.where(np.isfinite(tiles.theta), tiles.theta, 0.0)
    model = replace(axial.model(), surfaces=None if surfaces is None else surfaces.noise)
    sigma = model.sigma_z(tiles.z, theta, measurement.reflectivity)

    def mean(values: np.ndarray) -> float:
        return float(np.average(values, weights=tiles.pixels))

    # A sigma of 0 (a fit that went negative there) has no divergence.
    with np.errstate(divide='ignore', invalid='ignore'):
        kl = mean(gaussian_kl(tiles.variance, tiles.mean_square, tiles.log_variance, sigma))
    edges = [edge for edge in measurement.edges if edge.frames > 1]
    lateral = None
    if edges and sigma_x > 0:
        raw = [
            float(gaussian_kl(e.variance, e.mean_square, e.log_variance, sigma_x)) for e in edges
        ]
        lateral = Divergence(float(np.mean(raw)), float(np.mean([e.floor for e in edges])))
    return Cell(
        measurement,
        math.sqrt(mean(tiles.variance)),
        math.sqrt(mean(sigma**2)),
        Divergence(kl, mean(tiles.floor)),
        lateral,
    )
