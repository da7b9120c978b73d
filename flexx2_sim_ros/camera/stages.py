"""Make a frame with effects: the pipeline in the order of light."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from flexx2_sim_ros.physics.axial import (
    add_noise,
    blank_invalid,
    blank_outside,
    shine,
    sigma_image,
)
from flexx2_sim_ros.physics.frame_state import Common, EffectProtocol, FrameState, once, Stage
from flexx2_sim_ros.physics.lateral import displaced_pixels, edge_limit, pixel_sigma, upright_edges
from flexx2_sim_ros.physics.philox import fill_normals, stamp_words, STREAM_AXIAL
from flexx2_sim_ros.physics.surface import analyse, Surface
import numpy as np

_NOWHERE = np.zeros(0, np.int64)


def run_stages(
    state: FrameState, effects: Sequence[EffectProtocol], edge_sigma: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Run the stages in order, each with its effects, those that are on.

    ``state`` has depth and reflectivity, ``edge_sigma`` is the mode's sigma_x, pixels. Returned
    are depth, sigma, amplitude and confidence, (H, W) float32, as in `Frame`. Without any effect
    they are the base model's, up to float32 rounding.
    """
    measure(state, effects, edge_sigma)
    return _finish(state)


def measure(state: FrameState, effects: Sequence[EffectProtocol], edge_sigma: float) -> None:
    """Run the stages like `run_stages`, up to ``state.measured``."""
    ordered = sorted(effects, key=lambda effect: (effect.stage, effect.order, effect.name))
    by_stage = {
        stage: list(group) for stage, group in groupby(ordered, key=lambda effect: effect.stage)
    }

    def run(stage: Stage) -> None:
        for effect in by_stage.get(stage, ()):
            effect.apply(state)

    wraps = bool(by_stage.get(Stage.WRAP))
    common = state.common
    state.memory.begin(state.stamp)
    if common is None or any(stage < Stage.WRAP for stage in by_stage):
        if common is None or Stage.GEOMETRY not in by_stage:
            run(Stage.GEOMETRY)
        else:
            _see_another_scene(state, common, by_stage[Stage.GEOMETRY])
        _light(state)
        run(Stage.AMPLITUDE)
        state.shifts = state.no_shifts()
        run(Stage.PHASOR)
        _expect_noise(state, edge_sigma)
        run(Stage.NOISE)
        _show_other_surfaces(state)
        _measure(state, wraps)
    else:
        plain = once(common.frame, ('plain', wraps), lambda: _plain(state, edge_sigma, wraps))
        for name, image in plain.items():
            setattr(state, name, image)
        state.measured = state.measured.copy()
    run(Stage.WRAP)
    _blank_outside(state)
    run(Stage.FILTER)
    if by_stage.get(Stage.STORAGE):
        run(Stage.STORAGE)
        _blank_outside(state)
    run(Stage.DROPOUT)


def _see_another_scene(
    state: FrameState, common: Common, effects: Sequence[EffectProtocol]
) -> None:
    # The random numbers are the same. What effects that keep nothing make of the scene is the same
    # for all frames that share it; the latest of it is kept.
    def make() -> tuple[np.ndarray, np.ndarray]:
        state.depth, state.reflectivity = state.depth.copy(), state.reflectivity.copy()
        for effect in effects:
            effect.apply(state)
        return state.depth, state.reflectivity

    scene: dict[Any, Any] = {}
    if not any(getattr(effect, 'keeps', True) for effect in effects):
        key, kept = common.scene.get('other', (None, scene))
        scene = kept if key == tuple(effects) else scene
        common.scene['other'] = tuple(effects), scene
    normals = once(common.frame, _NORMALS, lambda: _normals(state))
    state.depth, state.reflectivity = once(scene, 'view', make)
    state.common = Common(scene, {_NORMALS: normals})


_NORMALS = 'normals'
_UNTIL_WRAP = (
    'surface',
    'depth',
    'amplitude',
    'cosine',
    'shifts',
    'sigma',
    'normals',
    'edge_sigma',
    'measured',
)


def _plain(state: FrameState, edge_sigma: float, wraps: bool) -> dict[str, Any]:
    # All that there is of a frame without effects by the stage WRAP.
    twin = replace(state)
    _light(twin)
    twin.shifts = twin.no_shifts()
    _expect_noise(twin, edge_sigma)
    _show_other_surfaces(twin)
    _measure(twin, wraps)
    return {name: getattr(twin, name) for name in _UNTIL_WRAP}


