"""Make a frame with effects: the pipeline in the order of light."""

from collections.abc import Sequence
from itertools import groupby
import math

from flexx2_sim_ros.camera.axial import add_noise, blank_invalid, blank_outside, model_sigma
from flexx2_sim_ros.camera.exposure import Effect, Exposure, Stage
from flexx2_sim_ros.camera.lateral import displaced_sources, pixel_sigma, upright_edges
from flexx2_sim_ros.camera.modes import camera_config
from flexx2_sim_ros.camera.philox import fill_normals, stamp_words, STREAM_AXIAL
from flexx2_sim_ros.camera.surface import analyse, PAD
import numpy as np


def develop(exposure: Exposure, effects: Sequence[Effect],
            edge_sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Run the stages in order, each with its effects.

    Parameters
    ----------
    exposure : Exposure
        With depth and reflectivity.
    effects : sequence of Effect
        Those that are on.
    edge_sigma : float
        The mode's sigma_x, pixels.

    Returns
    -------
    tuple of numpy.ndarray
        Depth, sigma, amplitude and confidence, (H, W) float32, as in `Frame`. Without any effect
        the base model's, up to float32 rounding.

    """
    ordered = sorted(effects, key=lambda effect: (effect.stage, effect.order, effect.name))
    by_stage = {stage: list(group) for stage, group in
                groupby(ordered, key=lambda effect: effect.stage)}

    def run(stage: Stage) -> None:
        for effect in by_stage.get(stage, ()):
            effect.apply(exposure)

    exposure.memory.begin(exposure.stamp)
    run(Stage.GEOMETRY)
    _light(exposure)
    run(Stage.AMPLITUDE)
    exposure.shifts = [np.zeros_like(exposure.depth) for _ in exposure.mode.modulation_hz]
    run(Stage.PHASOR)
    _expect_noise(exposure, edge_sigma)
    run(Stage.NOISE)
    _show_other_surfaces(exposure)
    _measure(exposure, bool(by_stage.get(Stage.WRAP)))
    run(Stage.WRAP)
    _blank_outside(exposure)
    run(Stage.FILTER)
    if by_stage.get(Stage.STORAGE):
        run(Stage.STORAGE)
        _blank_outside(exposure)
    run(Stage.DROPOUT)
    return _finish(exposure)


def _blank_outside(exposure: Exposure) -> None:
    exposure.measured = np.ascontiguousarray(exposure.measured)
    blank_outside(exposure.measured, np.float32(exposure.mode.range_min),
                  np.float32(exposure.mode.range_max))


def _light(exposure: Exposure) -> None:
    # The light that comes back from each pixel's surface.
    exposure.depth = np.ascontiguousarray(exposure.depth)
    surface = exposure.surface = analyse(exposure.depth, exposure.intrinsics)
    inverse = surface.inverse_depth[PAD:-PAD, PAD:-PAD]
    exposure.depth[inverse == 0] = np.nan
    exposure.cosine = surface.cos_incidence
    exposure.amplitude = exposure.reflectivity * surface.cos_incidence * inverse * inverse


def _expect_noise(exposure: Exposure, edge_sigma: float) -> None:
    noise, surface = exposure.mode.noise, exposure.surface
    shape = exposure.depth.shape
    exposure.sigma = np.empty(shape, np.float32)
    coefficients = np.array([noise.a, noise.b, noise.c, noise.d, noise.n], np.float32)
    model_sigma(surface.inverse_depth, surface.cos_incidence, coefficients,
                np.float32(camera_config().incidence_cap), exposure.sigma)
    exposure.normals = np.empty(shape, np.float32)
    low, high = stamp_words(exposure.stamp)
    fill_normals(exposure.key, low, high, STREAM_AXIAL, exposure.normals.ravel())
    exposure.edge_sigma = edge_sigma


def _show_other_surfaces(exposure: Exposure) -> None:
    # Lateral noise: near edges, pixels take over what another pixel sees.
    surface = exposure.surface
    rows, columns = np.empty_like(surface.row_jumps), np.empty_like(surface.row_jumps)
    edges = upright_edges(surface.row_jumps, surface.column_jumps, rows, columns)
    if not edges or exposure.edge_sigma <= 0:
        return
    sigma = pixel_sigma(exposure.edge_sigma)
    limit = min(math.ceil((5 + 5 * exposure.edge_laplace) * exposure.edge_sigma), 127)
    source = np.empty(exposure.depth.size, np.int32)
    low, high = stamp_words(exposure.stamp)
    displaced_sources(rows, columns, camera_config().neighbourhood_px, np.float32(sigma), limit,
                      exposure.key, low, high, np.float32(exposure.edge_laplace), source)
    moved = np.flatnonzero(source != np.arange(source.size, dtype=np.int32))
    origin = source[moved]
    exposure.cosine = exposure.cosine.copy()
    exposure.sigma = np.ascontiguousarray(exposure.sigma)
    for image in (exposure.depth, exposure.amplitude, exposure.sigma, exposure.cosine,
                  *exposure.shifts):
        flat = image.reshape(-1)
        flat[moved] = flat[origin]


def _measure(exposure: Exposure, wraps: bool) -> None:
    mode = exposure.mode
    shift = sum(np.float32(weight) * one for weight, one in
                zip(exposure.weights, exposure.shifts, strict=True))
    low, high = np.float32(mode.range_min), np.float32(mode.range_max)
    if wraps:
        # What lies beyond the range is not recognised as such; see the effect range_wrap.
        low, high = np.float32(0), np.float32(np.finfo(np.float32).max)
    exposure.measured = np.empty_like(exposure.depth)
    add_noise(exposure.depth, shift, exposure.sigma, exposure.normals, low, high,
              exposure.measured)


def _finish(exposure: Exposure) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    sigma, amplitude, confidence = (np.empty_like(exposure.depth) for _ in range(3))
    blank_invalid(exposure.measured, exposure.sigma, exposure.amplitude,
                  np.float32(camera_config().zero_at_sigma_m), sigma, amplitude, confidence)
    if exposure.saturated is not None:
        amplitude[exposure.saturated] = exposure.amplitude[exposure.saturated]
    return exposure.measured, sigma, amplitude, confidence
