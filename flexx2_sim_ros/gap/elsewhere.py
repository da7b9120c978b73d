"""The gap without and with effects, as it is in other scenes of the same camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.looked import Settings, Simulator
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.work import measure_apart
import numpy as np


@dataclass(frozen=True)
class Elsewhere:
    """
    Measures the outcome of recordings at the poses that `OwnErrors.elsewhere` gives.

    Attributes
    ----------
    model : Model
        The recordings.
    used : sequence of Found
        Their files.
    effects : sequence of Effect
        The named effects, a pose error included.
    simulator : Simulator
        How they are simulated.
    bare : sequence of numpy.ndarray or None
        Where each one is without effects, as for `confirm.confirm`.

    """

    model: Model
    used: Sequence[Found]
    effects: Sequence[Effect]
    simulator: Simulator
    bare: Sequence[np.ndarray | None]

    def other_poses(self, motions: Sequence[np.ndarray]) -> list[np.ndarray] | None:
        """
        Return the poses of other scenes, or None if they are the fitted ones.

        They are, if poses can hide no part of the effects, such as random dropout. What the poses
        have in common then is chance, or another cause that is not named.
        """
        posed = any(one.role == 'pose' for one in self.effects)
        if not posed and not any('pose' in one.nuisances for one in self.effects):
            return None
        poses = self.model.own.elsewhere(motions, posed)
        same = all(np.array_equal(*pair) for pair in zip(poses, motions, strict=True))
        return None if same else poses

    def measured(
        self,
        outcomes: Sequence[Outcome],
        motions: Sequence[np.ndarray],
        wrong: Sequence[Settings],
        step: Callable[[], None],
    ) -> list[Outcome]:
        """
        Return outcomes with how far recordings and simulations are apart there.

        Parameters
        ----------
        outcomes : sequence of Outcome
            Of the recordings, at their fitted poses.
        motions : sequence of numpy.ndarray
            (6 + 3 P,) these poses, as for `registration.place`.
        wrong : sequence of dict
            (R,) effects that are as wrong as their fit leaves open.
        step : callable
            Called after each recording.

        """
        poses = self.other_poses(motions)
        if poses is None or not any(wrong):
            return list(outcomes)
        jobs = list(zip(self.used, map(tuple, poses), wrong, self.bare, strict=True))
        apart = self.simulator.run(measure_apart, jobs, step)
        return [replace(one, elsewhere=far) for one, far in zip(outcomes, apart, strict=True)]