def _blank_outside(state: FrameState) -> None:
    state.measured = np.ascontiguousarray(state.measured)
    blank_outside(
        state.measured, np.float32(state.mode.range_min), np.float32(state.mode.range_max)
    )
    outside = state.mode.sensor.outside(state.intrinsics)
    if outside is not None:
        state.measured[outside] = np.nan


def _light(state: FrameState) -> None:
    # The light that comes back from each pixel's surface.
    def make() -> tuple[Surface, np.ndarray, np.ndarray]:
        depth = (
            np.ascontiguousarray(state.depth)
            if state.common is None
            else np.array(state.depth, order='C')
        )
        surface = analyse(depth, state.intrinsics, state.mode.sensor)
        amplitude = np.empty(depth.shape, np.float32)
        shine(surface.inverse_depth, surface.cos_incidence, state.reflectivity, depth, amplitude)
        return surface, depth, amplitude

    common = state.common
    state.surface, depth, amplitude = once(_scene(common), 'light', make)
    state.depth, state.amplitude = _own(common, depth), _own(common, amplitude)
    state.cosine = state.surface.cos_incidence.copy()


def _scene(common: Common | None) -> dict[Any, Any] | None:
    return None if common is None else common.scene


def _frame(common: Common | None) -> dict[Any, Any] | None:
    return None if common is None else common.frame


def _own(common: Common | None, image: np.ndarray) -> np.ndarray:
    return image if common is None else image.copy()


def _expect_noise(state: FrameState, edge_sigma: float) -> None:
    def make() -> np.ndarray:
        own = state.reflectivity if state.reflectivity.size > 1 else None
        return sigma_image(state.surface, state.mode.noise, own)

    common = state.common
    state.sigma = _own(common, once(_scene(common), 'sigma', make))
    state.normals = _own(common, once(_frame(common), _NORMALS, lambda: _normals(state)))
    state.edge_sigma = edge_sigma


def _normals(state: FrameState) -> np.ndarray:
    normals = np.empty(state.depth.shape, np.float32)
    low, high = stamp_words(state.stamp)
    fill_normals(state.key, low, high, STREAM_AXIAL, normals.ravel())
    return normals


def _show_other_surfaces(state: FrameState) -> None:
    # Lateral noise: near edges, pixels take over what another pixel sees.
    common = state.common
    moved, origin = once(
        _frame(common), ('moved', state.edge_sigma, state.edge_laplace), lambda: _moved(state)
    )
    if not moved.size:
        return
    state.sigma = np.ascontiguousarray(state.sigma)
    # NumPy would turn them into its own type of index for every image.
    moved, origin = moved.astype(np.intp), origin.astype(np.intp)
    for image in (state.depth, state.amplitude, state.sigma, state.cosine, *state.shifts):
        flat = image.reshape(-1)
        flat[moved] = flat.take(origin)


def _moved(state: FrameState) -> tuple[np.ndarray, np.ndarray]:
    # Flat indices: which pixels see something else, and where that is.
    surface = state.surface
    common = state.common

    row_edges, column_edges = once(
        _scene(common), 'edges', lambda: upright_edges(surface.row_jumps, surface.column_jumps)
    )
    if state.edge_sigma <= 0:
        return _NOWHERE, _NOWHERE
    moved, origin = displaced_pixels(
        row_edges,
        column_edges,
        *state.depth.shape,
        state.mode.sensor.neighbourhood_px,
        np.float32(pixel_sigma(state.edge_sigma)),
        edge_limit(state.edge_sigma, state.edge_laplace),
        state.key,
        *stamp_words(state.stamp),
        np.float32(state.edge_laplace),
    )
    return moved, origin


def _measure(state: FrameState, wraps: bool) -> None:
    mode = state.mode
    shift, *others = (
        np.float32(weight) * one for weight, one in zip(state.weights, state.shifts, strict=True)
    )
    for one in others:
        shift += one
    low, high = np.float32(mode.range_min), np.float32(mode.range_max)
    if wraps:
        # What lies beyond the range is not recognised as such; see the effect range_wrap.
        low, high = np.float32(0), np.float32(np.finfo(np.float32).max)
    state.measured = np.empty_like(state.depth)
    add_noise(state.depth, shift, state.sigma, state.normals, low, high, state.measured)


def _finish(state: FrameState) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    sigma, amplitude, confidence = (np.empty_like(state.depth) for _ in range(3))
    blank_invalid(
        state.measured,
        state.sigma,
        state.amplitude,
        np.float32(state.mode.sensor.zero_at_sigma_m),
        sigma,
        amplitude,
        confidence,
    )
    if state.saturated is not None:
        amplitude[state.saturated] = state.amplitude[state.saturated]
    return state.measured, sigma, amplitude, confidence
