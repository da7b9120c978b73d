"""The noise of one recording as a histogram, as the paper shows one."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.analysis import Characterization
from flexx2_sim_ros.characterize.measurement import Measurement
from flexx2_sim_ros.characterize.single_pass import masked_chunks
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
import numpy as np

_BINS = 100  # as in the paper
_REACH = 5.0  # standard deviations to either side
_CONDITION = (1.0, 15.0)  # metres and degrees, as in the paper


@dataclass(frozen=True)
class Histogram:
    """
    A recording's noise: `counts` in bins with the bounds `edges`, metres.

    ``sigma`` is the model's sigma_z there (root mean square), metres.
    """

    measurement: Measurement
    edges: np.ndarray
    counts: np.ndarray
    sigma: float


def noise_histogram(result: Characterization, camera: str | None = None) -> Histogram:
    """
    Read one recording again, and count its noise within its window.

    The one nearest to the paper's condition is taken: 1.0 m and 15 degrees, in the mode with the
    longest range. ``camera`` is which one of bags that have several.
    """
    mode = max(result.modes, key=lambda m: m.axial.distances[1])
    cell = min(
        mode.white,
        key=lambda c: (
            abs(math.log(c.measurement.distance / _CONDITION[0]))
            + abs(c.measurement.angle_deg - _CONDITION[1]) / 15
        ),
    )
    measurement = cell.measurement
    x0, y0, x1, y1 = measurement.window
    v, u = np.mgrid[y0:y1, x0:x1]
    plane = measurement.plane.depth(u, v)
    theta = measurement.plane.incidence(u, v, measurement.K)
    sigma = math.sqrt(float(np.mean(mode.axial.model().sigma_z(plane, theta) ** 2)))
    edges: np.ndarray | None = None
    counts = np.zeros(0, np.int64)
    reader = open_recording(measurement.path, camera, result.camera)
    for frames, _, _ in masked_chunks(reader):
        depth = frames[:, y0:y1, x0:x1]
        if edges is None:
            edges = bin_edges(max(sigma, 1e-6), storage_step(depth))
            counts = np.zeros(len(edges) - 1, np.int64)
        error = depth - plane
        counts += np.histogram(error[np.isfinite(error)], edges)[0]
    if edges is None:
        raise InputError(f'{measurement.path}: depth: must have frames, got none')
    return Histogram(measurement, edges, counts, sigma)


def storage_step(depth: np.ndarray) -> float:
    """Return the step in which depth (metres, NaN where invalid) is stored; 0 below two values."""
    steps = np.diff(np.unique(depth[np.isfinite(depth)]))
    return float(np.median(steps)) if steps.size else 0.0


def bin_edges(sigma: float, step: float) -> np.ndarray:
    """
    Return the bounds of bins around 0, metres, for noise of `sigma` and a step of storage, metres.

    Bins narrower than the step would be empty in part: where 100 bins would be, they are one step
    wide, with 0 in the middle of a bin.
    """
    if step <= 2 * _REACH * sigma / _BINS:
        return np.linspace(-_REACH, _REACH, _BINS + 1) * sigma
    beside = max(1, math.ceil(_REACH * sigma / step))
    return (np.arange(2 * beside + 2) - beside - 0.5) * step
