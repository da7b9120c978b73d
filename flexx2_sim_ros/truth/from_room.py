"""Ground truth from a room: register recordings, fit poses with shared errors, render frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_scan
from flexx2_sim_ros.truth.alignment import ErrorColumns, NO_ERRORS, PosedImage, view_of
from flexx2_sim_ros.truth.clean import Clean, difference, REFUSED, render, without_hidden
from flexx2_sim_ros.truth.clock import ClockOffset, common_offset
from flexx2_sim_ros.truth.files import TruthSource
from flexx2_sim_ros.truth.joint import common_motion, solve
from flexx2_sim_ros.truth.observation import Footage, Observation
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.registration import (
    Job,
    LOST,
    register,
    Registered,
    views_of,
    with_bounce,
)
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.run import RoomRequest, Run
from flexx2_sim_ros.truth.shared import estimate, Shared
from flexx2_sim_ros.truth.trajectory import read_trajectory, Trajectory
from flexx2_sim_ros.truth.verdict import as_given, check_room, judge, room_error, RoomFit
from flexx2_sim_ros.truth.writing import GroundTruth, Surfaces, Written
import numpy as np

_CLEAR_LATENCY = 3.0  # standard deviations
# Shared errors that the poses take where they are confounded; the poses' covariance omits this.
_HIDDEN_UNLESS_FITTED = 'intrinsics_error', 'warm_up_drift'
_PIXELS = 2000
_REFINEMENTS = 4
_PATCH, _LEAST_PATCHES = 8, 10  # pixels; ASSUMED


@dataclass(frozen=True)
class RoomSurfaces:
    """A room in a recording, each frame at its stamp; see `Surfaces`."""

    job: Job
    registered: Registered
    pose: tuple[float, ...]  # of a still recording, from the joint fit; see `Pose.numbers`
    columns: ErrorColumns  # the errors that all recordings share
    values: tuple[float, ...]  # their coefficients
    covariance: np.ndarray  # (6, 6) of the pose
    room_error: float  # how accurate the room is, metres
    latency: float = 0.0  # how late images are by their stamps, seconds

    @property
    def moving(self) -> bool:
        """Return whether the camera moved."""
        return self.registered.moving

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return the room from the pose of a frame."""
        pose = self.registered.poses[number] if self.moving else self.pose
        return self.render(Pose.from_numbers(pose), footage) if np.isfinite(pose).all() else None

    def render(self, pose: Pose, footage: Footage) -> Clean:
        """Return the room from a pose."""
        room = load_room(self.job.request.room)
        return render(room, pose, footage.still.rays, self.room_error)

    def truth(self, footage: Footage) -> GroundTruth:
        """Return the room of each frame, or from the pose of a still recording."""
        if self.moving:
            cleans = self._of_frames(footage)
        else:
            cleans = [
                without_hidden(self.render(Pose.from_numbers(self.pose), footage), footage.still)
            ]
        rough = roughness(cleans[0], footage.still)
        accuracy = {'pose_covariance': self.covariance}
        return GroundTruth(cleans, footage.still, accuracy, found=rough)

    def _of_frames(self, footage: Footage) -> list[Clean]:
        # Of a moving camera. Where images are late, from where the camera was at the stamp: that
        # is where later images were taken. The last frames have no later ones and are unknown, as
        # are those beside a frame whose pose was lost.
        frames = [footage.observe(image) for image in footage.frames()]
        lost = np.array(self.registered.costs) > LOST
        poses = [self._pose_of(footage, frame, i) for i, frame in enumerate(frames)]
        seen = [self.render(pose, footage) for pose in poses]
        truths = [
            truth.without(True, REFUSED) if gone else without_hidden(truth, frame)
            for truth, frame, gone in zip(seen, frames, lost, strict=True)
        ]
        if not self.latency:
            return truths
        stamp_ns = footage.reader.stamp_ns
        path = Trajectory('', stamp_ns, np.array([pose.numbers() for pose in poses]))
        late = stamp_ns + round(self.latency * 1e9)
        after = np.searchsorted(stamp_ns, late)
        beside = np.clip([after - 1, after], 0, len(lost) - 1)
        out = []
        for numbers, truth, gone in zip(
            path.at(late), truths, lost[beside].any(axis=0), strict=True
        ):
            if np.isfinite(numbers).all() and not gone:
                there = self.render(Pose.from_numbers(numbers), footage)
                out.append(there.without(~truth.known, REFUSED))
            else:
                out.append(truth.without(True, REFUSED))
        return out

    def _pose_of(self, footage: Footage, frame: Observation, number: int) -> Pose:
        # The pose is fitted again, with the shared errors subtracted.
        request, numbers = self.job.request, self.registered.poses[number]
        pose = Pose.from_numbers(numbers if np.isfinite(numbers).all() else self.pose)
        if not self.values or self.registered.given is not None:
            return pose
        view = view_of(request.room, frame, _PIXELS, pose)
        if self.columns.bounce:
            view = with_bounce(view, frame, footage, request.profile)
        values = np.array(self.values)
        view = replace(view, uptime=self.job.uptime, columns=self.columns, values=values)
        return view.settled(_REFINEMENTS).pose


