"""A run of `flexx2 gap truth`: what is asked for, and work that goes on after an interruption."""

from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
import hashlib
from itertools import count
import json
import math
from pathlib import Path
import shutil
from typing import Any, TypeVar
from zlib import compress, decompress

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError, MachineError
from flexx2_sim_ros.jobs import Map, workers
from flexx2_sim_ros.recording import open_recording, RecordingReader
from flexx2_sim_ros.truth.observation import Footage, observe
from flexx2_sim_ros.truth.trajectory import PoseSource
import numpy as np

# Called with the name of the current step and the fraction of the work that is done.
Progress = Callable[[str, float], None]
CACHE = '.truth'  # folder for the results of an interrupted run
_Job = TypeVar('_Job')


@dataclass(frozen=True, kw_only=True)
class TruthRequest:
    """
    The options that all kinds of ground truth share.

    `repr` leaves out what may differ when an interrupted run goes on.
    """

    recordings: tuple[Path, ...] = field(repr=False)  # bags, .npz files, or folders of them
    out: Path = field(repr=False)  # the campaign's folder
    camera: str | None = None  # of bags that have several
    profile: Profile | None = None  # None: the Flexx2
    motion: str = 'auto'  # or still, moving: of the camera
    jobs: int = field(default=1, repr=False)  # processes
    scheduler: str | None = field(default=None, repr=False)  # address of a Dask scheduler
    # Seconds from power-on to the first frame of all; None: unknown.
    uptime: float | None = field(default=None, repr=False)
    command: str = field(default='', repr=False)  # the command line, for truth.yaml

    def files_of(self, path: Path) -> list[Path]:
        """Return the files that are read for a recording."""
        return [path]


@dataclass(frozen=True, kw_only=True)
class RoomRequest(TruthRequest):
    """A request for ground truth from a room: a mesh or a MuJoCo model, see `load_room`."""

    room: Path
    # Rough: none, one for all recordings, or one each.
    poses: tuple[tuple[float, ...], ...] = field(default=(), repr=False)
    up: str = '+z'  # one of `search.UPS`
    # Standard deviation of the surfaces along their normals, metres; None: estimated.
    room_error: float | None = None
    scale_error: float | None = None  # of the room, a fraction; None: unknown
    told: PoseSource | None = None  # of rough poses: motion capture, odometry or TF

    def files_of(self, path: Path) -> list[Path]:
        """Return the recording, and the file with its rough poses, if it has one."""
        return [path, *([] if self.told is None else self.told.files_of(path))]


@dataclass(frozen=True, kw_only=True)
class BoardRequest(TruthRequest):
    """A request for ground truth from a printed board in gray images, see `read_board`."""

    board: str | Path  # the board, or its file
    lens_error: float = 0.003  # standard deviation of the focal length, as a fraction
    wall: bool = False  # the board is glued to a wall, whose rest is known as well


@dataclass(frozen=True, kw_only=True)
class PlaneRequest(TruthRequest):
    """A request for ground truth from planes, see `read_planes`; the camera stands still."""

    planes: Path
    room_error: float = 0.0  # standard deviation of surfaces whose file does not say it, metres


@dataclass(frozen=True)
class GivenRecording:
    """A recording that ground truth is made for."""

    path: Path
    request: Any  # a `TruthRequest`
    # Where its surfaces are does not depend on these, so that `repr` is without them.
    target: Path = field(default=Path(), repr=False)  # file to write
    uptime: np.ndarray | None = field(default=None, repr=False)  # as in `files.uptimes`
    notes: tuple[str, ...] = field(default=(), repr=False)  # what a person should know of the file

    @property
    def since_start(self) -> float:
        """Return the mean time since its camera was switched on, seconds; inf if unknown."""
        return math.inf if self.uptime is None else float(self.uptime.mean())

    def opened(self) -> RecordingReader:
        """Open it."""
        return open_recording(self.path, self.request.camera, self.request.profile)

    def footage(self, moving: bool | None = None) -> Footage:
        """Open it to place its frames; None: detect whether it moves."""
        motion = self.request.motion if moving is None else ('moving' if moving else 'still')
        return observe(self.opened(), self.request.profile, motion)

    def row(self, verdict: str, reasons: Sequence[str], **more: Any) -> dict[str, Any]:
        """Return its row in ``truth.yaml``."""
        return {
            'name': self.target.name,
            'source': str(self.path),
            'verdict': verdict,
            'reasons': list(reasons),
            **({'notes': list(self.notes)} if self.notes else {}),
            **more,
        }


