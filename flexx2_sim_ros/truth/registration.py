"""Register one recording to a room: a pose for each of its frames, and views for the joint fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
import math
from pathlib import Path
import time

from flexx2_sim_ros.camera import Camera, Profile
from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import least_certain, Pose
from flexx2_sim_ros.truth.alignment import align, AlignedPose, choose, PosedImage, view_of
from flexx2_sim_ros.truth.clean import render
from flexx2_sim_ros.truth.clock import ClockOffset, find_offset
from flexx2_sim_ros.truth.observation import Footage, Observation, observe
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.run import GivenRecording, RoomRequest
from flexx2_sim_ros.truth.search import find, look_around
from flexx2_sim_ros.truth.trajectory import (
    camera_trajectory,
    CameraTrajectory,
    covariance_of,
    Trajectory,
)
import numpy as np

_KEY_FRAMES = 6  # frames of a moving recording in the joint fit
_PIXELS, _TRACKED = 5000, 2000
# Cost above which a frame is searched again around the previous pose. If it stays above, the
# camera is lost in this frame.
LOST = 0.6
# Cost above which the mirror image of the room is tried as well.
_SUSPECT = 0.12
_STANDS = 0.03, math.radians(1.5)  # metres, radians: noise of the poses of a camera that stands
_PLAIN = 0.5  # reflectivity where it is unknown
_MOST_BOUNCE = 0.3  # metres: more is another surface, behind an edge
MOST_METRES = 0.01  # standard deviation of a pose that is held by what its camera sees
ASSUMED = 0.01, 0.5  # metres and degrees: standard deviations of given poses that are not told
TOLD = 0.3, 20.0  # metres and degrees that a rough pose may be wrong by
_NOT_HELD = (
    'what it sees does not hold its pose, so that the given poses are used as they are, and taken '
    f'to be right within {ASSUMED[0] * 1e3:g} mm and {ASSUMED[1]:g} degrees (--pose-accuracy)'
)


@dataclass(frozen=True)
class Registered:
    """The poses of a recording, each frame fitted by itself."""

    poses: tuple[Pose | None, ...]  # one, or one a frame if it moves; None where none is given
    costs: tuple[float, ...]  # mean truncated residual of each
    moving: bool
    rival: float = math.inf  # cost of the best other pose
    mirrored: float = math.inf  # of the best pose in the room's mirror image, if that was tried
    seconds: float = 0.0
    # Median differences from given rough poses in the room's frame, metres and degrees.
    told: tuple[float, float] | None = None
    clock: ClockOffset | None = None  # to the given poses, of a moving recording
    given: np.ndarray | None = None  # (6, 6) covariance of `poses` if they are those given
    why: str = ''  # why they are, if nobody has asked for it


def strays(told: tuple[float, float] | None) -> bool:
    """Return whether a fitted pose is farther from the given one than that may be wrong."""
    return told is not None and (told[0] > TOLD[0] or told[1] > TOLD[1])


def register(recording: GivenRecording, guess: tuple[float, ...] | None) -> Registered:
    """
    Register a recording, of which a rough pose is known, or None: x, y, z, qx, qy, qz, qw.

    Raises `InputError` where it or the room cannot be read.
    """
    request = recording.request
    load_room(request.room)
    begin = time.perf_counter()
    reader = recording.opened()
    given = None
    if request.told is not None:
        given = camera_trajectory(request.told, recording.path, reader.camera or '')
    motion = request.motion
    if motion == 'auto' and given is not None and _moves(given, reader.stamp_ns):
        motion = 'moving'
    footage = observe(reader, request.profile, motion)
    told = [None] * len(reader.stamp_ns) if given is None else _told(given, footage)
    # Whether the given poses are in the room and of a known clock.
    usable = given and not given.source.relative and given.source.clock_offset is not None
    if given is not None and given.told:
        if not usable:
            raise InputError(
                f'{given.told}: must be given with poses in the room and --clock-offset SECONDS'
            )
        covariance = given.covariance(given.theirs(reader.stamp_ns))
        return _as_given(told, footage.moving, covariance)
    first, start = 0, None if guess is None else Pose.from_numbers(guess)
    if start is None and given is not None and not given.source.relative:
        first, start = next(((i, one) for i, one in enumerate(told) if one is not None), (0, None))
    found, first, mirrored = _search(request, footage, first, start)
    fits, clock = [found], None
    if footage.moving:
        fits = _track(request.room, footage, found.pose, first, told)
        if given is not None:
            clock = _clock(given, reader.stamp_ns, fits)
            if not clock.reason:
                told = _told(given, footage, clock.seconds)
            elif not any(told):
                raise given.no_overlap(reader.stamp_ns)
    distance = None if given is None or given.source.relative else _distance(told, fits)
    # Where a camera is lost in most frames, it may end near the given poses by chance.
    astray = strays(distance) or np.median([one.cost for one in fits]) > LOST
    if usable and astray and not _held(request.room, footage, fits):
        # What a camera of few pixels sees may not hold its pose.
        seconds = time.perf_counter() - begin
        assumed = _as_given(told, footage.moving, covariance_of(ASSUMED))
        return replace(assumed, seconds=seconds, why=_NOT_HELD)
    return Registered(
        tuple(one.pose for one in fits),
        tuple(one.cost for one in fits),
        footage.moving,
        found.rival,
        mirrored,
        time.perf_counter() - begin,
        distance,
        clock,
    )


def _as_given(poses: Sequence[Pose | None], moving: bool, covariance: np.ndarray) -> Registered:
    if not moving:  # One pose, though motion capture may begin after the first frame.
        poses = [one for one in poses if one is not None][:1]
    costs = tuple(math.inf if one is None else 0.0 for one in poses)
    return Registered(tuple(poses), costs, moving, given=covariance)


def _held(room: Path, footage: Footage, fits: Sequence[AlignedPose]) -> bool:
    # Whether the pixels of most frames determine the pose.
    frames = _key_frames(footage, [one.cost for one in fits])
    seen = [view_of(room, image, _PIXELS, fits[i].pose) for i, image in frames.items()]
    free = [least_certain(np.linalg.inv(view.linear.H))[0] for view in seen]
    return not free or float(np.median(free)) < MOST_METRES


def _moves(given: CameraTrajectory, stamp_ns: np.ndarray) -> bool:
    # An image that changes little may hide a motion: the sky, or a camera of few pixels.
    poses = given.at(given.theirs(stamp_ns))
    known = [Pose.from_numbers(one) for one in poses if np.isfinite(one).all()]
    motions = np.array([known[0].motion_to(one) for one in known]).reshape(-1, 2, 3)
    away = (np.linalg.norm(motions, axis=2) > _STANDS).any(axis=1)
    return bool(away.sum() > len(away) / 10)


def _told(
    given: CameraTrajectory, footage: Footage, found: float | None = None
) -> list[Pose | None]:
    # The given rough pose of each frame, with the offset of clocks that was found or given. A
    # moving camera may find an offset later, so that all poses may be missing.
    there = given.theirs(footage.reader.stamp_ns, found)
    poses = given.at(there)
    can_wait = footage.moving and given.source.clock_offset is None
    if not can_wait and not np.isfinite(poses).all(axis=1).any():
        raise given.no_overlap(there)
    return [Pose.from_numbers(one) if np.isfinite(one).all() else None for one in poses]


def _clock(
    given: CameraTrajectory, stamp_ns: np.ndarray, fits: Sequence[AlignedPose]
) -> ClockOffset:
    if given.fixed:
        return ClockOffset(reason='the given poses do not move')
    good = [i for i, one in enumerate(fits) if one.cost <= LOST]
    if len(good) < 2:
        return ClockOffset(reason='the camera is lost in most frames')
    fitted = Trajectory('', stamp_ns[good], np.array([fits[i].pose.numbers() for i in good]))
    middle = given.source.clock_offset or 0.0
    return find_offset(stamp_ns, fitted.at, given.at, given.span_ns, middle)


def _distance(told: Sequence[Pose | None], fits: Sequence[AlignedPose]) -> tuple[float, float]:
    poses = [one.pose for one in fits]
    fitted = poses if len(poses) == len(told) else poses[:1] * len(told)
    pairs = zip(told, fitted, strict=True)
    motions = np.array([one.motion_to(other) for one, other in pairs if one is not None])
    metres, radians = (np.median(np.linalg.norm(motions[:, i : i + 3], axis=1)) for i in (0, 3))
    return float(metres), float(np.degrees(radians))


def _search(
    request: RoomRequest, footage: Footage, first: int, guess: Pose | None
) -> tuple[AlignedPose, int, float]:
    # The best pose, the number of its frame, and the cost in a mirrored room.
    path, up = request.room, request.up
    tried: list[tuple[AlignedPose, int]] = []

    def frame(number: int) -> Observation:
        return next(islice(footage.images(), number * footage.moving, None))

    count = len(footage.reader.stamp)
    for number in (0, count // 2, count - 1) if footage.moving and guess is None else (first,):
        tried.append((find(path, frame(number), guess, up), number))
        if tried[-1][0].cost < 0.5 * min(tried[-1][0].rival, LOST):
            break
    best, number = min(tried, key=lambda one: one[0].cost)
    mirrored = math.inf
    if best.cost > _SUSPECT and len(look_around(path)[0]):
        mirrored = find(path, frame(number).mirrored(), None, up).cost
    return best, number, mirrored


def _track(
    room: Path, footage: Footage, start: Pose, first: int, told: Sequence[Pose | None]
) -> list[AlignedPose]:
    # Follows the camera from this frame forwards to the end, then backwards to the beginning.
    images = list(footage.frames())
    fits: dict[int, AlignedPose] = {}
    for order in (range(first, len(images)), range(first - 1, -1, -1)):
        for number in order:
            pose, before = start, number - order.step
            if number != first:
                pose, last, now = fits[before].pose, told[before], told[number]
                if last is not None and now is not None:
                    pose = pose.moved(last.motion_to(now))
                elif before - order.step in fits:  # Assumes constant velocity.
                    pose = pose.moved(fits[before - order.step].pose.motion_to(pose))
            fits[number] = _follow(room, footage.observe(images[number]), pose)
    return [fits[number] for number in range(len(images))]


def _follow(room: Path, image: Observation, start: Pose) -> AlignedPose:
    # The pose of a frame, from the expected one.
    fit = align(room, choose(image, _TRACKED), start, 6)
    if fit.cost <= LOST:
        return fit
    return min(fit, find(room, image, start), key=lambda one: one.cost)


def _key_frames(footage: Footage, costs: Sequence[float]) -> dict[int, Observation]:
    # Some frames of a moving recording that are not lost; the image of a still one.
    if not footage.moving:
        return {0: footage.still}
    chosen = set(np.linspace(0, len(costs) - 1, _KEY_FRAMES).round().astype(int).tolist())
    return {
        number: image
        for number, image in enumerate(footage.images())
        if number in chosen and costs[number] < LOST
    }


def views_of(job: tuple[int, GivenRecording, Registered]) -> list[PosedImage]:
    """Return the views of a recording, of a number and so registered, for the joint fit."""
    number, given, where = job
    footage = given.footage(where.moving)
    out = []
    for frame, image in _key_frames(footage, where.costs).items():
        pose = where.poses[frame]
        assert pose is not None  # Or it would be lost.
        view = replace(
            view_of(given.request.room, image, _PIXELS, pose),
            recording=number,
            uptime=given.since_start,
            speed=_speed(where, footage.reader.stamp_ns, frame),
        )
        out.append(with_bounce(view, image, footage, given.request.profile))
    return out


def _speed(where: Registered, stamp_ns: np.ndarray, number: int) -> np.ndarray:
    # The motion of the camera per second around a frame.
    first, last = max(number - 1, 0), min(number + 1, len(where.poses) - 1)
    one, other = where.poses[first], where.poses[last]
    if first == last or one is None or other is None:
        return np.zeros(6)
    return one.motion_to(other) * 1e9 / (stamp_ns[last] - stamp_ns[first])


def with_bounce(
    view: PosedImage, image: Observation, footage: Footage, profile: Profile | None
) -> PosedImage:
    """Return the view of an image with simulated light that bounces once; where it has a mode."""
    mode = footage.mode
    if mode is None or not mode.modulation_hz:
        return view
    clean = render(load_room(view.room), view.pose, image.rays, 0.0)
    reflectivity = clean.reflectivity
    if reflectivity is None:
        reflectivity = np.full(clean.depth.shape, _PLAIN, np.float32)
    camera, stamp = Camera(mode.name, profile=profile, name='truth'), np.zeros(1, np.int64)
    simulated = CommonRandomNumbers(camera, clean.depth, footage.reader.K, stamp, reflectivity)
    base = simulated.depth(())[0]
    change = simulated.depth({'multipath': {}})[0].astype(np.float64) - base
    added = np.where(np.isfinite(change) & (np.abs(change) < _MOST_BOUNCE), change, 0.0)
    bounce = added.ravel()[view.target.pixel]
    return replace(view, target=replace(view.target, bounce=bounce))
