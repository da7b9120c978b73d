"""The work on single recordings, here, in local processes or on a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed, CancelledError
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from flexx2_sim_ros import processes
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check, Found, of_one_mode, read
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.confirm import confirm, Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence, gather
from flexx2_sim_ros.recording.folders import find_recordings
import numpy as np

_CONNECT_SECONDS = 10.0
_PATIENCE = 30  # seconds
Map = Callable[[Callable[[Any], Any], Sequence[Any], Callable[[], None]], list[Any]]


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


@contextmanager
def workers(jobs: int, scheduler: str | None) -> Iterator[Map]:
    """
    Yield a function that maps a function over items, in order.

    Parameters
    ----------
    jobs : int
        Local processes.
    scheduler : str or None
        Address of a Dask scheduler, whose workers read the recordings by the same paths.

    Raises
    ------
    InputError
        When the scheduler cannot be reached or Dask is not installed.

    """
    if scheduler is not None:
        with _dask(scheduler) as mapped:
            yield mapped
    elif jobs > 1:
        with processes.workers(jobs) as submit:

            def run(
                function: Callable[[Any], Any], items: Sequence[Any], tick: Callable[[], None]
            ) -> list[Any]:
                futures = submit(function, items)
                for _ in as_completed(futures):
                    tick()
                return [future.result() for future in futures]

            yield run
    else:

        def here(
            function: Callable[[Any], Any], items: Sequence[Any], tick: Callable[[], None]
        ) -> list[Any]:
            out = []
            for item in items:
                out.append(function(item))
                tick()
            return out

        yield here


@contextmanager
def _dask(address: str) -> Iterator[Map]:
    try:
        import distributed  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError as error:
        raise InputError(
            '--scheduler: needs Dask, which is not installed: pip install flexx2_sim_ros[cluster]'
        ) from error
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise InputError(
            f'--scheduler: must be the address of a running scheduler, got {address!r}: {error}'
        ) from error
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        client.close()
        raise InputError(
            f'--scheduler: must have at least one worker, got none at {address!r} after '
            f'{_PATIENCE} s'
        ) from error

    def run(
        function: Callable[[Any], Any], items: Sequence[Any], tick: Callable[[], None]
    ) -> list[Any]:
        # Pure: what was lost with a worker is done again, with the same outcome.
        with client.as_current():
            futures = client.map(function, list(items), pure=False, retries=3)
            for _ in distributed.as_completed(futures):
                tick()
            return list(client.gather(futures))

    try:
        yield run
    except distributed.KilledWorker as error:
        raise InputError(
            f'--scheduler: {address}: its workers were lost again and again: {error}'
        ) from error
    except (CancelledError, RuntimeError, OSError) as error:
        # Whatever breaks on the way when the scheduler goes, the client is then not connected.
        if client.status == 'running':
            raise
        raise InputError(
            f'--scheduler: {address}: the connection was lost; nothing was written'
        ) from error
    finally:
        client.close()


def bind(function: Callable[..., Any], **fixed: Any) -> Callable[[Any], Any]:
    """Return a function of one argument that other processes can be sent."""
    return partial(function, **fixed)
