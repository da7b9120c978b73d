"""How much of the gap a diagnosis really closes, in scenes nobody has seen."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.camera import Camera, flexx2, Profile
from flexx2_sim_ros.effects import ageing, of_role
from flexx2_sim_ros.recording import load_recording, Recording
import numpy as np
from study.benchmark.design import Planned
from study.blind import BlindCamera, SceneSet

FRESH = 500  # added to the seed of the scenes, within the same range of seeds
_FRAMES = 8
_QUANTILES = np.linspace(0.005, 0.995, 199)
_TILES = 4, 5  # rows and columns; the diagnosis has 3 and 4
_FEWEST = 100  # errors in a tile
# docs/diagnosis.md defines the distance: a Wasserstein distance of so many sigma_z counts as
# much as a difference of so many invalid pixels.
_SIGMAS, _INVALID = 0.1, 0.008
_LEAST = 1.0  # A smaller distance between camera and simulation is no gap to be closed.
_CLIP = 6.0


def realised_gap(
    planned: Planned,
    diagnosis: dict[str, Any],
    cache: Path,
    measure: Callable[..., Any],
    *,
    offset: int = FRESH,
) -> dict[str, float | None]:
    """
    Record the same camera in other scenes and simulate it with the diagnosed effects.

    The scorer knows what a user does not: where the camera is, the reflectivity, and how much
    noisier the camera is than the paper's. An effect on the level of the noise includes that.

    * `cache`: cache of scenes
    * `measure`: the diagnosis's own gap: ``measure(folder, effects, seed=0)`` returns a mapping
      with ``shrink``, the fraction of the loss that goes away with a table of effects, or None if
      there is no gap. It is called where the gap does not show in depth and invalid pixels, as
      with steps of half a millimetre.
    * `offset`: added to the seed of the scenes. 0 records the scenes of the case again.

    Returns ``shrink``, the fraction of the distance that goes away, or None if there is no gap;
    ``before``, ``after`` and ``null`` of it; ``before_mm``, ``after_mm`` and ``null_mm``, the
    Wasserstein-1 distance of depth errors. All but a ``shrink`` from `measure` are computed here,
    without code of the diagnosis.
    """
    effects = {
        effect['name']: effect['parameters']
        for effect in diagnosis['effects']
        if effect['name'] != of_role('pose').name  # ``effects.yaml`` does not have it either
    }
    case = planned.case
    seed = case.scenes.seed + offset
    key = replace(case.scenes, seed=seed, frames=_FRAMES, pose_mm=0.0)
    scenes = SceneSet(key, cache)
    camera = BlindCamera(replace(case, scenes=key, reflectivity_error=0.0), scenes)
    level = of_role('sigma').name in effects
    profile = flexx2() if level else flexx2().noisier(camera.sigma_factor)
    with scratch_folder() as folder:
        camera.record(folder)
        null, before, after = distances(folder, effects, profile)
        out: dict[str, float | None] = {}
        for name, (apart, millimetres) in (('before', before), ('after', after), ('null', null)):
            out |= {name: float(apart), f'{name}_mm': float(millimetres)}
        if is_independent(out):
            shrink = (before[0] - after[0]) / (before[0] - null[0])
        else:
            shrink = measure(folder, effects, seed=0)['shrink']
    return {'shrink': None if shrink is None else float(shrink), **out}


def is_independent(realised: Mapping[str, float | None]) -> bool:
    """Return whether `realised_gap` measured a reduction without code of the diagnosis."""
    before, null = realised.get('before'), realised.get('null')
    return before is not None and null is not None and before - null >= _LEAST


def distances(folder: Path, effects: dict[str, Any], profile: Profile) -> np.ndarray:
    """
    Compare recordings whose poses are exact with simulations without and with effects.

    * `effects`: parameters by effect
    * `profile`: the camera without the effects

    Returns (3, 2): of two simulations with the effects, of recordings and simulations without, and
    with them; as the distance of ``docs/diagnosis.md``, and in millimetres. Means over the
    recordings.
    """
    rows = [_distances(path, effects, profile) for path in sorted(folder.iterdir())]
    return np.asarray(np.nanmean(rows, axis=0))


def _distances(path: Path, effects: dict[str, Any], profile: Profile) -> np.ndarray:
    # (3, 2) of one recording. The first is what the right effects would leave: effects that add
    # noise put two simulations farther apart, too.
    recording = load_recording(path)
    inputs = recording.clean_depth, recording.K, recording.stamp_ns, recording.reflectivity
    uptime = recording.extra.get('uptime')
    own = _since(effects, uptime)
    tables = (), own, own
    plain, better, again = (
        Camera(recording.usecase or '', profile=profile, effects=table, seed=seed).capture(*inputs)
        for table, seed in zip(tables, (1, 1, 2), strict=True)
    )
    seen = [
        _tiles(depth, recording, plain.sigma)
        for depth in (recording.depth, plain.depth, better.depth, again.depth)
    ]
    real, without, with_effects, once_more = seen
    return np.array(
        [_apart(with_effects, once_more), _apart(real, without), _apart(real, with_effects)]
    )


def apart_of(one: Recording, other: Recording) -> tuple[float, float]:
    """Return how far two recordings of the same scene are apart, as `distances`."""
    mode = Camera(one.usecase or '', seed=1)
    inputs = one.clean_depth, one.K, one.stamp_ns, one.reflectivity
    sigma = mode.capture(*inputs).sigma
    return _apart(_tiles(one.depth, one, sigma), _tiles(other.depth, one, sigma))


def _tiles(
    depth: np.ndarray, recording: Recording, sigma: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    # Of each tile: the quantiles of errors in sigma_z and in metres, the fraction of invalid
    # pixels where there is something to be seen.
    clean = np.broadcast_to(np.asarray(recording.clean_depth), depth.shape)
    sigma = np.broadcast_to(sigma, depth.shape)
    there = np.isfinite(sigma) & (sigma > 0)
    error = np.where(there, depth - clean, np.nan)
    out = []
    for rows in np.array_split(np.arange(depth.shape[1]), _TILES[0]):
        for columns in np.array_split(np.arange(depth.shape[2]), _TILES[1]):
            tile = np.s_[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            metres, visible = error[tile], there[tile]
            normal = np.clip(metres / sigma[tile], -_CLIP, _CLIP)
            lost = np.mean(~np.isfinite(depth[tile][visible])) if visible.any() else np.nan
            out.append((_quantiles(normal), _quantiles(metres), float(lost)))
    return out


def _quantiles(errors: np.ndarray) -> np.ndarray:
    valid = errors[np.isfinite(errors)]
    if valid.size < _FEWEST:
        return np.full(len(_QUANTILES), np.nan)
    return np.asarray(np.quantile(valid, _QUANTILES))


def _apart(
    one: list[tuple[np.ndarray, np.ndarray, float]],
    other: list[tuple[np.ndarray, np.ndarray, float]],
) -> tuple[float, float]:
    # The Wasserstein-1 distance is the mean difference of quantiles. Where no tile has enough
    # valid pixels in both, only lost pixels differ.
    differences = [
        [np.abs(np.subtract(a[k], b[k])).mean() for k in range(3)]
        for a, b in zip(one, other, strict=True)
    ]
    normal, metres, lost = np.ma.masked_invalid(differences).mean(axis=0).filled(0.0)
    return float(normal / _SIGMAS + lost / _INVALID), float(1e3 * metres)


def _since(effects: dict[str, Any], uptime: np.ndarray | None) -> dict[str, Any]:
    # Effects of warming up need the uptime of the first frame.
    if uptime is None:
        return effects
    since = {'uptime': float(uptime.flat[0])}
    return {**effects, **{name: {**effects[name], **since} for name in ageing(effects)}}
