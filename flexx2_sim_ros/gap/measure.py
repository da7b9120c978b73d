"""How much given effects reduce a gap; their parameters are not fitted."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import of_role, parse_effects
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.pose import NAMES, STEPS
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue, Column, nuisances, Term
from flexx2_sim_ros.gap.features.search import inside_of
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.fitting import fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.work import find, Simulations, summarise_all
from flexx2_sim_ros.jobs import workers
import numpy as np


def measure(
    campaign_dir: str | Path,
    effects: Mapping[str, Mapping[str, float]],
    seed: int = 0,
    *,
    profile: Profile | None = None,
    jobs: int = 1,
    pose_prior: tuple[float, float] = (0.010, 0.5),
) -> dict[str, Any]:
    """
    Measure the gap of a campaign without and with effects.

    Parameters
    ----------
    campaign_dir : str or pathlib.Path
        A folder of recordings.
    effects : mapping
        Parameters by effect; they are used unchanged.
    seed : int
        Seed of the simulations.
    profile : Profile, optional
        The camera (default: the Flexx2).
    jobs : int
        Number of processes.
    pose_prior : tuple of float
        Standard deviations of the pose error of a recording: metres and degrees.

    Returns
    -------
    dict
        ``before``, ``after``, ``null`` and ``shrink`` of the loss, as ``gap.loss`` in
        ``docs/diagnosis.md``.

    Raises
    ------
    InputError
        When no recording or effect can be used.

    """
    parsed = parse_effects(effects)
    table = table_of(parsed)
    prior = np.array([pose_prior[0]] * 3 + [pose_prior[1]] * 3)
    posed = table.pop(of_role('pose').name, None)
    with workers(jobs, None) as mapped:
        found, left_out = find(campaign_dir, profile, mapped)
        columns = [
            c
            for c in catalogue((), bool(found[0].mode.modulation_hz))[0]
            if c.name in nuisances().columns
        ]
        if table:
            columns.append(Column('set', table, few=False))
        inside = inside_of(parsed)
        simulations = Simulations(profile, columns, seed, tuple(prior), inside=inside)
        _, evidence, _ = summarise_all(campaign_dir, found, left_out, simulations, mapped)
    model = Model(evidence, columns, prior)
    base = fit(model, [])
    on = Term('on', ((1.0, 'set'),), 1.0, 1.0)
    parts = [Candidate('set', '', (on,), lambda values: {})] if table else []
    if posed is not None:
        centre = np.array([posed[name] * posed['strength'] for name in NAMES])
        model.own.centre = centre / STEPS
    with_effects = fit(model, parts, np.ones(len(parts)))
    null = float(model.null_loss.sum()) + THRESHOLDS.floor * len(evidence) + with_effects.pose_loss
    before, after = base.inside, with_effects.inside
    return {
        'before': before,
        'after': after,
        'null': null,
        'shrink': float(np.clip((before - after) / max(before - null, 1e-9), -1, 1)),
    }
