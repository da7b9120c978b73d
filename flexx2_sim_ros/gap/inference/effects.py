"""The effects of a fit, with the parameters that it found."""

from collections.abc import Iterable
from typing import Any

from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.pose import NAMES
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.model import Model
import numpy as np


def fitted_effects(model: Model, fit: Fit) -> list[Effect]:
    """Return the effect of each candidate of a fit, its parameters clipped to their bounds."""
    return _effects(model, fit, fit.values)


def held_out_effects(model: Model, fit: Fit) -> list[list[Effect]]:
    """
    Return `fitted_effects` for each recording, as fitted without that recording.

    A single recording cannot be left out: its effects are those that were fitted to it.
    """
    values = fit.left_out if len(fit.left_out) > 1 else fit.values[None]
    return [_effects(model, fit, row) for row in values]


def _effects(model: Model, fit: Fit, all_values: np.ndarray) -> list[Effect]:
    out, start = [], 0
    for candidate in fit.candidates:
        values = all_values[start : start + len(candidate.terms)]
        start += len(candidate.terms)
        out.append(_effect(model, fit, candidate, tuple(float(v) for v in values)))
    return out


def _effect(model: Model, fit: Fit, candidate: Candidate, values: tuple[float, ...]) -> Effect:
    kind = registry()[candidate.effect]
    if kind.role == 'pose':
        mean = np.mean([one[:POSE] for one in model.own.found(fit.nuisances)], axis=0)
        table = dict(zip(NAMES, (float(v) for v in mean), strict=True))
    else:
        table = dict(candidate.build(values))
    if kind.lattice and not candidate.steps:
        steps = np.array([e.step for e in model.evidence])
        table[kind.lattice] = agreed_step(steps, table[kind.lattice])
    limits = {p.name: (p.low, p.high) for p in kind.parameters()}
    limits |= {name: (number.low, number.high) for name, number in kind.tables().items()}
    table = {
        k: float(np.clip(v, *limits[k])) if isinstance(v, float | int) else v
        for k, v in table.items()
    }
    return kind.from_mapping(table)


def agreed_step(steps: np.ndarray, fitted: float) -> float:
    """
    Return the step between depths, metres.

    That is the median of `steps`, (R,) from the histogram of each recording's depths, if these
    agree with each other or with `fitted`, which is less exact; otherwise `fitted`.
    """
    step = float(np.median(steps))
    agree = np.abs(steps / step - 1) < FEATURES.lattice_agreement
    if (len(steps) > 1 and agree.mean() > 0.5) or 0.5 < step / max(fitted, 1e-6) < 2:
        return step
    return fitted


def table_of(effects: Iterable[Effect]) -> dict[str, dict[str, Any]]:
    """Return the settings by effect, as `parse_effects` reads them."""
    return {effect.name: effect.settings for effect in effects}


def of_camera(effects: Iterable[Effect]) -> dict[str, dict[str, Any]]:
    """Return the settings of those effects that are simulated: an error of the poses is not."""
    return table_of(one for one in effects if one.role != 'pose')
