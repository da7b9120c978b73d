"""Give the effects that a diagnosis names the forms that its recordings show."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect, of_role, parse_effects
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.calibratable import (
    calibratable,
    PATTERN,
    quickly_calibratable,
    rounds,
)
from flexx2_sim_ros.gap.forms.calibrating import calibrate_effects, FormedSet, Jobs, Work
from flexx2_sim_ros.gap.forms.work import (
    confirm_settled,
    judge,
    look,
    look_again,
    look_at_pixels,
    look_at_scale,
    Looked,
    Settings,
)
from flexx2_sim_ros.gap.inference.effects import of_camera
from flexx2_sim_ros.jobs import bind, Map
import numpy as np

Step = Callable[[], None]


@dataclass(frozen=True)
class Simulator:
    """
    How recordings are read and simulated, and by whom.

    Attributes
    ----------
    mapped : callable
        A map as from `jobs.workers`.
    profile : Profile or None
        The camera; None: the Flexx2.
    known : mapping
        Effects that the base simulator has: parameters by name.
    seed : int
        Of the simulations.
    prior : tuple of float
        Six standard deviations of pose errors, metres and degrees.

    """

    mapped: Map
    profile: Profile | None
    known: Table
    seed: int
    prior: tuple[float, ...]

    def look(
        self, items: Sequence[tuple[Found, Settings, np.ndarray | None]], step: Step
    ) -> list[Looked | str]:
        """Return `work.look` of several recordings."""
        return self.run(look, items, step, prior=self.prior)

    def work(self, step: Step) -> Work:
        """Return the work on recordings, with a function to call after each one is judged."""

        def judge_all(
            jobs: Jobs, frames: int | None, settle_once: bool
        ) -> list[list[dict[str, float]]]:
            return self.run(judge, jobs, step, frames=frames, settle_once=settle_once)

        def again(some: Sequence[Looked], now: Sequence[Settings]) -> list[Looked]:
            return self.run(look_again, list(zip(some, now, strict=True)), _nothing)

        return Work(
            judge_all,
            lambda jobs: self.run(look_at_pixels, jobs, _nothing),
            lambda jobs: self.run(look_at_scale, jobs, _nothing),
            again,
        )

    def run(self, function: Any, items: Sequence[Any], step: Step, **more: Any) -> list[Any]:
        """Return a function of `work` of several recordings."""
        fixed = {'profile': self.profile, 'known': self.known, 'seed': self.seed}
        return self.mapped(bind(function, **fixed, **more), items, step)


@dataclass(frozen=True)
class Calibrated:
    """
    Named effects with their forms, and what is left of the gap with them.

    Attributes
    ----------
    explained : FormedSet
        The forms that were tried.
    typical : dict
        Settings by effect in the form of the catalogue.

    """

    explained: FormedSet
    typical: Settings

    @property
    def taken(self) -> bool:
        """Return whether a form was taken."""
        return any(one.taken for one in self.explained.verdicts)

    @property
    def dropped(self) -> list[str]:
        """Return the names of effects that do not suit these forms: a pose error beside a lens."""
        return [of_role('pose').name] if self.explained.fits_lens else []

    def effects(self, named: Sequence[Effect]) -> list[Effect]:
        """Return the other named effects with the forms that are taken, in the same order."""
        forms = {one.name: one for one in parse_effects(self.explained.effects)}
        return [forms.get(one.name, one) for one in named if one.name not in self.dropped]

    def confirmed(
        self,
        simulator: Simulator,
        wrong: Sequence[Settings],
        shown: Sequence[bool],
        bare: Sequence[np.ndarray | None],
        step: Step,
    ) -> tuple[list[Outcome], list[np.ndarray]]:
        """
        Simulate each recording with forms that were not fitted to it.

        Parameters
        ----------
        simulator : Simulator
            How the recordings are simulated.
        wrong : sequence of dict
            (R,) the forms, as wrong as their fit leaves open.
        shown : sequence of bool
            Which recordings have a frame to show.
        bare : sequence of numpy.ndarray or None
            Where each one is without effects, as for `confirm.confirm`.
        step : callable
            Called after each recording.

        Returns
        -------
        tuple of list
            What is left of the gap of each recording, and (6 + 3 P,) where its camera and its
            planes are with these effects, as for `registration.place`.

        """
        explained = self.explained
        jobs = list(zip(explained.looked, explained.now, wrong, shown, bare, strict=True))
        both = simulator.run(confirm_settled, jobs, step)
        return [one for one, _ in both], [motion for _, motion in both]


def calibrate_named(
    used: Sequence[Found],
    motions: Sequence[np.ndarray],
    named: Sequence[Effect],
    held_out: Sequence[Sequence[Effect]],
    simulator: Simulator,
    step: Step,
    quick: bool = True,
) -> Calibrated | None:
    """
    Fit the forms of named effects.

    Parameters
    ----------
    used : sequence of Found
        The recordings.
    motions : sequence of numpy.ndarray
        (6 + 3 P,) where each one's camera and planes are as far as is known, as for
        `registration.place`.
    named : sequence of Effect
        As fitted to all recordings.
    held_out : sequence of sequence of Effect
        As fitted without each recording.
    simulator : Simulator
        How the recordings are simulated.
    step : callable
        Called after each recording.
    quick : bool
        Whether only forms that need no search by simulation, or a quick one, are fitted.

    Returns
    -------
    Calibrated or None
        None where no effect has such a form, or where too few recordings can be left out.

    """
    effects = of_camera(named)
    names = (quickly_calibratable if quick else calibratable)(effects)
    if len(used) < FORMS.fewest or not names:
        return None
    without = [of_camera(own) for own in held_out]
    items = list(zip(used, without, motions, strict=True))
    looked = [one for one in simulator.look(items, step) if isinstance(one, Looked)]
    if len(looked) < len(used):  # A file was removed meanwhile.
        return None
    if len({one.shape for one in looked}) > 1:  # A map has one number for each pixel.
        names = [name for name in names if name != PATTERN]
    work = simulator.work(step)
    explained = calibrate_effects(looked, effects, work, without, names, quick)
    return Calibrated(explained, effects)


def rounds_of_named(named: Sequence[Effect], quick: bool) -> int:
    """Return how often `calibrate_named` calls its step for each recording."""
    return 2 + rounds(of_camera(named), quick)


def _nothing() -> None:
    pass
