"""The gap without and with effects, as it is in other scenes of the same camera."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.named import Simulator
from flexx2_sim_ros.gap.forms.work import Settings
from flexx2_sim_ros.gap.inference.jackknife import as_wrong_as_fitted
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
    posed : bool
        Whether a pose error is among the effects.
    simulator : Simulator
        How they are simulated.

    """

    model: Model
    used: Sequence[Found]
    posed: bool
    simulator: Simulator

    def measured(
        self,
        outcomes: Sequence[Outcome],
        motions: Sequence[np.ndarray],
        effects: Iterable[Settings],
        together: Settings,
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
        effects : iterable of dict
            With which each recording is simulated, fitted without it.
        together : dict
            The same, fitted to all recordings.
        step : callable
            Called after each recording.

        """
        settings = list(effects)
        poses = self.model.own.elsewhere(motions, self.posed)
        moved = any(not np.array_equal(*pair) for pair in zip(poses, motions, strict=True))
        wrong = as_wrong_as_fitted(together, settings)
        if not any(settings) or (not moved and wrong == settings):
            return list(outcomes)
        jobs = [
            (file, tuple(pose), own)
            for file, pose, own in zip(self.used, poses, wrong, strict=True)
        ]
        apart = self.simulator.run(measure_apart, jobs, step)
        return [replace(one, elsewhere=far) for one, far in zip(outcomes, apart, strict=True)]
