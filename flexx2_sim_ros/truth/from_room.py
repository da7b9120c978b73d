"""Ground truth from a room: register recordings, fit poses with shared errors, render frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_scan
from flexx2_sim_ros.truth.alignment import ErrorColumns, NO_ERRORS, PosedImage, view_of
from flexx2_sim_ros.truth.clean import Clean, difference, REFUSED, render, without_hidden
from flexx2_sim_ros.truth.clock import ClockOffset, common_offset
from flexx2_sim_ros.truth.joint import common_motion, solve
from flexx2_sim_ros.truth.observation import Footage, Observation
from flexx2_sim_ros.truth.registration import LOST, register, Registered, views_of, with_bounce
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.run import GivenRecording, RoomRequest, Run
from flexx2_sim_ros.truth.shared import DIFFER, estimate
from flexx2_sim_ros.truth.solver import blocks
from flexx2_sim_ros.truth.trajectory import read_trajectory, Trajectory
from flexx2_sim_ros.truth.verdict import as_given, check_room, judge, room_error
from flexx2_sim_ros.truth.writing import GroundTruth, Surfaces, Written
import numpy as np

_CLEAR_LATENCY = 3.0  # standard deviations
# Shared errors that the poses take where they are confounded; the poses' covariance omits this.
_HIDDEN_UNLESS_FITTED = 'intrinsics_error', 'warm_up_drift'
_PIXELS = 2000
_REFINEMENTS = 4
_PATCH, _LEAST_PATCHES = 8, 10  # pixels; ASSUMED


@dataclass(frozen=True)
class RoomSurfaces(Surfaces):
    """A room in a recording, each frame at its stamp."""

    pose: Pose  # of a still recording, from the joint fit
    columns: ErrorColumns  # the errors that all recordings share
    values: tuple[float, ...]  # their coefficients
    covariance: np.ndarray  # (6, 6) of the pose
    room_error: float  # how accurate the room is, metres
    latency: float = 0.0  # how late images are by their stamps, seconds

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return the room from the pose of a frame."""
        pose = self.placed.poses[number] if self.placed.moving else self.pose
        return None if pose is None else self.render(pose, footage)

    def render(self, pose: Pose, footage: Footage) -> Clean:
        """Return the room from a pose."""
        room = load_room(self.given.request.room)
        return render(room, pose, footage.still.rays, self.room_error)

    def truth(self, footage: Footage) -> GroundTruth:
        """Return the room of each frame, or from the pose of a still recording."""
        if self.placed.moving:
            cleans = self._of_frames(footage)
        else:
            cleans = [without_hidden(self.render(self.pose, footage), footage.still)]
        rough = roughness(cleans[0], footage.still)
        accuracy = {'pose_covariance': self.covariance}
        return GroundTruth(cleans, footage.still, accuracy, found=rough)

    def _of_frames(self, footage: Footage) -> list[Clean]:
        # Of a moving camera. Where images are late, from where the camera was at the stamp: that
        # is where later images were taken. The last frames have no later ones and are unknown, as
        # are those beside a frame whose pose was lost.
        frames = [footage.observe(image) for image in footage.frames()]
        lost = np.array(self.placed.costs) > LOST
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
        request, pose = self.given.request, self.placed.poses[number] or self.pose
        if not self.values or self.placed.given is not None:
            return pose
        view = view_of(request.room, frame, _PIXELS, pose)
        if self.columns.bounce:
            view = with_bounce(view, frame, footage, request.profile)
        values = np.array(self.values)
        view = replace(view, uptime=self.given.since_start, columns=self.columns, values=values)
        return view.settled(_REFINEMENTS).pose


def roughness(clean: Clean, image: Observation) -> float:
    """
    Return how far measured depth and a room differ within small flat patches, beyond noise.

    It is the standard deviation along the normal, metres: the median over patches, each without
    its mean and tilt. NaN with too few patches.
    """
    slant = np.cos(clean.incidence) * image.length
    values = difference(clean, image) * slant, image.sigma * slant, clean.known & image.smooth
    error, noise, good = (blocks(one, _PATCH) for one in values)
    whole = good.all(axis=1) & np.isfinite(error).all(axis=1)
    if whole.sum() < _LEAST_PATCHES:
        return float('nan')
    v, u = np.mgrid[:_PATCH, :_PATCH].reshape(2, -1)
    plane, _ = np.linalg.qr(np.stack([np.ones(_PATCH**2), u, v], axis=1))
    left = error[whole] - error[whole] @ plane @ plane.T
    variance = (left**2).sum(axis=1) / (_PATCH**2 - 3) - (noise[whole] ** 2).mean(axis=1)
    return float(np.sqrt(max(np.median(variance), 0.0)))