def roughness(clean: Clean, image: Observation) -> float:
    """
    Return how far measured depth and a room differ within small flat patches, beyond noise.

    It is the standard deviation along the normal, metres: the median over patches, each without
    its mean and tilt. NaN with too few patches.
    """
    height, width = (side - side % _PATCH for side in clean.depth.shape)
    blocks, error, flat = [], difference(clean, image), clean.known & image.smooth
    slant = np.cos(clean.incidence) * image.length
    for values in (error * slant, image.sigma * slant, flat):
        rows = values[:height, :width].reshape(height // _PATCH, _PATCH, -1, _PATCH)
        blocks.append(rows.swapaxes(1, 2).reshape(-1, _PATCH**2))
    error, noise, good = blocks
    whole = good.all(axis=1) & np.isfinite(error).all(axis=1)
    if whole.sum() < _LEAST_PATCHES:
        return float('nan')
    v, u = np.mgrid[:_PATCH, :_PATCH].reshape(2, -1)
    plane, _ = np.linalg.qr(np.stack([np.ones(_PATCH**2), u, v], axis=1))
    left = error[whole] - error[whole] @ plane @ plane.T
    variance = (left**2).sum(axis=1) / (_PATCH**2 - 3) - (noise[whole] ** 2).mean(axis=1)
    return float(np.sqrt(max(np.median(variance), 0.0)))


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
        self.files = [request.room, *([] if told is None else [told])]

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
        found = {one.number: self._surfaces(i, one) for i, one in enumerate(self.placed)}
        self.surfaces = {number: one for number, one in found.items() if one is not None}
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
        solution, given = self.shared.solution, one.where.given
        mine = [k for k, view in enumerate(solution.views) if view.recording == number]
        if given is not None:
            pose = next(pose for pose in one.where.poses if np.isfinite(pose).all())
            covariance, late = given, 0.0
        elif self.verdicts[number].state != 'refused' and mine:
            pose = tuple(solution.views[mine[0]].pose.numbers())
            covariance = np.mean([solution.full_covariance(k) for k in mine], axis=0)
            late = self.late or 0.0
        else:
            return None
        values = tuple(map(float, solution.values))
        error, columns = self.error, solution.columns
        return RoomSurfaces(one.job, one.where, pose, columns, values, covariance, error, late)

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
        clock, late = self.clock, self.late
        fitted = [one.where.moving for one in self.placed if one.where.given is None]
        return {
            **({} if clock is None else {'clock_offset': _clock_table(clock, late)}),
            **({} if self.rough is None else {'room_rough_mm': round(self.rough * 1e3, 2)}),
            'shared': self.shared.findings,
            'cannot_decide': _cannot_decide(self.shared, any(fitted), late is not None)
            if fitted
            else [],
            'absorbed': absorbed('scan') if fitted else {},
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
    times = [math.inf if one.uptime is None else float(one.uptime.mean()) for one in sources]
    jobs = [
        Job(source.path, settings, guess, time)
        for source, guess, time in zip(sources, guesses, times, strict=True)
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
    # are those whose poses are used as they were given, which may be off by one motion together.
    registered = [one.where for one in placed]
    free: list[PosedImage] = []
    told: list[PosedImage] = []
    for part, one in zip(parts, registered, strict=True):
        (free if one.given is None else told).extend(part)
    alone = solve(free, NO_ERRORS)
    first = judge(registered, alone)
    good = [view for view in alone.views if first[view.recording].state != 'refused']
    shared = estimate(good) if good else Shared(alone, {})
    final = judge(registered, shared.solution) if good else first
    given = [one.given for one in registered if one.given is not None]
    off, source = '', placed[0].job.request.told
    if given and source is not None:
        off = common_motion(told, np.mean(given, axis=0), Pose.from_numbers(source.camera_in_body))
    for i, one in enumerate(registered):
        if one.given is not None:
            final[i] = as_given(one, parts[i], off)
        elif first[i].state == 'refused':
            final[i] = first[i]
    return shared, final


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
        row['told_off_mm'] = round(where.told[0] * 1e3, 1)
        row['told_off_deg'] = round(where.told[1], 2)
    if surfaces is not None and written is not None:
        left = verdict.residual
        row |= {
            'pose': [round(value, 6) for value in surfaces.pose],
            'pose_sigma_mm': round(verdict.deviation[0] * 1e3, 3),
            'pose_sigma_deg': round(verdict.deviation[1], 4),
            'residual_mm': round(left * 1e3, 3) if np.isfinite(left) else None,
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


def _cannot_decide(shared: Shared, moving: bool, late: bool) -> list[dict[str, Any]]:
    findings = shared.findings.items()
    why = {name: str(one['reason']) for name, one in findings if one['verdict'] == 'confounded'}
    hidden = {name: why.pop(name) for name in [*why] if name in _HIDDEN_UNLESS_FITTED}
    out = hidden_by_scan(moving, late, hidden)
    for effect, reason in why.items():
        remedy = 'a recording of a bright corner'
        if 'depth_scale' in shared.findings:
            remedy = 'a scan of the right scale'
        elif effect == 'offset':
            remedy = 'more recordings of tilted walls at several distances'
        out.append({'effect': effect, 'reason': f'{reason}; {remedy} would decide it'})
    return out
