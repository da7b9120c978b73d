"""Recordings fitted without and with given effects, whose parameters are not fitted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import ageing, Effect, of_role
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.given import given_effects, in_one_table, Table
from flexx2_sim_ros.gap.data.pose import NAMES, STEPS
from flexx2_sim_ros.gap.features.catalogue import (
    Candidate,
    CandidateTerm,
    catalogue,
    Column,
    nuisances,
)
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.search import inside_of
from flexx2_sim_ros.gap.features.simulation import definitions
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.fitting import Fit, fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.work import Progress, Simulations, stepper, summarise_all
from flexx2_sim_ros.jobs import Map
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

    def motions(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return each recording's pose and planes without and with effects, as for `place`."""
        without, with_effects = (
            model.own.found(one.nuisances)
            for model, one in zip(self.models, self.fits, strict=True)
        )
        return list(zip(without, with_effects, strict=True))

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
    *,
    profile: Profile | None,
    seed: int,
    prior: np.ndarray,
    held: bool,
    mapped: Map,
    progress: Progress,
    known: Table | None = None,
) -> FittedRecordings:
    """
    Fit recordings without and with effects.

    For effects that shift surfaces, the poses are fitted twice: for a camera without these
    effects, and for one that is known to have them. A pose that is fitted alone can take over what
    an effect explains, for example an offset in front of a wall. The effect would then be added to
    a scene that already has it. Raises `InputError` when no recording can be used.

    * `folder`, `left_out`: the campaign, and name and reason of each recording that was left out
      before; for errors.
    * `effects`: what is given. A pose error is where the poses of the recordings lie about.
    * `profile`: the camera (None: the Flexx2).
    * `prior`: (6,) standard deviations of pose errors, metres and degrees.
    * `held`: whether they hold the poses; see `Model`.
    * `progress`: called with the name of the current step and the fraction of this work that is
      done.
    * `known`: effects that the base simulator has: parameters by name.
    """
    table = table_of(effects)
    posed = table.pop(of_role('pose').name, None)
    shifting = _shift_surfaces(table)
    rest = {name: values for name, values in table.items() if name not in shifting}
    columns = _nuisance_columns(found[0])
    more = [*columns, Column(_SET, rest, few=False)] if rest else columns

    rounds = 2 if shifting else 1
    step = stepper(progress, 'simulating the recordings', 0.0, 1.0, rounds * len(found))

    def summaries(
        some: Sequence[Found], what: list[Column], given: Table
    ) -> tuple[list[Found], list[Evidence], list[tuple[str, str]]]:
        simulations = Simulations(profile, what, seed, tuple(prior), given, inside_of(effects))
        return summarise_all(folder, some, left_out, simulations, mapped, step)

    known = known or {}
    with_known = in_one_table(given_effects(known), shifting) if shifting else known
    used, after, unusable = summaries(found, more, with_known)
    if shifting:
        _, before, _ = summaries(used, columns, known)
        one = Model(before, columns, prior, held=held)
    else:
        one = Model(after, more, prior, held=held)
    models = one, Model(after, more, prior, held=held)
    if posed is not None:
        centre = np.array([posed[name] * posed['strength'] for name in NAMES])
        models[1].own.centre = centre / STEPS
    return FittedRecordings(
        used, unusable, after, models, (fit(models[0], []), _fit_set(models[1], rest))
    )


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


def _nuisance_columns(one: Found) -> list[Column]:
    wanted = nuisances().columns
    columns = catalogue((), bool(one.mode.modulation_hz))[0]
    return [column for column in columns if column.name in wanted]


def _fit_set(model: Model, table: Table) -> Fit:
    if not table:
        return fit(model, [])
    on = CandidateTerm('on', ((1.0, _SET),), 1.0, 1.0)
    return fit(model, [Candidate(_SET, '', (on,), lambda values: {})], np.ones(1))
