"""The work on single recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check, Found, of_one_mode, read
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.confirm import confirm, Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence, gather
from flexx2_sim_ros.jobs import bind, Map
from flexx2_sim_ros.recording.folders import find_recordings
import numpy as np


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
) -> Evidence | str:
    """Return a recording's summary, or why there is none."""
    try:
        recording = read(found, profile)
    except InputError as error:
        return str(error)
    try:
        return gather(recording, columns, seed, np.array(prior))
    except InputError as error:
        return f'{found.path}: {error}'


def simulate_set(
    job: tuple[Found, tuple[float, ...]],
    profile: Profile | None,
    effects: dict[str, Any],
    seed: int,
) -> Outcome:
    """Return a recording against the simulation with a set of effects."""
    found, motion = job
    return confirm(read(found, profile), np.array(motion), effects, seed)
