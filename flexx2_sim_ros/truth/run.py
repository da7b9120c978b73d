"""The flow of `flexx2 gap truth`: observe, place, solve, write; distributed and resumed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
import shutil
from typing import Any, Protocol, TypeVar

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError, MachineError
from flexx2_sim_ros.jobs import Map, workers
from flexx2_sim_ros.recording.folders import find_recordings
from flexx2_sim_ros.truth.files import (
    CACHE,
    has_truth,
    names_of,
    opened,
    recordings_of,
    remembered,
    write_results,
)
from flexx2_sim_ros.truth.reflectivity import find_scale
from flexx2_sim_ros.truth.uptime import uptimes
from flexx2_sim_ros.truth.writing import PageImages, read_light, Surfaces, write_recording, Writing
import numpy as np

# Called with the name of the current step and the fraction of the work that is done.
Progress = Callable[[str, float], None]
_LONGEST_COMMAND = 2000  # characters that are stored
_Item = TypeVar('_Item')


def no_progress(text: str, fraction: float) -> None:
    """Ignore progress."""


@dataclass(frozen=True, kw_only=True)
class TruthRequest:
    """
    The options that all kinds of ground truth share.

    Attributes
    ----------
    recordings : tuple of pathlib.Path
        Bags, ``.npz`` files, or folders of them.
    out : pathlib.Path
        The campaign's folder.
    camera : str or None
        Which camera of bags that have several.
    profile : Profile or None
        The camera (None: the Flexx2).
    motion : str
        ``auto``, ``still`` or ``moving``.
    jobs : int
        Number of processes.
    scheduler : str or None
        Address of a Dask scheduler.
    uptime : float or None
        Seconds from power-on to the first frame of the earliest recording (None: unknown).
    command : str
        The command line, stored in ``truth.yaml``.

    """

    recordings: tuple[Path, ...]
    out: Path
    camera: str | None = None
    profile: Profile | None = None
    motion: str = 'auto'
    jobs: int = 1
    scheduler: str | None = None
    uptime: float | None = None
    command: str = ''

    def work(self) -> 'Work':
        """Return what is to be done for it."""
        raise NotImplementedError

    def writing(self, source: 'TruthSource', surfaces: Surfaces) -> Writing:
        """Return what to write of one of its recordings."""
        return Writing(
            source.path, self.camera, self.profile, surfaces, source.target, source.keys
        )


@dataclass(frozen=True)
class TruthSource:
    """
    One of the recordings.

    Attributes
    ----------
    path : pathlib.Path
        The recording.
    target : pathlib.Path
        The file to write, with ground truth.
    uptime : numpy.ndarray or None
        As in `uptime.uptimes`.
    notes : tuple of str
        What a person should know of the file, as in `Recording`.

    """

    path: Path
    target: Path
    uptime: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def keys(self) -> dict[str, np.ndarray]:
        """Return keys to write beside the ground truth."""
        return {} if self.uptime is None else {'uptime': self.uptime}

    def row(self, verdict: str, reasons: Sequence[str], **more: Any) -> dict[str, Any]:
        """Return the row of the recording in ``truth.yaml``."""
        return {
            'name': self.target.name,
            'source': str(self.path),
            'verdict': verdict,
            'reasons': list(reasons),
            **({'notes': list(self.notes)} if self.notes else {}),
            **more,
        }


def sources_of(request: TruthRequest, *others: Path) -> list[TruthSource]:
    """
    Return the recordings of a request.

    Parameters
    ----------
    request : TruthRequest
        The request.
    *others : pathlib.Path
        Further files that the run reads.

    Raises
    ------
    InputError
        When a folder has none, one that was named cannot be read, its file cannot be written, or a
        file that is read would be overwritten.

    """
    paths = recordings_of(request.recordings)
    given = [*request.recordings, *others]
    readers = opened(request.out, paths, request.camera, request.profile, given)
    known = iter(uptimes([one for one in readers if one is not None], request.uptime))
    return [
        TruthSource(path, request.out / name)
        if reader is None
        else TruthSource(path, request.out / name, next(known), tuple(dict.fromkeys(reader.notes)))
        for path, name, reader in zip(paths, names_of(paths), readers, strict=True)
    ]


@dataclass(frozen=True)
class Run:
    """
    A run in progress.

    Attributes
    ----------
    request : TruthRequest
    progress : callable
    mapped : callable
        As `jobs.workers` yields it.

    """

    request: TruthRequest
    progress: Progress
    mapped: Map

    def each(
        self,
        text: str,
        span: tuple[float, float],
        work: Callable[[_Item], Any],
        items: Sequence[_Item],
    ) -> list[Any]:
        """
        Return the results of a function for items, in order.

        Parameters
        ----------
        text : str
            Name of the step.
        span : tuple of float
            Fractions of the whole run: at the start and at the end of this stage.
        work : callable
            A function of a module, for other processes.
        items : sequence of object
            What `work` takes.

        """
        return self.mapped(work, items, self._ticks(text, span, len(items)))

    def each_once(
        self,
        text: str,
        span: tuple[float, float],
        work: Callable[[_Item], Any],
        items: Sequence[_Item],
        digests: Sequence[str],
        kinds: Sequence[type] = (),
    ) -> list[Any]:
        """
        Return the results of a function for items, those of an interrupted run from files.

        Parameters
        ----------
        text, span, work, items
            As for `each`.
        digests : sequence of str
            The `files.digest` of each item.
        kinds : sequence of type
            As for `files.remembered`.

        """
        ticks = self._ticks(text, span, len(items))
        cache = self.request.out / CACHE
        return remembered(cache, digests, items, work, self.mapped, ticks, kinds)

    def _ticks(self, text: str, span: tuple[float, float], count: int) -> Callable[[], None]:
        done = 0

        def tick() -> None:
            nonlocal done
            done += 1
            self.progress(text, span[0] + (span[1] - span[0]) * done / max(count, 1))

        return tick


Written = Mapping[int, tuple[PageImages, Any]]  # by number: as `Surfaces.shown` returns it


class Work(Protocol):
    """
    What differs between a scan, a board and planes.

    Attributes
    ----------
    kind : str
        ``scan``, ``board`` or ``planes``.
    lit : bool
        Whether reflectivity is to be taken from gray images.
    files : sequence of pathlib.Path
        What is read besides recordings.

    """

    kind: str
    lit: bool
    files: Sequence[Path]

    def place(self, run: Run, sources: Sequence[TruthSource]) -> None:
        """Find where the surfaces are; raise `InputError` where no recording shows them."""

    def writings(self) -> dict[int, Writing]:
        """Return what to write, by the number of the recording."""

    def rows(self, written: Written) -> list[dict[str, Any]]:
        """Return the rows of all recordings for ``truth.yaml``."""

    def about(self) -> dict[str, Any]:
        """Return the source of the ground truth."""

    def findings(self) -> dict[str, Any]:
        """Return results for all recordings together."""

    def page(self, table: dict[str, Any], written: Written) -> str:
        """Return the page."""


def make_truth(request: TruthRequest, progress: Progress = no_progress) -> dict[str, Any]:
    """
    Write recordings with ground truth.

    Parameters
    ----------
    request : TruthRequest
        A `RoomRequest`, `BoardRequest` or `PlaneRequest`.
    progress : callable
        Called with the name of the current step and the fraction of the work that is done.

    Returns
    -------
    dict
        The content of ``truth.yaml``.

    Raises
    ------
    InputError
        When an input cannot be used, or no recording shows the surfaces. Nothing is written then.

    """
    work = request.work()
    sources = sources_of(request, *work.files)
    with running(request, progress) as run:
        work.place(run, sources)
        writings = work.writings()
        every, scale = list(writings.values()), None
        if work.lit:
            lit = run.each('reading gray images', (0.7, 0.75), read_light, every)
            scale = find_scale([one for part in lit for one in part])
        whole = [replace(one, scale=scale) for one in every]
        results = run.each('writing', (0.75, 0.95), write_recording, whole)
        written = dict(zip(writings, results, strict=True))
        rows = work.rows(written)
        reflectivity = {} if scale is None else {'reflectivity': scale.table()}
        findings = {**reflectivity, **work.findings()}
        table = _table(request, work, rows, findings)
        write_results(request.out, table, work.page(table, written))
    return table


def _shortened(command: str) -> str:
    # A shell writes out thousands of recordings that a pattern names.
    if len(command) <= _LONGEST_COMMAND:
        return command
    half = _LONGEST_COMMAND // 2
    return f'{command[:half]} ... {command[-half:]}'


@contextmanager
def running(request: TruthRequest, progress: Progress) -> Iterator[Run]:
    """
    Yield a run; if the request is wrong, a folder that the run has created is removed.

    Intermediate results stay in the folder if the run is interrupted, and are removed when it
    ends.

    """
    new = not request.out.exists()
    try:
        with workers(request.jobs, request.scheduler) as mapped:
            yield Run(request, progress, mapped)
    except MachineError:
        raise
    except InputError:
        if new:
            shutil.rmtree(request.out, ignore_errors=True)
        raise
    shutil.rmtree(request.out / CACHE, ignore_errors=True)


def _table(
    request: TruthRequest, work: Work, rows: list[dict[str, Any]], findings: dict[str, Any]
) -> dict[str, Any]:
    # A diagnosis reads all recordings of the folder. So ground truth that an earlier run has
    # written of a recording that is refused now is removed, and others are listed.
    written = [row['name'] for row in rows if row['verdict'] != 'refused']
    for row in rows:
        if row['verdict'] == 'refused' and has_truth(request.out / row['name']):
            (request.out / row['name']).unlink()
    if not written:
        raise InputError(f'{rows[0]["source"]}: cannot be used: {"; ".join(rows[0]["reasons"])}')
    others = [path.name for path in find_recordings(request.out) if path.name not in written]
    return {
        'schema': 1,
        'kind': work.kind,
        'version': __version__,
        'command': _shortened(request.command),
        **work.about(),
        'recordings': rows,
        **findings,
        **({'not_of_this_run': others} if others else {}),
    }
