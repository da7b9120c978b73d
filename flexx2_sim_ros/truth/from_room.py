"""Ground truth from a room: register recordings, and fit poses with the errors they share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_scan
from flexx2_sim_ros.truth.alignment import NO_ERRORS, PosedImage
from flexx2_sim_ros.truth.clock import ClockOffset, common_offset
from flexx2_sim_ros.truth.files import TruthSource
from flexx2_sim_ros.truth.joint import solve
from flexx2_sim_ros.truth.mount import common_motion
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.registration import Job, register, Registered, views_of
from flexx2_sim_ros.truth.requests import RoomRequest
from flexx2_sim_ros.truth.room_writing import RoomSurfaces
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.run import Run
from flexx2_sim_ros.truth.shared import estimate, Shared
from flexx2_sim_ros.truth.trajectory import read_trajectory
from flexx2_sim_ros.truth.verdict import as_given, check_room, judge, room_error, RoomFit
from flexx2_sim_ros.truth.writing import Surfaces, Written
import numpy as np

_CLEAR_LATENCY = 3.0  # standard deviations
# Shared errors that the poses take where they are confounded; the poses' covariance omits this.
_HIDDEN_UNLESS_FITTED = 'intrinsics_error', 'warm_up_drift'


@dataclass(frozen=True)
class _Placed:
    # A recording that was registered, and its number among all that were given.
    number: int
    source: TruthSource
    job: Job
    where: Registered


class RoomCampaign:
    """Recordings of a room, for `make_truth`."""

    kind, lit = 'scan', True

    def __init__(self, request: RoomRequest) -> None:
        """Store what is asked for."""
        self.request = request
        told = None if request.told is None else request.told.file
        self.files: Sequence[Path] = [request.room, *([] if told is None else [told])]

    def place(self, run: Run, sources: Sequence[TruthSource]) -> Mapping[int, Surfaces]:
        """Register each recording, then fit all poses together."""
        request, self.sources = self.request, sources
        jobs = _jobs(request, sources)
        run.progress('loading the room', 0.0)
        self.size = np.ptp(load_room(request.room).bounds, axis=0)
        self.placed = self._registered(run, jobs)
        numbered = [(i, one.job, one.where) for i, one in enumerate(self.placed)]
        parts = run.each('simulating bounces', (0.55, 0.65), views_of, numbered)
        run.progress('fitting poses and shared errors', 0.65)
        self.shared, self.verdicts = _fit(parts, self.placed)
        registered = [one.where for one in self.placed]
        check_room(request.room, bool(request.poses), registered, self.verdicts)
        offsets = [one.clock for one in registered if one.clock is not None]
        self.clock = common_offset(offsets) if offsets else None
        self.late = _latency(request, self.clock)
        self.error, self.error_is = room_error(self.shared.solution)
        if request.room_error is not None:
            self.error, self.error_is = request.room_error, 'given'
        self.surfaces = {
            one.number: surfaces
            for i, one in enumerate(self.placed)
            if (surfaces := self._surfaces(i, one)) is not None
        }
        return self.surfaces

    def _registered(self, run: Run, jobs: Sequence[Job]) -> list[_Placed]:
        # The recordings that can be registered; the others get their rows.
        kinds = Registered, ClockOffset
        found = run.each_once('registering', (0.05, 0.55), _register_one, jobs, kinds)
        placed, self.refused = [], {}
        for i, (source, job, one) in enumerate(zip(self.sources, jobs, found, strict=True)):
            if isinstance(one, str):
                row = source.row('refused', [one], motion='unknown', frames=0, fitting=0.0)
                self.refused[i] = row
            else:
                placed.append(_Placed(i, source, job, one))
        if not placed:
            raise InputError(self.refused[0]['reasons'][0])
        return placed

    def _surfaces(self, number: int, one: _Placed) -> RoomSurfaces | None:
        # The room from the poses of a recording; None if it is refused.
        solution, verdict = self.shared.solution, self.verdicts[number]
        mine = [k for k, view in enumerate(solution.views) if view.recording == number]
        given = one.where.given
        if given is not None:
            pose = next(pose for pose in one.where.poses if np.isfinite(pose).all())
            covariance = given
        elif verdict.state != 'refused' and mine:
            pose = tuple(solution.views[mine[0]].pose.numbers())
            covariance = np.mean([solution.full_covariance(k) for k in mine], axis=0)
        else:
            return None
        return RoomSurfaces(
            one.job,
            one.where,
            pose,
            solution.columns,
            tuple(map(float, solution.values)),
            covariance,
            self.error,
            self.late or 0.0 if given is None else 0.0,
        )

    def rows(self, written: Mapping[int, Written]) -> list[dict[str, Any]]:
        """Return where the camera was in each recording, and how well it fits the room."""
        seen = [one.found for one in written.values() if np.isfinite(one.found)]
        self.rough = float(np.median(seen)) if seen else None
        rows = self.refused | {
            one.number: _row(one, verdict, self.surfaces.get(one.number), written.get(one.number))
            for one, verdict in zip(self.placed, self.verdicts, strict=True)
        }
        return [rows[number] for number in range(len(self.sources))]

    def about(self) -> dict[str, Any]:
        """Return what was known of the room."""
        return {
            'room': str(self.request.room),
            'room_size_m': [round(float(size), 3) for size in self.size],
            'room_error_mm': self.error * 1e3,
            'room_error': self.error_is,
        }

    def findings(self) -> dict[str, Any]:
        """Return clock, roughness, shared errors, and what the room cannot decide."""
        registered, clock, late = [one.where for one in self.placed], self.clock, self.late
        return {
            **({} if clock is None else {'clock_offset': _clock_table(clock, late)}),
            **({} if self.rough is None else {'room_rough_mm': round(self.rough * 1e3, 2)}),
            'shared': self.shared.findings,
            'cannot_decide': _cannot_decide(self.shared, registered, late is not None),
            'absorbed': {}
            if all(one.given is not None for one in registered)
            else absorbed('scan'),
        }


def _jobs(request: RoomRequest, sources: Sequence[TruthSource]) -> list[Job]:
    if len(request.poses) not in (0, 1, len(sources)):
        raise InputError(
            f'--pose: must be given once or once for each of {len(sources)} recordings, got '
            f'{len(request.poses)}'
        )
    guesses: Sequence[tuple[float, ...] | None] = request.poses or [None]
    if len(guesses) == 1:
        guesses = list(guesses) * len(sources)
    settings = replace(request.settings(), poses=())
    jobs = [
        Job(
            source.path,
            settings,
            guess,
            math.inf if source.uptime is None else float(source.uptime.mean()),
        )
        for source, guess in zip(sources, guesses, strict=True)
    ]
    for job in jobs:
        for file in job.files[1:]:
            read_trajectory(file)
    return jobs


def _register_one(job: Job) -> Registered | str:
    # The reason where it cannot be registered.
    try:
        return register(job)
    except InputError as error:
        return str(error)


def _fit(
    parts: Sequence[Sequence[PosedImage]], placed: Sequence[_Placed]
) -> tuple[Shared, list[RoomFit]]:
    # Recordings that do not fit would distort the shared errors, so they are left out first. So
    # are those whose poses are used as they were given.
    registered = [one.where for one in placed]
    pairs = zip(parts, registered, strict=True)
    alone = solve([view for part, one in pairs if one.given is None for view in part], NO_ERRORS)
    first = judge(registered, alone)
    good = [view for view in alone.views if first[view.recording].state != 'refused']
    shared = estimate(good) if good else Shared(alone, {})
    final = judge(registered, shared.solution) if good else first
    off = _off_together(parts, placed)
    for i, one in enumerate(placed):
        if one.where.given is not None:
            final[i] = as_given(one.where, parts[i], off)
        elif first[i].state == 'refused':
            final[i] = first[i]
    return shared, final


def _off_together(parts: Sequence[Sequence[PosedImage]], placed: Sequence[_Placed]) -> str:
    # Whether given poses are all off by one motion of the camera in the body.
    told, pairs = placed[0].job.request.told, list(zip(parts, placed, strict=True))
    given = [one.where.given for one in placed if one.where.given is not None]
    if told is None or not given:
        return ''
    views = [view for part, one in pairs if one.where.given is not None for view in part]
    mount = Pose.from_numbers(np.array(told.camera_in_body))
    return common_motion(views, np.mean(given, axis=0), mount)


def _row(
    placed: _Placed, verdict: RoomFit, surfaces: RoomSurfaces | None, written: Written | None
) -> dict[str, Any]:
    where = placed.where
    state, reasons = verdict.state, verdict.reasons
    if written is not None and not written.shares['known']:
        state, reasons = 'refused', ('the ground truth of none of its pixels is known', *reasons)
    row = placed.source.row(
        state,
        [*reasons, *(() if written is None else written.notes)],
        motion='moving' if where.moving else 'still',
        frames=len(where.poses) if where.moving else 1,
        fitting=round(verdict.fitting, 4),
        seconds=round(where.seconds, 2),
    )
    if where.told is not None:
        row |= {
            'told_off_mm': round(where.told[0] * 1e3, 1),
            'told_off_deg': round(where.told[1], 2),
        }
    if surfaces is not None and written is not None:
        row |= {
            'pose': [round(value, 6) for value in surfaces.pose],
            'pose_sigma_mm': round(verdict.deviation[0] * 1e3, 3),
            'pose_sigma_deg': round(verdict.deviation[1], 4),
            'residual_mm': round(verdict.residual * 1e3, 3)
            if np.isfinite(verdict.residual)
            else None,
            **written.table(),
        }
    return row


def _latency(request: RoomRequest, clock: ClockOffset | None) -> float | None:
    # How late images are. None where it is not known: the clocks' own offset was not given, or the
    # whole offset was not found.
    told = None if request.told is None else request.told.clock_offset
    if clock is None or clock.reason or told is None:
        return None
    late = clock.seconds - told
    return late if abs(late) > _CLEAR_LATENCY * clock.deviation else 0.0


def _clock_table(clock: ClockOffset, late: float | None) -> dict[str, Any]:
    if clock.reason:
        return {'verdict': 'not found', 'reason': clock.reason}
    table: dict[str, Any] = {
        'verdict': 'found',
        'seconds': round(clock.seconds, 6),
        'standard_deviation': round(clock.deviation, 6),
    }
    return table if late is None else {**table, 'latency': round(late, 6)}


def _cannot_decide(
    shared: Shared, registered: Sequence[Registered], late: bool
) -> list[dict[str, Any]]:
    confounded = {
        effect: str(finding['reason'])
        for effect, finding in shared.findings.items()
        if effect in _HIDDEN_UNLESS_FITTED and finding['verdict'] == 'confounded'
    }
    fitted = [one for one in registered if one.given is None]
    if not fitted:
        return []
    out = hidden_by_scan(any(one.moving for one in fitted), late, confounded)
    for effect, finding in shared.findings.items():
        if effect not in confounded and finding['verdict'] == 'confounded':
            remedy = 'a recording of a bright corner'
            if 'depth_scale' in shared.findings:
                remedy = 'a scan of the right scale'
            elif effect == 'offset':
                remedy = 'more recordings of tilted walls at several distances'
            reason = f'{finding["reason"]}; {remedy} would decide it'
            out.append({'effect': effect, 'reason': reason})
    return out
