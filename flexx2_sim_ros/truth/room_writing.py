"""Ground truth of a recording in a room."""

from dataclasses import dataclass, replace

from flexx2_sim_ros.truth.alignment import view_of
from flexx2_sim_ros.truth.clean import Clean, difference, REFUSED, render
from flexx2_sim_ros.truth.columns import ErrorColumns
from flexx2_sim_ros.truth.observation import Footage, Observation
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.registration import Job, LOST, Registered, with_bounce
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.trajectory import Trajectory
from flexx2_sim_ros.truth.writing import GroundTruth, without_hidden
import numpy as np

_PIXELS = 2000
_REFINEMENTS = 4
_PATCH, _LEAST_PATCHES = 8, 10  # pixels; ASSUMED


@dataclass(frozen=True)
class RoomSurfaces:
    """
    A room as a recording shows it; see `Surfaces`.

    `pose` is that of a still recording from the joint fit, see `Pose.numbers`; `covariance` (6, 6)
    its covariance. `columns` are the errors that all recordings share, `values` their
    coefficients. `room_error` is how accurate the room is, metres; `latency` how late images are
    by their stamps, seconds. Frames get the ground truth of their stamps.
    """

    job: Job
    registered: Registered
    pose: tuple[float, ...]
    columns: ErrorColumns
    values: tuple[float, ...]
    covariance: np.ndarray
    room_error: float
    latency: float = 0.0

    @property
    def moving(self) -> bool:
        """Return whether the camera moved."""
        return self.registered.moving

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return the room from the pose of a frame."""
        pose = self.registered.poses[number] if self.moving else self.pose
        if not np.isfinite(pose).all():
            return None
        return self.render(Pose.from_numbers(np.array(pose)), footage)

    def render(self, pose: Pose, footage: Footage) -> Clean:
        """Return the room from a pose."""
        room = load_room(self.job.request.room)
        return render(room, pose, footage.still.rays, self.room_error)

    def truth(self, footage: Footage) -> GroundTruth:
        """Return the room of each frame, or from the pose of a still recording."""
        if self.moving:
            cleans = _of_frames(self, footage)
        else:
            clean = self.at(footage, 0)
            assert clean is not None
            cleans = [without_hidden(clean, footage.still)]
        rough = roughness(cleans[0], footage.still)
        return GroundTruth(
            cleans, footage.still, {'pose_covariance': self.covariance}, found=rough
        )


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


def _of_frames(what: RoomSurfaces, footage: Footage) -> list[Clean]:
    # Of a moving camera. Where images are late, from where the camera was at the stamp: that is
    # where later images were taken. The last frames have no later ones and are unknown, as are
    # those beside a frame whose pose was lost.
    frames = [footage.observe(image) for image in footage.frames()]
    lost = np.array(what.registered.costs) > LOST
    poses = [_pose_of(what, footage, frame, i) for i, frame in enumerate(frames)]
    seen = [what.render(pose, footage) for pose in poses]
    truths = [
        truth.without(True, REFUSED) if gone else without_hidden(truth, frame)
        for truth, frame, gone in zip(seen, frames, lost, strict=True)
    ]
    if not what.latency:
        return truths
    stamp_ns = footage.reader.stamp_ns
    path = Trajectory('', stamp_ns, np.array([pose.numbers() for pose in poses]))
    late = stamp_ns + round(what.latency * 1e9)
    after = np.searchsorted(stamp_ns, late)
    beside = np.clip([after - 1, after], 0, len(lost) - 1)
    out = []
    for numbers, truth, gone in zip(path.at(late), truths, lost[beside].any(axis=0), strict=True):
        if np.isfinite(numbers).all() and not gone:
            there = what.render(Pose.from_numbers(numbers), footage)
            out.append(there.without(~truth.known, REFUSED))
        else:
            out.append(truth.without(True, REFUSED))
    return out


def _pose_of(what: RoomSurfaces, footage: Footage, frame: Observation, number: int) -> Pose:
    # The pose is fitted again, with the shared errors subtracted.
    request, numbers = what.job.request, what.registered.poses[number]
    pose = Pose.from_numbers(np.array(numbers if np.isfinite(numbers).all() else what.pose))
    if not what.values or what.registered.given is not None:
        return pose
    view = view_of(request.room, frame, _PIXELS, pose)
    if what.columns.bounce:
        view = with_bounce(view, frame, footage, request.profile)
    values = np.array(what.values)
    view = replace(view, uptime=what.job.uptime, columns=what.columns, values=values)
    return view.settled(_REFINEMENTS).pose
