"""Find, summarise and simulate the recordings of a campaign, one job for each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, repeat
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import flexx2, Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check, Found, nothing_left, of_one_mode, read
from flexx2_sim_ros.gap.data.clues import Clues, clues_of
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.evidence import Evidence, gather
from flexx2_sim_ros.gap.features.search import Found as Inside
from flexx2_sim_ros.gap.features.search import search
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.jobs import bind, Map
from flexx2_sim_ros.recording.opening import find_recordings
import numpy as np

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Simulator:
    """
    How recordings are read and simulated, and by whom.

    * `mapped`: a map as from `jobs.workers`.
    * `profile`: the camera; None: the Flexx2.
    * `known`: effects that the base simulator has: parameters by name.
    * `prior`: six standard deviations of pose errors, metres and degrees.
    * `columns`: the simulations of each recording for its summary.
    * `inside`: what is known of the camera's inside, as from `search_inside`.
    """

    mapped: Map
    profile: Profile | None
    known: Table
    seed: int
    prior: tuple[float, ...]
    columns: Sequence[Column] = ()
    inside: Inside = field(default_factory=dict)

    def run(
        self,
        function: Any,
        items: Sequence[Any],
        step: Callable[[], None] = lambda: None,
        **more: Any,
    ) -> list[Any]:
        """Return a function of `profile`, `known` and `seed`, such as `at_pose`, of each item."""
        fixed = {'profile': self.profile, 'known': self.known, 'seed': self.seed}
        return self.mapped(bind(function, **fixed, **more), items, step)

    def summaries(
        self,
        found: Sequence[Found],
        step: Callable[[], None] = lambda: None,
        motions: Sequence[np.ndarray] | None = None,
    ) -> list[Evidence | str]:
        """
        Return the summary of each recording, or why there is none.

        `motions` are (6 + 3 P,) where the cameras and planes are; registered if left out.
        """
        jobs = list(zip(found, motions or repeat(None), strict=False))
        told = {'columns': self.columns, 'prior': self.prior, 'inside': self.inside}
        return self.run(_summarise, jobs, step, **told)


def stepper(
    progress: Progress, text: str, start: float, weight: float, total: int
) -> Callable[[], None]:
    """
    Return a function that reports progress each time it is called, `total` times.

    The step `text` begins at the fraction `start` of the whole work, and is `weight` of it.
    """
    calls = count(1)
    return lambda: progress(text, start + weight * min(next(calls) / max(total, 1), 1.0))


def portion(progress: Progress, start: float, weight: float) -> Progress:
    """Return the progress of a part of some work; `start` and `weight` as for `stepper`."""
    return lambda text, fraction: progress(text, start + weight * fraction)


def find(
    folder: str | Path, profile: Profile | None, mapped: Map, full_scale: float | None = None
) -> tuple[list[Found], list[tuple[str, str]]]:
    """
    Find a campaign's recordings; see `of_one_mode`. The camera is the Flexx2 without a profile.

    `full_scale` is that of a floating-point amplitude, as an earlier diagnosis took it.
    """
    paths = find_recordings(folder)
    checked = mapped(bind(check, profile=profile), paths, lambda: None)
    return of_one_mode(folder, paths, checked, full_scale)


def noisier(
    found: Sequence[Found], profile: Profile | None, factor: float
) -> tuple[list[Found], Profile]:
    """
    Return recordings and their camera with sigma_z times `factor`; the Flexx2 if no profile.

    Cameras of one kind differ in noise. What is known of that is no gap to be closed.
    """
    as_noisy = [replace(one, mode=one.mode.noisier(factor)) for one in found]
    return as_noisy, (profile or flexx2()).noisier(factor)


def _look(found: Found, profile: Profile | None, known: Table, **_: Any) -> Clues | None:
    # What a recording shows of the inside of its camera.
    try:
        return clues_of(read(found, profile, known))
    except InputError:
        return None  # Its summary says why.


def search_inside(
    found: Sequence[Found], simulator: Simulator, step: Callable[[], None]
) -> Inside:
    """Find what is free inside the camera of a campaign; see `search.search`."""
    some = [one for one in simulator.run(_look, found, step) if one is not None]
    return search(some, found[0].mode) if some else {}


def _summarise(
    job: tuple[Found, np.ndarray | None],
    profile: Profile | None,
    known: Table,
    seed: int,
    columns: Sequence[Column],
    prior: tuple[float, ...],
    inside: Inside,
) -> Evidence | str:
    (found, motion), where = job, ''
    try:
        recording = read(found, profile, known)
        where = f'{found.path}: '
        return gather(recording, columns, seed, np.array(prior), inside, motion)
    except InputError as error:
        return f'{where}{error}'


def summarise_all(
    folder: str | Path,
    found: Sequence[Found],
    left_out: Sequence[tuple[str, str]],
    simulator: Simulator,
    step: Callable[[], None] = lambda: None,
    motions: Sequence[np.ndarray] | None = None,
) -> tuple[list[Found], list[Evidence], list[tuple[str, str]]]:
    """
    Return the recordings that can be used, their summaries, and name and reason of each other one.

    `folder` and `left_out` (name and reason of each recording that was left out before) are for
    errors; `motions` are as for `Simulator.summaries`. Raises `InputError` when no recording can
    be used.
    """
    outcomes = simulator.summaries(found, step, motions)
    used, evidence, unusable = [], [], []
    for file, one in zip(found, outcomes, strict=True):
        if isinstance(one, Evidence):
            used.append(file)
            evidence.append(one)
        else:
            unusable.append((file.path.name, one))
    if not evidence:
        raise nothing_left(Path(folder), [*left_out, *unusable])
    return used, evidence, unusable


def at_pose(
    job: tuple[Found, Sequence[float], dict[str, Any]],
    look: Callable[..., Any],
    profile: Profile | None,
    seed: int,
    known: Table,
) -> Any:
    """
    Return what `look` finds in the scene of a recording, such as `confirm`.

    The job is the recording, where its camera and its planes are, and further arguments by name.
    """
    found, motion, more = job
    scene = PlacedScene.at(read(found, profile, known), np.array(motion))
    return look(scene, seed=seed, **more)


def jobs_at(
    found: Sequence[Found], motions: Sequence[Sequence[float] | np.ndarray], **more: Sequence[Any]
) -> list[tuple[Found, tuple[float, ...], dict[str, Any]]]:
    """Return jobs for `at_pose`; each of `more` has a value for each recording."""
    each = [dict(zip(more, values, strict=True)) for values in zip(*more.values(), strict=True)]
    return list(zip(found, map(tuple, motions), each, strict=True))
