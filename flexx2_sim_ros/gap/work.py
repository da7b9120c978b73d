"""The work on single recordings."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check, Found, nothing_left, of_one_mode, read
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.confirm import confirm, Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence, gather
from flexx2_sim_ros.jobs import bind, Map
from flexx2_sim_ros.recording.folders import find_recordings
import numpy as np

Progress = Callable[[str, float], None]


def stepper(
    progress: Progress, text: str, start: float, weight: float, total: int
) -> Callable[[], None]:
    """
    Return a function that reports progress each time it is called.

    Parameters
    ----------
    progress : callable
        Called with what is being done, and the fraction of the whole work that is done.
    text : str
        What is being done.
    start, weight : float
        The fraction of the whole work that is done before, and the fraction that this is.
    total : int
        How often the function will be called. More calls report no more progress.

    """
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        progress(text, start + weight * min(done / max(total, 1), 1.0))

    return step


def find(
    folder: str | Path, profile: Profile | None, mapped: Map
) -> tuple[list[Found], list[tuple[str, str]]]:
    """
    Find a campaign's recordings; see `of_one_mode`.

    Parameters
    ----------
    folder : str or pathlib.Path
        The campaign.
    profile : Profile, optional
        The camera, the Flexx2 when left out.
    mapped : callable
        As from `workers`: bags have to be read to know what is in them.

    """
    paths = find_recordings(folder)
    return of_one_mode(folder, paths, mapped(bind(check, profile=profile), paths, lambda: None))


def summarise(
    found: Found,
    profile: Profile | None,
    columns: Sequence[Column],
    seed: int,
    prior: tuple[float, ...],
    known: Table | None = None,
) -> Evidence | str:
    """Return a recording's summary, or why there is none."""
    try:
        recording = read(found, profile, known)
    except InputError as error:
        return str(error)
    try:
        return gather(recording, columns, seed, np.array(prior))
    except InputError as error:
        return f'{found.path}: {error}'


def summarise_all(
    folder: str | Path,
    found: Sequence[Found],
    left_out: Sequence[tuple[str, str]],
    profile: Profile | None,
    columns: Sequence[Column],
    seed: int,
    prior: np.ndarray,
    mapped: Map,
    step: Callable[[], None],
    known: Table | None = None,
) -> tuple[list[Found], list[Evidence], list[tuple[str, str]]]:
    """
    Summarise all recordings of a campaign.

    Parameters
    ----------
    folder : str or pathlib.Path
        The campaign, for errors.
    found : sequence of Found
        Its recordings.
    left_out : sequence of tuple of str
        Name of each recording that was left out before, and the reason; for errors.
    profile : Profile or None
        The camera, the Flexx2 when None.
    columns : sequence of Column
        What is simulated of each recording.
    seed : int
        Of the simulations.
    prior : numpy.ndarray
        (6,) standard deviations of a pose error, metres and degrees.
    mapped : callable
        As from `workers`.
    step : callable
        Called after each recording.
    known : mapping, optional
        Effects that the base simulator has: parameters by name.

    Returns
    -------
    tuple of list
        The recordings that can be used, their summaries, and the name of each other one with the
        reason.

    Raises
    ------
    InputError
        When no recording can be used.

    """
    outcomes = mapped(
        bind(
            summarise, profile=profile, columns=columns, seed=seed, prior=tuple(prior), known=known
        ),
        found,
        step,
    )
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


def simulate_set(
    job: tuple[Found, tuple[float, ...], dict[str, Any]],
    profile: Profile | None,
    seed: int,
    known: Table | None = None,
) -> Outcome:
    """Return a recording against the simulation with effects, at the pose that was found."""
    found, motion, effects = job
    return confirm(read(found, profile, known), np.array(motion), effects, seed)