def no_progress(text: str, fraction: float) -> None:
    """Ignore progress."""


@contextmanager
def running(request: TruthRequest, progress: Progress) -> Iterator['Run']:
    """
    Yield a run; if the request is wrong, a folder that the run has created is removed.

    Intermediate results stay in the folder if the run is interrupted, and are removed when it
    ends.
    """
    new = not request.out.exists()
    try:
        with workers(request.jobs, request.scheduler) as mapped:
            yield Run(request.out / CACHE, progress, mapped)
    except MachineError:
        raise
    except InputError:
        if new:
            shutil.rmtree(request.out, ignore_errors=True)
        raise
    shutil.rmtree(request.out / CACHE, ignore_errors=True)


@dataclass(frozen=True)
class Run:
    """A run in progress."""

    cache: Path  # folder for results that an interrupted run leaves to the next one
    progress: Progress
    mapped: Map

    def each(
        self,
        text: str,
        span: tuple[float, float],
        work: Callable[[_Job], Any],
        jobs: Sequence[_Job],
    ) -> list[Any]:
        """
        Return the results of a function for jobs, in order.

        `text` is the name of the step, `span` the fractions of the whole run at its start and its
        end. `work` is a function of a module, for other processes.
        """
        done = count(1)

        def tick() -> None:
            part = next(done) / max(len(jobs), 1)
            self.progress(text, span[0] + (span[1] - span[0]) * part)

        return self.mapped(work, jobs, tick)

    def each_once(
        self,
        text: str,
        span: tuple[float, float],
        work: Callable[..., Any],
        jobs: Sequence[tuple[Any, ...]],
        kinds: Sequence[type] = (),
    ) -> list[Any]:
        """
        Return the results of a function for jobs, those of an interrupted run from files.

        A job has the arguments of the function, first a `GivenRecording`; `repr` of it says all
        that the result depends on, but for the files that are read. `kinds` are the dataclasses in
        results, beside arrays, tuples, numbers and texts. An `InputError` gives its text, without
        the name of the recording: the others can be used.
        """
        files = [self.cache / f'{_digest(work.__name__, job)}.json' for job in jobs]
        missing = [
            (work, job, file) for job, file in zip(jobs, files, strict=True) if not file.is_file()
        ]
        if missing:
            atomic.output_folder(self.cache)
            self.each(text, span, _write_result, missing)
        named = {kind.__name__: kind for kind in kinds}
        return [_whole(json.loads(file.read_text(encoding='utf-8')), named) for file in files]


def _digest(work: str, job: tuple[Any, ...]) -> str:
    # Of files in their present state, and of what is done with them.
    parts: list[Any] = [__version__, work, job]
    for path in job[0].request.files_of(job[0].path):
        try:
            files = sorted(path.iterdir()) if path.is_dir() else [path]
            parts += [(str(f.resolve()), f.stat().st_size, f.stat().st_mtime_ns) for f in files]
        except OSError:  # It cannot be read, as its job says.
            parts.append(str(path))
    return hashlib.sha256(repr(parts).encode('utf-8', 'surrogatepass')).hexdigest()[:32]


def _write_result(item: tuple[Callable[..., Any], tuple[Any, ...], Path]) -> None:
    work, job, file = item
    try:
        result = work(*job)
    except InputError as error:
        result = str(error).removeprefix(f'{job[0].path}: ')
    atomic.write_text(file, json.dumps(result, default=_parts))


def _parts(value: Any) -> dict[str, Any]:
    # An array or a dataclass, as JSON has none.
    if isinstance(value, np.ndarray):
        text = b64encode(compress(np.ascontiguousarray(value).tobytes())).decode()
        return {'array': text, 'dtype': value.dtype.str, 'shape': value.shape}
    own = {one.name: getattr(value, one.name) for one in fields(value)}
    return {'kind': type(value).__name__, 'own': own}


def _whole(value: Any, kinds: Mapping[str, type]) -> Any:
    # What `_parts` took apart; lists were tuples.
    if isinstance(value, list):
        return tuple(_whole(one, kinds) for one in value)
    if not isinstance(value, dict):
        return value
    if 'array' in value:
        flat = np.frombuffer(decompress(b64decode(value['array'])), value['dtype'])
        return flat.reshape(value['shape'])
    return kinds[value['kind']](**{key: _whole(one, kinds) for key, one in value['own'].items()})
