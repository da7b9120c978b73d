"""How much of the gap a diagnosis really closes, on recordings nobody has seen."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import ageing
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.blind import BlindCamera, SceneSet
import numpy as np

_FRESH = 500  # added to the scene seed: other scenes of the same range
_FRAMES = 8
_QUANTILES = np.linspace(0.005, 0.995, 199)


def realised_gap(
    planned: Planned, diagnosis: dict[str, Any], cache: Path, measure: Callable[..., Any]
) -> dict[str, float]:
    """
    Record the same camera in other scenes and simulate it as the diagnosis says.

    Parameters
    ----------
    planned : Planned
        The case.
    diagnosis : dict
        With effects.
    cache : pathlib.Path
        Of scenes.
    measure : callable
        The diagnosis's own gap: ``measure(folder, effects, seed=0)`` returns a mapping with
        ``shrink``, the share of the gap that goes away with a table of effects.

    Returns
    -------
    dict of str to float
        ``shrink`` in the diagnosis's unit; ``before_mm``, ``after_mm`` and ``null_mm``, the
        Wasserstein-1 distance of residuals, computed here.

    """
    effects = {effect['name']: effect['parameters'] for effect in diagnosis['effects']}
    case = planned.case
    scenes = SceneSet(replace(case.scenes, seed=case.scenes.seed + _FRESH, frames=_FRAMES), cache)
    with scratch_folder() as folder:
        BlindCamera(replace(case, scenes=scenes.key), scenes).record(folder)
        shrink = float(measure(folder, effects, seed=0)['shrink'])
        distances = np.array([_distances(path, effects) for path in sorted(folder.iterdir())])
    null, before, after = np.nanmean(distances, axis=0) * 1e3
    return {
        'shrink': shrink,
        'null_mm': float(null),
        'before_mm': float(before),
        'after_mm': float(after),
    }


def _distances(path: Path, effects: dict[str, Any]) -> tuple[float, float, float]:
    # Of the plain simulation from itself, of the recording from it, of the recording from the
    # simulation with effects; metres.
    recording = load_recording(path)
    inputs = recording.clean_depth, recording.K, recording.stamp_ns, recording.reflectivity
    clean = np.broadcast_to(np.asarray(recording.clean_depth), recording.depth.shape)
    uptime = recording.extra.get('uptime')
    spread = [
        _quantiles(depth - clean)
        for depth in (
            recording.depth,
            *(
                Camera(recording.usecase or '', effects=table, seed=seed).capture(*inputs).depth
                for table, seed in (((), 1), ((), 2), (_since(effects, uptime), 1))
            ),
        )
    ]
    real, plain, again, better = spread
    return (
        float(np.abs(plain - again).mean()),
        float(np.abs(real - plain).mean()),
        float(np.abs(real - better).mean()),
    )


def _since(effects: dict[str, Any], uptime: np.ndarray | None) -> dict[str, Any]:
    # A camera that warms up counts from its own first frame: say how long it had been on.
    if uptime is None:
        return effects
    since = {'uptime': float(uptime.flat[0])}
    return {**effects, **{name: {**effects[name], **since} for name in ageing(effects)}}


def _quantiles(residual: np.ndarray) -> np.ndarray:
    valid = residual[np.isfinite(residual)]
    return np.quantile(valid, _QUANTILES) if valid.size else np.full(len(_QUANTILES), np.nan)
