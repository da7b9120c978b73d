"""From recordings and a room to a campaign with ground truth."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import hashlib
from pathlib import Path
import shutil
from typing import Any

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.jobs import Map, workers
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.folders import BAG_FILES, find_recordings, is_bag
from flexx2_sim_ros.truth.joint import Columns, solve, View
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.page import page
from flexx2_sim_ros.truth.registration import Job, register, Registered, views_of
from flexx2_sim_ros.truth.shared import estimate, Shared
from flexx2_sim_ros.truth.verdict import judge, Verdict
from flexx2_sim_ros.truth.writing import Picture, write_recording, Writing
import numpy as np
import yaml

FILES = 'truth.yaml', 'truth.html'
_CACHE = '.truth'
# Cost of the best pose in the mirror image of the room, as a share of that in the room.
_MIRRORED = 0.4
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Request:
    """
    What to make ground truth from.

    Attributes
    ----------
    recordings : tuple of pathlib.Path
        Bags, ``.npz`` files, or folders of them.
    room : pathlib.Path
        A mesh or a MuJoCo model; see `load_room`.
    out : pathlib.Path
        The campaign's folder.
    poses : tuple of tuple of float
        Rough poses: none, one for all recordings, or one for each.
    up : str
        Direction of the room that is up; see `search.UPS`.
    camera : str or None
        Of bags that have several.
    profile : Profile or None
    motion : str
        ``auto``, ``still`` or ``moving``.
    room_error : float
        Standard deviation of the room's surfaces along their normals, metres.
    jobs : int
        Processes.
    scheduler : str or None
        Address of a Dask scheduler.
    command : str
        How it was asked for, to be written down.

    """

    recordings: tuple[Path, ...]
    room: Path
    out: Path
    poses: tuple[tuple[float, ...], ...] = ()
    up: str = '+z'
    camera: str | None = None
    profile: Profile | None = None
    motion: str = 'auto'
    room_error: float = 0.003
    jobs: int = 1
    scheduler: str | None = None
    command: str = ''


def make_truth(request: Request, progress: Progress = lambda text, share: None) -> dict[str, Any]:
    """
    Register recordings to a room and write them with their ground truth.

    Parameters
    ----------
    request : Request
        What to make it from.
    progress : callable
        Called with what is done and the fraction of all that is done.

    Returns
    -------
    dict
        What ``truth.yaml`` says.

    Raises
    ------
    InputError
        When something given cannot be used, or no recording fits the room. Nothing is written
        then.

    """
    jobs = _jobs(request)
    _check(request, jobs)
    progress('loading the room', 0.0)
    room = load_room(request.room)
    new = not request.out.exists()
    try:
        with workers(request.jobs, request.scheduler) as mapped:
            registered = _register(request, jobs, mapped, progress)
            numbered = [(i, *pair) for i, pair in enumerate(zip(jobs, registered, strict=True))]
            steps = _Steps(progress, 'simulating bounces', 0.55, 0.1, len(jobs))
            views = [one for part in mapped(views_of, numbered, steps.tick) for one in part]
            progress('fitting poses and shared errors', 0.65)
            shared, verdicts = _fit(views, registered)
            _check_room(request, registered, verdicts)
            writings = _writings(request, jobs, registered, shared, verdicts)
            steps = _Steps(progress, 'writing', 0.7, 0.25, len(writings))
            pictures = dict(
                zip(
                    writings,
                    mapped(write_recording, list(writings.values()), steps.tick),
                    strict=True,
                )
            )
    except InputError:
        if new:
            shutil.rmtree(request.out, ignore_errors=True)
        raise
    table = _table(request, room.bounds, jobs, registered, shared, verdicts, writings, pictures)
    with atomic.whole_files(atomic.output_folder(request.out)) as part:
        text = yaml.safe_dump(table, sort_keys=False, allow_unicode=True)
        (part / FILES[0]).write_text(text, encoding='utf-8')
        html = page(table, registered, pictures)
        (part / FILES[1]).write_text(html, encoding='utf-8', errors='backslashreplace')
    shutil.rmtree(request.out / _CACHE, ignore_errors=True)
    return table


@dataclass
class _Steps:
    progress: Progress
    text: str
    start: float
    share: float
    count: int
    done: int = 0

    def tick(self) -> None:
        self.done += 1
        self.progress(self.text, self.start + self.share * self.done / max(self.count, 1))


def _jobs(request: Request) -> list[Job]:
    paths: list[Path] = []
    for path in request.recordings:
        folder = path.is_dir() and not is_bag(path)
        paths += find_recordings(path) if folder else [path]
    if len(request.poses) not in (0, 1, len(paths)):
        raise InputError(
            f'--pose: must be given once or once for each of {len(paths)} recordings, got '
            f'{len(request.poses)}'
        )
    guesses: Sequence[tuple[float, ...] | None] = request.poses or [None]
    if len(guesses) == 1:
        guesses = list(guesses) * len(paths)
    return [
        Job(path, request.room, request.camera, request.profile, request.motion, guess, request.up)
        for path, guess in zip(paths, guesses, strict=True)
    ]


def _check(request: Request, jobs: Sequence[Job]) -> None:
    # Before anything is computed.
    try:
        atomic.check_folder(request.out)
    except InputError as error:
        raise InputError(f'--out: {error}') from error
    names = _names(jobs)
    for job, name in zip(jobs, names, strict=True):
        open_recording(job.path, job.camera)
        atomic.check_distinct(job.path, request.out / name)


def _names(jobs: Sequence[Job]) -> list[str]:
    names: list[str] = []
    for job in jobs:
        stem, number = job.path.name, 1
        if job.path.suffix in ('.npz', *BAG_FILES):
            stem = job.path.stem
        name = f'{stem}.npz'
        while name in names:
            number += 1
            name = f'{stem}-{number}.npz'
        names.append(name)
    return names


def _register(
    request: Request, jobs: Sequence[Job], mapped: Map, progress: Progress
) -> list[Registered]:
    # What an earlier run has found is taken from its files.
    folder = request.out / _CACHE
    files = [folder / f'{_digest(job)}.json' for job in jobs]
    missing = [(job, file) for job, file in zip(jobs, files, strict=True) if not file.is_file()]
    steps = _Steps(progress, 'registering', 0.05, 0.5, len(missing))
    if missing:
        atomic.output_folder(folder)
        mapped(_register_one, missing, steps.tick)
    return [Registered.from_json(file.read_text(encoding='utf-8')) for file in files]


def _register_one(item: tuple[Job, Path]) -> None:
    job, file = item
    atomic.write_text(file, register(job).to_json())


def _digest(job: Job) -> str:
    words: list[Any] = [__version__, job.camera, job.motion, job.guess, job.up, job.profile]
    for path in (job.path, job.room):
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        words += [(str(f.resolve()), f.stat().st_size, f.stat().st_mtime_ns) for f in files]
    return hashlib.sha256(repr(words).encode('utf-8', 'surrogatepass')).hexdigest()[:32]


def _fit(views: Sequence[View], registered: Sequence[Registered]) -> tuple[Shared, list[Verdict]]:
    # Recordings that do not fit would spoil what all share: judged first, then left out.
    alone = solve(views, Columns(False, (), False))
    verdicts = judge(registered, alone)
    good = [view for view in alone.views if verdicts[view.recording].state != 'refused']
    if not good:
        return Shared(alone, {}), verdicts
    shared = estimate(good)
    final = judge(registered, shared.solution)
    return shared, [
        before if before.state == 'refused' else after
        for before, after in zip(verdicts, final, strict=True)
    ]


def _check_room(
    request: Request, registered: Sequence[Registered], verdicts: Sequence[Verdict]
) -> None:
    refused = [verdict for verdict in verdicts if verdict.state == 'refused']
    better = [one.mirrored < _MIRRORED * min(one.costs) for one in registered]
    used = sum(
        verdict.state == 'used' and not other
        for verdict, other in zip(verdicts, better, strict=True)
    )
    if sum(better) > used:
        raise InputError(
            f'{request.room}: must not be mirrored: the recordings fit its mirror image; negate '
            'one coordinate of the mesh'
        )
    # A chance fit of one or two recordings does not make it the right room.
    if 2 * len(refused) > len(verdicts):
        usual = float(np.median([verdict.fitting for verdict in verdicts]))
        hint = '' if request.poses else ', or the wrong --up'
        raise InputError(
            f'{request.room}: must be the room of the recordings: only {usual:.0%} of the '
            f'pixels of most recordings fit it; it is another room{hint}, or the pose is far off'
        )


def _writings(
    request: Request,
    jobs: Sequence[Job],
    registered: Sequence[Registered],
    shared: Shared,
    verdicts: Sequence[Verdict],
) -> dict[int, Writing]:
    solution = shared.solution
    out = {}
    for i, name in enumerate(_names(jobs)):
        mine = [k for k, view in enumerate(solution.views) if view.recording == i]
        if verdicts[i].state != 'refused' and mine:
            out[i] = Writing(
                jobs[i],
                registered[i],
                tuple(solution.views[mine[0]].pose.numbers()),
                solution.columns,
                tuple(map(float, solution.values)),
                np.mean([solution.full_covariance(k) for k in mine], axis=0),
                request.room_error,
                request.out / name,
            )
    return out


def _table(
    request: Request,
    bounds: np.ndarray,
    jobs: Sequence[Job],
    registered: Sequence[Registered],
    shared: Shared,
    verdicts: Sequence[Verdict],
    writings: dict[int, Writing],
    pictures: dict[int, Picture],
) -> dict[str, Any]:
    rows = []
    for i, (job, where, verdict) in enumerate(zip(jobs, registered, verdicts, strict=True)):
        row: dict[str, Any] = {
            'name': _names(jobs)[i],
            'source': str(job.path),
            'verdict': verdict.state,
            'reasons': list(verdict.reasons),
            'motion': 'moving' if where.moving else 'still',
            'frames': len(where.poses) if where.moving else 1,
            'fitting': round(verdict.fitting, 4),
            'seconds': round(where.seconds, 2),
        }
        if i in writings:
            numbers = writings[i].pose
            row |= {
                'pose': [round(value, 6) for value in numbers],
                'pose_sigma_mm': round(verdict.deviation[0] * 1e3, 3),
                'pose_sigma_deg': round(verdict.deviation[1], 4),
                'residual_mm': round(verdict.residual * 1e3, 3),
                'known': round(pictures[i].known, 4),
            }
        rows.append(row)
    return {
        'schema': 1,
        'kind': 'scan',
        'version': __version__,
        'command': request.command,
        'room': str(request.room),
        'room_size_m': [round(float(value), 3) for value in bounds[1] - bounds[0]],
        'room_error_mm': request.room_error * 1e3,
        'recordings': rows,
        'shared': shared.findings,
        'cannot_decide': _cannot_decide(shared),
    }


def _cannot_decide(shared: Shared) -> list[dict[str, str]]:
    out = [
        {
            'effect': 'pose_error',
            'reason': 'the poses are fitted to these recordings; motion capture would decide it',
        },
        {
            'effect': 'time_offset',
            'reason': 'each frame is placed where it was taken, whatever its stamp says; motion '
            'capture would decide it',
        },
    ]
    for effect, finding in shared.findings.items():
        if finding['verdict'] == 'confounded':
            remedy = (
                'more recordings of tilted walls at several distances would decide it'
                if effect == 'offset'
                else 'a recording of a bright corner would decide it'
            )
            out.append({'effect': effect, 'reason': f'{finding["reason"]}; {remedy}'})
    return out
