"""How much given effects reduce a gap; their parameters are not fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import ageing, Effect, of_role, parse_effects
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.given import given_effects, in_one_table, Table
from flexx2_sim_ros.gap.data.pose import NAMES, STEPS
from flexx2_sim_ros.gap.data.prior import USUAL
from flexx2_sim_ros.gap.features.catalogue import (
    Candidate,
    CandidateTerm,
    catalogue,
    Column,
    nuisances,
)
from flexx2_sim_ros.gap.features.confirm import confirm
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.search import inside_of
from flexx2_sim_ros.gap.features.simulation import counts_edges, definitions
from flexx2_sim_ros.gap.features.work import (
    at_pose,
    find,
    jobs_at,
    Progress,
    Simulator,
    stepper,
    summarise_all,
)
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.fitting import Fit, fit
from flexx2_sim_ros.gap.inference.improvement import simulated_losses
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.jobs import workers
import numpy as np

_SET = 'set'


@dataclass(frozen=True)
class FittedRecordings:
    """
    Recordings fitted without and with effects, each at the poses that suit.

    `unusable` has name and reason of each recording that is not in `found`. The summaries in
    `evidence` are at the poses fitted with the effects; `models` and `fits` are without and with
    them.
    """

    found: list[Found]
    unusable: list[tuple[str, str]]
    evidence: list[Evidence]
    models: tuple[Model, Model]
    fits: tuple[Fit, Fit]

    def motions(self) -> list[list[np.ndarray]]:
        """Return the recordings' poses and planes without and with effects, as for `place`."""
        pairs = zip(self.models, self.fits, strict=True)
        return [model.own.found(one.nuisances) for model, one in pairs]

    def losses(self) -> np.ndarray:
        """
        Return each recording's loss, (R, 3): before, after, and of a perfect simulation.

        The loss of poses and other nuisances is divided evenly among the recordings.
        """
        poses = [one.pose_loss / len(self.found) for one in self.fits]
        null = self.models[1].null_loss.sum(axis=1) + THRESHOLDS.floor
        before, after = (one.loss for one in self.fits)
        return np.stack([before + poses[0], after + poses[1], null + poses[1]], axis=1)


def fit_without_and_with(
    folder: str | Path,
    found: Sequence[Found],
    left_out: Sequence[tuple[str, str]],
    effects: tuple[Effect, ...],
    simulator: Simulator,
    held: bool,
    progress: Progress,
) -> FittedRecordings:
    """
    Fit recordings without and with effects.

    For effects that shift surfaces, the poses are fitted twice, for a camera without and with
    these effects: a pose that is fitted alone can take over what an effect explains. Raises
    `InputError` when no recording can be used.

    * `folder`, `left_out`: the campaign, and name and reason of each recording that was left out
      before; for errors.
    * `effects`: what is given. A pose error is where the poses of the recordings lie about.
    * `simulator`: how they are simulated; columns and what is inside the camera follow from the
      effects.
    * `held`: whether the prior of the simulator holds the poses; see `Model`.
    """
    deviation = np.array(simulator.prior)
    table = table_of(effects)
    posed = table.pop(of_role('pose').name, None)
    shifting = _shift_surfaces(table)
    rest = {name: values for name, values in table.items() if name not in shifting}
    wanted = nuisances().columns
    columns = [
        one for one in catalogue((), bool(found[0].mode.modulation_hz))[0] if one.name in wanted
    ]
    more = [*columns, Column(_SET, rest, few=False)] if rest else columns

    rounds = 2 if shifting else 1
    step = stepper(progress, 'simulating the recordings', 0.0, 1.0, rounds * len(found))

    def summaries(
        some: Sequence[Found], what: list[Column], given: Table
    ) -> tuple[list[Found], list[Evidence], list[tuple[str, str]]]:
        told = replace(simulator, columns=what, known=given, inside=inside_of(effects))
        return summarise_all(folder, some, left_out, told, step)

    known = simulator.known
    with_known = in_one_table(given_effects(known), shifting) if shifting else known
    used, after, unusable = summaries(found, more, with_known)
    if shifting:
        _, before, _ = summaries(used, columns, known)
        one = Model(before, columns, deviation, held=held)
    else:
        one = Model(after, more, deviation, held=held)
    models = one, Model(after, more, deviation, held=held)
    if posed is not None:
        centre = np.array([posed[name] * posed['strength'] for name in NAMES])
        models[1].own.centre = centre / STEPS
    fits = fit(models[0], []), _fit_set(models[1], rest)
    return FittedRecordings(used, unusable, after, models, fits)


def _shift_surfaces(table: Table) -> Table:
    # Those effects that shift whole surfaces, as a pose error does. What depends on the time since
    # power-on is none of them: a recording that does not say its own would get another one's.
    kinds = zip(table.items(), definitions(table), strict=True)
    old = ageing(table)
    return {
        name: values
        for (name, values), kind in kinds
        if 'bias' in kind.changes and not kind.repeats and name not in old
    }


def _fit_set(model: Model, table: Table) -> Fit:
    if not table:
        return fit(model, [])
    on = CandidateTerm('on', ((1.0, _SET),), 1.0, 1.0)
    return fit(model, [Candidate(_SET, '', (on,), lambda values: {})], np.ones(1))


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
    seed, profile, jobs, pose_prior
        As for `diagnose`.

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
    parsed = parse_effects(effects)
    prior = tuple(np.repeat(pose_prior or USUAL, 3))
    with workers(jobs, None) as mapped:
        found, left_out = find(campaign_dir, profile, mapped)
        simulator = Simulator(mapped, profile, {}, seed, prior)
        fitted = fit_without_and_with(
            campaign_dir,
            found,
            left_out,
            parsed,
            simulator,
            pose_prior is not None,
            lambda text, fraction: None,
        )
        _, motions = fitted.motions()
        table = table_of(one for one in parsed if one.role != 'pose')
        tables = [table] * len(motions)
        there = jobs_at(fitted.found, motions, effects=tables, wrong=tables)
        simulated = simulator.run(at_pose, there, look=confirm)
    without, given = zip(fitted.models, fitted.fits, strict=True)
    losses = simulated_losses(without, given, simulated, motions, counts_edges(table))
    before, after, null = (float(one) for one in losses.sum(axis=0))
    excess = before - null
    # Poses can take over what effects would explain, as an offset in front of a wall.
    gap = excess >= THRESHOLDS.gap * len(fitted.found)
    shrink = float(np.clip((before - after) / excess, -1, 1)) if gap else None
    return {'before': before, 'after': after, 'null': null, 'shrink': shrink}
