"""Cameras with many effects: what each contributes, and how much of that was found."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.recording import load_recording
import numpy as np
from scipy.stats import spearmanr
from study.benchmark.design import Planned
from study.benchmark.realised import apart_of, FRESH
from study.blind import BlindCamera, SceneSet

_SHOWN = 3  # frames of each recording that say what an effect contributes


def contributions(planned: Planned, cache: Path) -> dict[str, float]:
    """
    Return by how much the images of fresh scenes change when the camera loses each effect.

    It is the distance of `realised`, a mean over recordings.
    """
    case, seed = planned.case, planned.scene_seed + FRESH
    key = replace(case.scenes, seed=seed, pose_mm=0.0, frames=_SHOWN)
    scenes = SceneSet(key, cache)

    def recorded(folder: Path, lost: str) -> list[Path]:
        folder.mkdir()
        camera = BlindCamera(replace(case, scenes=key), scenes)
        camera.effects = tuple(one for one in camera.effects if one.name != lost)
        camera.record(folder)
        return sorted(folder.iterdir())

    out = {}
    with scratch_folder() as folder:
        all_ = recorded(folder / 'all', '')
        for name in planned.effects:
            pairs = zip(all_, recorded(folder / name, name), strict=True)
            apart = [apart_of(*map(load_recording, pair)) for pair in pairs]
            out[name] = round(float(np.mean([one for one, _ in apart])), 4)
    return out


def recall(true: Mapping[str, float], named: Sequence[str]) -> float:
    """Return the share of what all effects contribute that is named; NaN of nothing."""
    whole = sum(true.values())
    return (
        sum(value for name, value in true.items() if name in named) / whole if whole else math.nan
    )


def order(effects: Sequence[Mapping[str, Any]], true: Mapping[str, float]) -> float:
    """
    Return the rank correlation of what named effects take off with what they contribute.

    `effects` is as in the diagnosis. NaN with fewer than three true ones.
    """
    rows = [one for one in effects if one['name'] in true and one['takes_off']]
    if len(rows) < 3:
        return math.nan
    taken = [one['takes_off']['distance']['mean'] for one in rows]
    return float(spearmanr(taken, [true[one['name']] for one in rows]).statistic)
