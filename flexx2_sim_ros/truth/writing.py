"""Write a recording with its ground truth."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.recording import open_recording, RecordingReader, RecordingWriter
from flexx2_sim_ros.recording.truth import KEYS
from flexx2_sim_ros.truth.alignment import align, choose
from flexx2_sim_ros.truth.clean import (
    apart,
    Clean,
    difference,
    edges,
    HIDDEN,
    KNOWN,
    PARTS,
    REFUSED,
    render,
)
from flexx2_sim_ros.truth.columns import ErrorColumns
from flexx2_sim_ros.truth.gray_frames import gray_images, has_gray, has_gray_frames
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.observation import Footage, mask_of, Observation, observe
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.reflectivity import (
    gray_samples,
    GraySamples,
    GrayScale,
    with_reflectivity,
)
from flexx2_sim_ros.truth.registration import bounced, Job, LOST, Registered
from flexx2_sim_ros.truth.rooms import Room
from flexx2_sim_ros.truth.trajectory import Trajectory
import numpy as np

_WRITTEN = {'clean_depth', 'incidence', 'depth', *KEYS}
_PIXELS = 2000
_REFINEMENTS = 4
_FEW = 0.01  # of the pixels may contradict the ground truth without a note
_LIT_FRAMES = 6  # of a moving recording: enough to learn what gray values mean


@dataclass(frozen=True)
class Writing:
    """
    A recording to write, and its ground truth.

    Attributes
    ----------
    job : Job
    registered : Registered
    pose : tuple of float
        Pose of a still recording from the joint fit; see `Pose.numbers`.
    columns : ErrorColumns
        The errors that all recordings share.
    values : tuple of float
        Coefficients of these errors.
    covariance : numpy.ndarray
        (6, 6) covariance of the pose.
    room_error : float
        Standard deviation of the room's surfaces along their normals, metres.
    target : pathlib.Path
        The file to write.
    scale : GrayScale or None
        What gray values mean; None where they are not used.
    keys : mapping of str to numpy.ndarray
        Further keys to write.
    latency : float
        How late images are by their stamps, seconds. Frames get the ground truth of their stamps.

    """

    job: Job
    registered: Registered
    pose: tuple[float, ...]
    columns: ErrorColumns
    values: tuple[float, ...]
    covariance: np.ndarray
    room_error: float
    target: Path
    scale: GrayScale | None = None
    keys: Mapping[str, np.ndarray] = field(default_factory=dict)
    latency: float = 0.0


@dataclass(frozen=True)
class PageImages:
    """
    The images of a recording on the page: its first frame or median.

    Attributes
    ----------
    image : numpy.ndarray
        (H, W) float32: measured depth, or gray values.
    edges : numpy.ndarray
        (H, W) bool, where clean depth jumps.
    residual : numpy.ndarray
        (H, W) float32 metres, measured minus clean; NaN where unknown or invalid.
    part : numpy.ndarray
        (H, W) uint8 as in `Clean`.
    shares : dict
        The fraction of pixels of each of `PARTS`, over all frames.
    notes : tuple of str
        What a person should know of pixels that contradict the ground truth.

    """

    image: np.ndarray
    edges: np.ndarray
    residual: np.ndarray
    part: np.ndarray
    shares: dict[str, float]
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> float:
        """Return the fraction of the pixels that are known."""
        return self.shares['known']

    def table(self) -> dict[str, Any]:
        """Return the shares of pixels for ``truth.yaml``: known, and unknown by reason."""
        left = {name: round(part, 4) for name, part in self.shares.items() if name != 'known'}
        return {'known': round(self.known, 4), 'unknown': left}


def write_recording(what: Writing) -> PageImages:
    """
    Write a recording with `clean_depth` and its accuracy, whole or not at all.

    Raises
    ------
    InputError
        When the recording cannot be read or the file cannot be written.

    """
    room = load_room(what.job.room)
    reader = open_recording(what.job.path, what.job.camera, what.job.profile)
    moving = what.registered.moving
    footage = observe(reader, what.job.profile, 'moving' if moving else 'still')
    if moving:
        truths = _of_frames(room, what, footage)
    else:
        clean = render(
            room, Pose.from_numbers(np.array(what.pose)), footage.still.rays, what.room_error
        )
        truths = [without_hidden(clean, footage.still)]
    if what.scale is not None and shows_light(reader, moving):
        truths = [
            with_reflectivity(truth, gray, footage.still.rays, what.scale)
            for truth, gray in zip(truths, gray_images(reader, moving), strict=True)
        ]
    known = write_truth(
        reader, what.target, truths, moving, {'pose_covariance': what.covariance, **what.keys}
    )
    return picture_of(truths[0], footage.still, known)


def read_light(what: Writing) -> list[GraySamples]:
    """
    Return what a recording shows of the light that surfaces send back, of some frames.

    Empty where its reflectivity is known from the mesh or the recording, and where it has no gray
    images.

    Raises
    ------
    InputError
        When the recording cannot be read.

    """
    room = load_room(what.job.room)
    reader = open_recording(what.job.path, what.job.camera, what.job.profile)
    moving = what.registered.moving
    if not shows_light(reader, moving):
        return []
    footage = observe(reader, what.job.profile, 'moving' if moving else 'still')
    rays = footage.still.rays
    poses = what.registered.poses if moving else [what.pose]
    every = max(len(poses) // _LIT_FRAMES, 1)
    out = []
    for number, gray in enumerate(gray_images(reader, moving)):
        if number % every or not np.isfinite(poses[number]).all():
            continue
        clean = render(room, Pose.from_numbers(np.array(poses[number])), rays, what.room_error)
        if clean.reflectivity is not None:
            return []
        out.append(gray_samples(gray, clean, rays))
    return [one for one in out if one is not None]


def shows_light(reader: RecordingReader, moving: bool) -> bool:
    """Return whether the reflectivity of a recording is to be taken from its gray images."""
    known = 'reflectivity' in reader.layouts or 'reflectivity' in reader.arrays
    return not known and has_gray(reader) and (not moving or has_gray_frames(reader))


def write_truth(
    reader: RecordingReader,
    target: Path,
    truths: Sequence[Clean],
    moving: bool,
    keys: Mapping[str, np.ndarray],
) -> dict[str, float]:
    """
    Write a recording with ground truth, whole or not at all.

    Parameters
    ----------
    reader : RecordingReader
        The recording.
    target : pathlib.Path
        The file to write.
    truths : sequence of Clean
        One for each frame if the camera moves, else one.
    moving : bool
        Whether the camera moved.
    keys : mapping of str to numpy.ndarray
        Further keys: the accuracy of the ground truth, the time since power-on.

    Returns
    -------
    dict
        As `PageImages.shares`.

    Raises
    ------
    InputError
        When the recording cannot be read or the file cannot be written.

    """
    with RecordingWriter(target, *reader.shape) as file:
        for image in reader.frames('depth'):
            file.add_depth(image[None])
        part, arrays = _arrays(truths, moving, mask_of(reader))
        arrays |= keys
        for key, value in arrays.items():
            file.add_array(key, value)
        for key, value in _copied(reader, arrays.keys()):
            if isinstance(value, np.ndarray):
                file.add_array(key, value)
            else:
                file.add_frames(key, reader.layouts[key].dtype, value)
    counts = np.bincount(part.ravel(), minlength=len(PARTS))
    return dict(zip(PARTS, (counts / part.size).tolist(), strict=True))


def picture_of(truth: Clean, first: Observation, shares: dict[str, float]) -> PageImages:
    """Return the images of a recording for the page: of its first frame or median."""
    error = difference(truth, first)
    residual = np.where(truth.known, error, np.nan).astype(np.float32)
    few = _FEW * truth.known.size
    farther, hidden = (apart(truth, first) > 0).sum(), (truth.part == HIDDEN).sum()
    notes = []
    if farther > few:
        notes.append(
            f'{farther} pixels are farther than the ground truth, and stay known: an error of '
            'the camera, or a thing that is not there any more'
        )
    if hidden > few:
        notes.append(f'{hidden} pixels show something nearer that the ground truth has not')
    return PageImages(
        first.depth.astype(np.float32), edges(truth), residual, truth.part, shares, tuple(notes)
    )


def _of_frames(room: Room, what: Writing, footage: Footage) -> list[Clean]:
    # Of a moving camera. Where images are late, from where the camera was at the stamp: that is
    # where later images were taken. The last frames have no later ones and are unknown, as are
    # those beside a frame whose pose was lost.
    frames = [footage.observe(image) for image in footage.frames()]
    lost = np.array(what.registered.costs) > LOST
    poses = [_pose_of(room, what, footage, frame, i) for i, frame in enumerate(frames)]
    seen = [render(room, pose, footage.still.rays, what.room_error) for pose in poses]
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
            placed = Pose.from_numbers(numbers)
            there = render(room, placed, footage.still.rays, what.room_error)
            out.append(there.without(~truth.known, REFUSED))
        else:
            out.append(truth.without(True, REFUSED))
    return out


def _pose_of(room: Room, what: Writing, footage: Footage, frame: Observation, number: int) -> Pose:
    # The pose is fitted again, with the shared errors subtracted.
    numbers = what.registered.poses[number]
    pose = Pose.from_numbers(np.array(numbers if np.isfinite(numbers).all() else what.pose))
    if what.values and not what.registered.believed:
        added = np.zeros(frame.depth.shape)
        if what.columns.bounce and footage.mode is not None:
            added = bounced(room, pose, frame, footage.reader.K, footage.mode, what.job.profile)
        values, rays = np.array(what.values), np.nan_to_num(frame.rays).reshape(-1, 2)
        true = what.columns.true_rays(values, rays)
        hits = room.cast(pose, true)
        errors = what.columns.errors(values, hits, true, added.ravel(), what.job.uptime)
        errors += hits.depth - room.cast(pose, rays).depth
        right = frame.depth - errors.reshape(frame.depth.shape)
        corrected = Observation(frame.rays, right, frame.sigma, frame.wraps)
        pose = align(room, choose(corrected, _PIXELS), pose, _REFINEMENTS).pose
    return pose


def without_hidden(clean: Clean, image: Observation) -> Clean:
    """Return ground truth that is unknown where something stands before it."""
    return clean.without(apart(clean, image) < 0, HIDDEN)


def _arrays(
    truths: Sequence[Clean], moving: bool, mask: np.ndarray | None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    lit = [truth.reflectivity is not None for truth in truths]
    if 2 * sum(lit) > len(lit):  # A bag lacks the gray images of a few frames.
        truths = [truth if one else _dark(truth) for truth, one in zip(truths, lit, strict=True)]

    def stack(name: str) -> np.ndarray:
        images = [getattr(truth, name) for truth in truths]
        return np.stack(images) if moving else images[0]

    part = stack('part')
    if mask is not None:
        part = np.where(mask, part, np.uint8(HIDDEN))
    out = {
        'clean_depth': stack('depth'),
        'incidence': stack('incidence'),
        'known': part == KNOWN,
        'clean_sigma': stack('sigma'),
    }
    for name in ('reflectivity', 'reflectivity_spread'):
        if all(getattr(truth, name) is not None for truth in truths):
            out[name] = stack(name)
    return part, out


def _dark(truth: Clean) -> Clean:
    # Of a frame whose reflectivity is not known, where that of the others is.
    nothing = np.full(truth.depth.shape, np.nan, np.float32)
    dark = replace(truth, reflectivity=nothing, reflectivity_spread=nothing)
    return dark.without(True, REFUSED)


def _copied(reader: RecordingReader, written: Set[str]) -> Iterator[tuple[str, Any]]:
    # Everything else that the recording has, as arrays or as iterators over frames.
    left = _WRITTEN | written
    yield 'K', reader.K
    yield 'stamp', reader.stamp
    yield 'stamp_ns', reader.stamp_ns
    for key, value in reader.arrays.items():
        if key not in left | {'K', 'stamp', 'stamp_ns'}:
            yield key, value
    for key in reader.layouts:
        if key not in left:
            yield key, reader.frames(key)
