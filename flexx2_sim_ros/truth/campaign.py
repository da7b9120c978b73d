"""From recordings and a room to a campaign with ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.jobs import Map, workers
from flexx2_sim_ros.truth.files import (
    CACHE,
    check_files,
    digest,
    names_of,
    Progress,
    recordings_of,
    remembered,
    Steps,
    write_results,
)
from flexx2_sim_ros.truth.joint import Columns, solve, View
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.page import page
from flexx2_sim_ros.truth.registration import Job, register, Registered, views_of
from flexx2_sim_ros.truth.shared import estimate, Shared
from flexx2_sim_ros.truth.verdict import judge, NEVER_DECIDED, Verdict
from flexx2_sim_ros.truth.writing import Picture, write_recording, Writing
import numpy as np

# Cost of the best pose in the mirror image of the room, as a share of that in the room.
_MIRRORED = 0.4


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
    check_files(request.out, [job.path for job in jobs], request.camera)
    progress('loading the room', 0.0)
    room = load_room(request.room)
    new = not request.out.exists()
    try:
        with workers(request.jobs, request.scheduler) as mapped:
            registered = _register(request, jobs, mapped, progress)
            numbered = [(i, *pair) for i, pair in enumerate(zip(jobs, registered, strict=True))]
            steps = Steps(progress, 'simulating bounces', 0.55, 0.1, len(jobs))
            views = [one for part in mapped(views_of, numbered, steps.tick) for one in part]
            progress('fitting poses and shared errors', 0.65)
            shared, verdicts = _fit(views, registered)
            _check_room(request, registered, verdicts)
            writings = _writings(request, jobs, registered, shared, verdicts)
            steps = Steps(progress, 'writing', 0.7, 0.25, len(writings))
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
    write_results(request.out, table, page(table, registered, pictures))
    shutil.rmtree(request.out / CACHE, ignore_errors=True)
    return table


def _jobs(request: Request) -> list[Job]:
    paths = recordings_of(request.recordings)
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


def _register(
    request: Request, jobs: Sequence[Job], mapped: Map, progress: Progress
) -> list[Registered]:
    names = [
        digest((job.path, job.room), (job.camera, job.motion, job.guess, job.up, job.profile))
        for job in jobs
    ]
    steps = Steps(progress, 'registering', 0.05, 0.5, len(jobs))
    texts = remembered(request.out / CACHE, names, jobs, _register_one, mapped, steps.tick)
    return [Registered.from_json(text) for text in texts]


def _register_one(job: Job) -> str:
    return register(job).to_json()


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
    for i, name in enumerate(names_of([job.path for job in jobs])):
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
    names = names_of([job.path for job in jobs])
    for i, (job, where, verdict) in enumerate(zip(jobs, registered, verdicts, strict=True)):
        row: dict[str, Any] = {
            'name': names[i],
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
    out = list(NEVER_DECIDED)
    for effect, finding in shared.findings.items():
        if finding['verdict'] == 'confounded':
            remedy = (
                'more recordings of tilted walls at several distances would decide it'
                if effect == 'offset'
                else 'a recording of a bright corner would decide it'
            )
            out.append({'effect': effect, 'reason': f'{finding["reason"]}; {remedy}'})
    return out