class RoomSource:
    """A room, from a mesh or a MuJoCo model; see `Source`."""

    kind, step, kinds, lit = 'scan', 'registering', (Registered, ClockOffset, Pose), True
    unread = {'motion': 'unknown', 'frames': 0, 'fitting': 0.0}
    place = staticmethod(register)

    def __init__(self, request: RoomRequest) -> None:
        """Store what is asked for."""
        self.request = request
        told = None if request.told is None else request.told.file
        self.files = [request.room, *([] if told is None else [told])]

    def jobs(self, run: Run, given: Sequence[GivenRecording]) -> Sequence[tuple[Any, ...]]:
        """Return each recording and its rough pose; read what is known of room and poses."""
        poses, count = self.request.poses, len(given)
        if len(poses) not in (0, 1, count):
            raise InputError(
                f'--pose: must be given once or once for each of {count} recordings, got '
                f'{len(poses)}'
            )
        for one in given:
            for file in one.request.files_of(one.path)[1:]:
                read_trajectory(file)
        run.progress('loading the room', 0.0)
        self.size = np.ptp(load_room(self.request.room).bounds, axis=0)
        guesses = poses if len(poses) == count else (poses or (None,)) * count
        return list(zip(given, guesses, strict=True))

    def solve(
        self, run: Run, given: Sequence[GivenRecording], found: Mapping[int, Registered]
    ) -> dict[int, Surfaces]:
        """Fit all poses together with the errors that the recordings share."""
        self.found = found
        numbered = [(i, given[i], where) for i, where in found.items()]
        parts = run.each('simulating bounces', (0.55, 0.65), views_of, numbered)
        run.progress('fitting poses and shared errors', 0.65)
        self._fit(dict(zip(found, parts, strict=True)))
        check_room(
            self.request.room, bool(self.request.poses), [*found.values()], [*self.fits.values()]
        )
        offsets = [one.clock for one in found.values() if one.clock is not None]
        self.clock = common_offset(offsets) if offsets else None
        self.late = self._latency()
        self.error, self.error_is = room_error(self.solution)
        if self.request.room_error is not None:
            self.error, self.error_is = self.request.room_error, 'given'
        placed = {i: self._surfaces(i, given[i]) for i in found}
        self.surfaces = {i: one for i, one in placed.items() if one is not None}
        return {**self.surfaces}

    def _fit(self, parts: Mapping[int, Sequence[PosedImage]]) -> None:
        # Recordings that do not fit would distort the shared errors, so they are left out first.
        # So are those whose poses are used as they were given, which may be off by one motion
        # together.
        given = {i: one.given for i, one in self.found.items() if one.given is not None}
        alone = solve([view for i in parts if i not in given for view in parts[i]], NO_ERRORS)
        first = judge(self.found, alone)
        good = [view for view in alone.views if first[view.recording].state != 'refused']
        scale_error = self.request.scale_error
        self.solution, self.shared = estimate(good, scale_error) if good else (alone, {})
        self.fits = judge(self.found, self.solution)
        self.fits |= {i: one for i, one in first.items() if one.state == 'refused'}
        if given and self.request.told is not None:
            told = [view for i in given for view in parts[i]]
            mount = Pose.from_numbers(self.request.told.camera_in_body)
            off = common_motion(told, np.mean([*given.values()], axis=0), mount)
            self.fits |= {i: as_given(self.found[i], parts[i], off) for i in given}

    def _latency(self) -> float | None:
        # How late images are. None where it is not known: the clocks' own offset was not given, or
        # the whole offset was not found.
        clock, told = self.clock, self.request.told
        if clock is None or clock.reason or told is None or told.clock_offset is None:
            return None
        late = clock.seconds - told.clock_offset
        return late if abs(late) > _CLEAR_LATENCY * clock.deviation else 0.0

    def _surfaces(self, number: int, recording: GivenRecording) -> RoomSurfaces | None:
        # The room from the poses of a recording; None if it is refused.
        solution, where = self.solution, self.found[number]
        mine = [k for k, view in enumerate(solution.views) if view.recording == number]
        covariance, late = where.given, 0.0
        if covariance is not None:
            pose = next(one for one in where.poses if one is not None)
        elif self.fits[number].state != 'refused' and mine:
            pose = solution.views[mine[0]].pose
            covariance = np.mean([solution.full_covariance(k) for k in mine], axis=0)
            late = self.late or 0.0
        else:
            return None
        fitted = solution.columns, tuple(map(float, solution.values))
        return RoomSurfaces(recording, where, pose, *fitted, covariance, self.error, late)

    def rows(self, written: Mapping[int, Written]) -> dict[int, dict[str, Any]]:
        """Return where the camera was in each recording, and how well it fits the room."""
        seen = [one.found for one in written.values() if np.isfinite(one.found)]
        self.rough = float(np.median(seen)) if seen else None
        return {i: self._row(i, written.get(i)) for i in self.found}

    def _row(self, number: int, written: Written | None) -> dict[str, Any]:
        where, fit = self.found[number], self.fits[number]
        row: dict[str, Any] = {
            'verdict': fit.state,
            'reasons': fit.reasons,
            'motion': 'moving' if where.moving else 'still',
            'frames': len(where.poses) if where.moving else 1,
            'fitting': round(fit.fitting, 4),
            'seconds': round(where.seconds, 2),
        }
        if where.told is not None:
            row['told_off_mm'] = round(where.told[0] * 1e3, 1)
            row['told_off_deg'] = round(where.told[1], 2)
        if written is None:
            return row
        row['reasons'] += written.notes
        if not written.shares['known']:
            nothing = 'the ground truth of none of its pixels is known'
            row |= {'verdict': 'refused', 'reasons': (nothing, *row['reasons'])}
        left = fit.residual
        return row | {
            'pose': [round(value, 6) for value in self.surfaces[number].pose.numbers()],
            'pose_sigma_mm': round(fit.deviation[0] * 1e3, 3),
            'pose_sigma_deg': round(fit.deviation[1], 4),
            'residual_mm': round(left * 1e3, 3) if np.isfinite(left) else None,
            **written.table(),
        }

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
        fitted = [one.moving for one in self.found.values() if one.given is None]
        rough = {} if self.rough is None else {'room_rough_mm': round(self.rough * 1e3, 2)}
        return {
            **self._clock_table(),
            **rough,
            'shared': self.shared,
            'cannot_decide': self._cannot_decide(any(fitted)) if fitted else [],
            'absorbed': absorbed('scan') if fitted else {},
        }

    def _clock_table(self) -> dict[str, Any]:
        if self.clock is None:
            return {}
        table: dict[str, Any] = {'verdict': 'not found', 'reason': self.clock.reason}
        if not self.clock.reason:
            table = {
                'verdict': 'found',
                'seconds': round(self.clock.seconds, 6),
                'standard_deviation': round(self.clock.deviation, 6),
            }
        if self.late is not None:
            table['latency'] = round(self.late, 6)
        return {'clock_offset': table}

    def _cannot_decide(self, moving: bool) -> list[dict[str, Any]]:
        why = {
            name: str(one['reason'])
            for name, one in self.shared.items()
            if one['verdict'] == 'confounded'
        }
        hidden = {name: why.pop(name) for name in [*why] if name in _HIDDEN_UNLESS_FITTED}
        out = hidden_by_scan(moving, self.late is not None, hidden)
        for effect, reason in why.items():
            remedy, more = 'a recording of a bright corner', {}
            if 'depth_scale' in why and (effect == 'depth_scale' or reason == DIFFER):
                remedy = 'a length in the room that is measured with a tape (--scale-error)'
                part = absorbed('scan').get(effect, 0.0)
                more = {'absorbed': part, 'settled_by': remedy, 'confounded': True}
            elif effect == 'offset':
                remedy = 'more recordings of tilted walls at several distances'
            out.append({'effect': effect, 'reason': f'{reason}; {remedy} would decide it', **more})
        return out
