"""Make a frame with effects: the pipeline in the order of light."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
import math
from typing import Any

from flexx2_sim_ros.camera.axial import add_noise, blank_invalid, blank_outside, model_sigma
from flexx2_sim_ros.camera.exposure import Common, Effect, Exposure, once, Stage
from flexx2_sim_ros.camera.lateral import displaced_sources, pixel_sigma, upright_edges
from flexx2_sim_ros.camera.modes import camera_config
from flexx2_sim_ros.camera.philox import fill_normals, stamp_words, STREAM_AXIAL
from flexx2_sim_ros.camera.surface import analyse, PAD, Surface
import numpy as np

_NOWHERE = np.zeros(0, np.int64)


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
    measure(exposure, effects, edge_sigma)
    return _finish(exposure)


def measure(exposure: Exposure, effects: Sequence[Effect], edge_sigma: float) -> None:
    """Run the stages like `develop`, up to ``exposure.measured``."""
    ordered = sorted(effects, key=lambda effect: (effect.stage, effect.order, effect.name))
    by_stage = {stage: list(group) for stage, group in
                groupby(ordered, key=lambda effect: effect.stage)}

    def run(stage: Stage) -> None:
        for effect in by_stage.get(stage, ()):
            effect.apply(exposure)

    wraps = bool(by_stage.get(Stage.WRAP))
    common = exposure.common
    exposure.memory.begin(exposure.stamp)
    if common is None or any(stage < Stage.WRAP for stage in by_stage):
        if common is None or Stage.GEOMETRY not in by_stage:
            run(Stage.GEOMETRY)
        else:
            _see_another_scene(exposure, common, by_stage[Stage.GEOMETRY])
        _light(exposure)
        run(Stage.AMPLITUDE)
        exposure.shifts = exposure.no_shifts()
        run(Stage.PHASOR)
        _expect_noise(exposure, edge_sigma)
        run(Stage.NOISE)
        _show_other_surfaces(exposure)
        _measure(exposure, wraps)
    else:
        plain = once(common.frame, ('plain', wraps), lambda: _plain(exposure, edge_sigma, wraps))
        for name, image in plain.items():
            setattr(exposure, name, image)
        exposure.measured = exposure.measured.copy()
    run(Stage.WRAP)
    _blank_outside(exposure)
    run(Stage.FILTER)
    if by_stage.get(Stage.STORAGE):
        run(Stage.STORAGE)
        _blank_outside(exposure)
    run(Stage.DROPOUT)


def _see_another_scene(exposure: Exposure, common: Common, effects: Sequence[Effect]) -> None:
    # The random numbers are the same. What effects that keep nothing make of the scene is the same
    # for all frames that share it; the latest of it is kept.
    def make() -> tuple[np.ndarray, np.ndarray]:
        exposure.depth, exposure.reflectivity = exposure.depth.copy(), exposure.reflectivity.copy()
        for effect in effects:
            effect.apply(exposure)
        return exposure.depth, exposure.reflectivity

    scene: dict[Any, Any] = {}
    if not any(getattr(effect, 'keeps', True) for effect in effects):
        key, kept = common.scene.get('other', (None, scene))
        scene = kept if key == tuple(effects) else scene
        common.scene['other'] = tuple(effects), scene
    normals = once(common.frame, _NORMALS, lambda: _normals(exposure))
    exposure.depth, exposure.reflectivity = once(scene, 'view', make)
    exposure.common = Common(scene, {_NORMALS: normals})


_NORMALS = 'normals'
_UNTIL_WRAP = ('surface', 'depth', 'amplitude', 'cosine', 'shifts', 'sigma', 'normals',
               'edge_sigma', 'measured')


def _plain(exposure: Exposure, edge_sigma: float, wraps: bool) -> dict[str, Any]:
    # All that there is of a frame without effects by the stage WRAP.
    twin = replace(exposure)
    _light(twin)
    twin.shifts = twin.no_shifts()
    _expect_noise(twin, edge_sigma)
    _show_other_surfaces(twin)
    _measure(twin, wraps)
    return {name: getattr(twin, name) for name in _UNTIL_WRAP}


def _blank_outside(exposure: Exposure) -> None:
    exposure.measured = np.ascontiguousarray(exposure.measured)
    blank_outside(exposure.measured, np.float32(exposure.mode.range_min),
                  np.float32(exposure.mode.range_max))


def _light(exposure: Exposure) -> None:
    # The light that comes back from each pixel's surface.
    def make() -> tuple[Surface, np.ndarray, np.ndarray]:
        depth = (np.ascontiguousarray(exposure.depth) if exposure.common is None
                 else np.array(exposure.depth, order='C'))
        surface = analyse(depth, exposure.intrinsics)
        inverse = surface.inverse_depth[PAD:-PAD, PAD:-PAD]
        depth[inverse == 0] = np.nan
        return surface, depth, exposure.reflectivity * surface.cos_incidence * inverse * inverse

    common = exposure.common
    exposure.surface, depth, amplitude = once(_scene(common), 'light', make)
    exposure.depth, exposure.amplitude = _own(common, depth), _own(common, amplitude)
    exposure.cosine = exposure.surface.cos_incidence.copy()


def _scene(common: Common | None) -> dict[Any, Any] | None:
    return None if common is None else common.scene


def _frame(common: Common | None) -> dict[Any, Any] | None:
    return None if common is None else common.frame


def _own(common: Common | None, image: np.ndarray) -> np.ndarray:
    return image if common is None else image.copy()


def _expect_noise(exposure: Exposure, edge_sigma: float) -> None:
    def make() -> np.ndarray:
        noise, surface = exposure.mode.noise, exposure.surface
        sigma = np.empty(exposure.depth.shape, np.float32)
        coefficients = np.array([noise.a, noise.b, noise.c, noise.d, noise.n], np.float32)
        model_sigma(surface.inverse_depth, surface.cos_incidence, coefficients,
                    np.float32(camera_config().incidence_cap), sigma)
        return sigma

    common = exposure.common
    exposure.sigma = _own(common, once(_scene(common), 'sigma', make))
    exposure.normals = _own(common, once(_frame(common), _NORMALS,
                                         lambda: _normals(exposure)))
    exposure.edge_sigma = edge_sigma


def _normals(exposure: Exposure) -> np.ndarray:
    normals = np.empty(exposure.depth.shape, np.float32)
    low, high = stamp_words(exposure.stamp)
    fill_normals(exposure.key, low, high, STREAM_AXIAL, normals.ravel())
    return normals


def _show_other_surfaces(exposure: Exposure) -> None:
    # Lateral noise: near edges, pixels take over what another pixel sees.
    common = exposure.common
    moved, origin = once(_frame(common),
                         ('moved', exposure.edge_sigma, exposure.edge_laplace),
                         lambda: _moved(exposure))
    if not moved.size:
        return
    exposure.sigma = np.ascontiguousarray(exposure.sigma)
    for image in (exposure.depth, exposure.amplitude, exposure.sigma, exposure.cosine,
                  *exposure.shifts):
        flat = image.reshape(-1)
        flat[moved] = flat[origin]


def _moved(exposure: Exposure) -> tuple[np.ndarray, np.ndarray]:
    # Flat indices: which pixels see something else, and where that is.
    surface = exposure.surface
    common = exposure.common

    def make() -> tuple[np.ndarray, np.ndarray, int]:
        rows, columns = np.empty_like(surface.row_jumps), np.empty_like(surface.row_jumps)
        return rows, columns, upright_edges(surface.row_jumps, surface.column_jumps, rows, columns)

    rows, columns, edges = once(_scene(common), 'edges', make)
    if not edges or exposure.edge_sigma <= 0:
        return _NOWHERE, _NOWHERE
    sigma = pixel_sigma(exposure.edge_sigma)
    limit = min(math.ceil((5 + 5 * exposure.edge_laplace) * exposure.edge_sigma), 127)
    source = np.empty(exposure.depth.size, np.int32)
    low, high = stamp_words(exposure.stamp)
    displaced_sources(rows, columns, camera_config().neighbourhood_px, np.float32(sigma), limit,
                      exposure.key, low, high, np.float32(exposure.edge_laplace), source)
    moved = np.flatnonzero(source != np.arange(source.size, dtype=np.int32))
    return moved, source[moved]


def _measure(exposure: Exposure, wraps: bool) -> None:
    mode = exposure.mode
    shift, *others = (np.float32(weight) * one for weight, one in
                      zip(exposure.weights, exposure.shifts, strict=True))
    for one in others:
        shift += one
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
