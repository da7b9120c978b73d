"""How much given effects reduce a gap; their parameters are not fitted."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.prior import USUAL
from flexx2_sim_ros.gap.features.confirm import confirm
from flexx2_sim_ros.gap.features.simulation import counts_edges
from flexx2_sim_ros.gap.given_effects import fit_without_and_with
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.improvement import simulated_losses
from flexx2_sim_ros.gap.work import at_pose, find, jobs_at
from flexx2_sim_ros.jobs import bind, workers
import numpy as np


def measure(
    campaign_dir: str | Path,
    effects: Mapping[str, Mapping[str, float]],
    seed: int = 0,
    *,
    profile: Profile | None = None,
    jobs: int = 1,
    pose_prior: tuple[float, float] | None = None,
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
    pose_prior : tuple of float, optional
        Standard deviations of the pose error of a recording: metres and degrees. They hold the
        poses; left out, poses may be as wrong as they seem.

    Returns
    -------
    dict
        ``before``, ``after``, ``null`` and ``shrink`` of the loss, as ``gap.loss`` in
        ``docs/diagnosis.md``. ``shrink`` is None if there is no gap to take away: then the
        difference of ``before`` and ``null`` is below 5.5 per recording.

    Raises
    ------
    InputError
        When no recording or effect can be used.

    """
    metres, degrees = pose_prior or USUAL
    parsed = parse_effects(effects)
    with workers(jobs, None) as mapped:
        found, left_out = find(campaign_dir, profile, mapped)
        fitted = fit_without_and_with(
            campaign_dir,
            found,
            left_out,
            parsed,
            profile=profile,
            seed=seed,
            prior=np.array([metres] * 3 + [degrees] * 3),
            held=pose_prior is not None,
            mapped=mapped,
            progress=lambda text, fraction: None,
        )
        motions = [after for _, after in fitted.motions()]
        table = table_of(one for one in parsed if one.role != 'pose')
        tables = [table] * len(motions)
        work = bind(at_pose, look=confirm, profile=profile, seed=seed)
        there = jobs_at(fitted.found, motions, effects=tables, wrong=tables)
        simulated = mapped(work, there, lambda: None)
    without, given = zip(fitted.models, fitted.fits, strict=True)
    losses = simulated_losses(without, given, simulated, motions, counts_edges(table))
    before, after, null = (float(one) for one in losses.sum(axis=0))
    excess = before - null
    # Poses can take over what effects would explain, as an offset in front of a wall.
    gap = excess >= THRESHOLDS.gap * len(fitted.found)
    shrink = float(np.clip((before - after) / excess, -1, 1)) if gap else None
    return {'before': before, 'after': after, 'null': null, 'shrink': shrink}
