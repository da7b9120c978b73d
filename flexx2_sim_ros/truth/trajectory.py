"""Rough poses of a camera from motion capture, odometry or TF, as initial values."""

from collections.abc import Sequence
import csv
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import bag_messages
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.opening import BAG_FILES, is_bag
from flexx2_sim_ros.truth.transforms import FARTHEST, listed, pose_of, transforms_between
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseStamped'
COVARIANT = 'geometry_msgs/msg/PoseWithCovarianceStamped'
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_COLUMNS = 't', 'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'
# Standard deviations of a pose, as the covariance of ROS: along and about the axes of its frame.
_DEVIATIONS = 'sx', 'sy', 'sz', 'srx', 'sry', 'srz'
_MOST_DEVIATION = np.repeat([1.0, np.pi / 2], 3)  # metres, radians
_ROUNDING = 1e-6  # of a correlation
_TIMES = 't', 'time', 'stamp', 'timestamp'
_SUFFIXES = '.txt', '.csv', '.tum'
_LONGEST_GAP = 500_000_000  # longest time between two poses for interpolation, nanoseconds
_MOST_BYTES = 1 << 30


@dataclass(frozen=True)
class PoseSource:
    """A source of poses; one of `file`, `topic` and `frames` is set."""

    file: Path | None = None  # see `read_trajectory`; or a folder with one for each recording
    topic: str = ''  # of the bag, with odometry or stamped poses
    frames: tuple[str, ...] = ()  # of the room and of the body in the TF of the bag
    # Pose of the camera (optical frame) in the tracked body: x, y, z (metres), qx, qy, qz, qw.
    camera_in_body: tuple[float, ...] = IDENTITY
    clock_offset: float | None = None  # seconds: stamps minus those of the poses; None: found
    relative: bool = False  # the poses are in a frame of their own: only motions are used
    # Standard deviations of the poses, metres and degrees: they are used as they are. None: they
    # are rough, and fitted to the recordings, if the file does not say it.
    accuracy: tuple[float, float] | None = None
    recorded: bool = False  # the covariances of the topic's messages say it

    def files_of(self, recording: Path) -> list[Path]:
        """Return the file with the poses of a recording: in a folder, that of the same name."""
        if self.file is None:
            return []
        if not self.file.is_dir():
            return [self.file]
        files = [self.file / f'{recording.stem}{suffix}' for suffix in _SUFFIXES]
        return [next((file for file in files if file.is_file()), files[0])]


@dataclass(frozen=True)
class Trajectory:
    """Poses with stamps."""

    name: str  # for messages
    stamp_ns: np.ndarray  # (N,) int64, rising
    poses: np.ndarray  # (N, 7) x, y, z in metres, qx, qy, qz, qw
    fixed: bool = False  # one pose holds for all times
    # (N, 6, 6) of the poses: metres and radians, along and about the axes of their frame.
    covariances: np.ndarray | None = None

    def at(self, stamp_ns: np.ndarray) -> np.ndarray:
        """Interpolate (T, 7) poses by (T,) int64 stamps, NaN where no pose is near in time."""
        if self.fixed:
            return np.tile(self.poses[-1], (len(stamp_ns), 1))
        after = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 1, len(self.stamp_ns) - 1)
        before = after - 1
        known = (stamp_ns >= self.stamp_ns[0]) & (stamp_ns <= self.stamp_ns[-1])
        known &= self.stamp_ns[after] - self.stamp_ns[before] <= _LONGEST_GAP
        out = np.full((len(stamp_ns), 7), np.nan)
        if known.any():
            # Seconds from the first pose: nanoseconds since 1970 are too large for float64.
            times = (self.stamp_ns - self.stamp_ns[0]) / 1e9
            wanted = (stamp_ns[known] - self.stamp_ns[0]) / 1e9
            for axis in range(3):
                out[known, axis] = np.interp(wanted, times, self.poses[:, axis])
            turns = Slerp(times, Rotation.from_quat(self.poses[:, 3:]))
            out[known, 3:] = turns(wanted).as_quat()
        return out


@dataclass(frozen=True)
class CameraTrajectory:
    """Rough poses of the camera in the recording at `path`, by stamps of their own clock."""

    path: Path
    chain: tuple[Trajectory, ...]  # from the room to the body, each in the frame before
    source: PoseSource

    @property
    def fixed(self) -> bool:
        """Return whether one pose holds for all times."""
        return all(one.fixed for one in self.chain)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the first and the last stamp; not for poses that are fixed."""
        moving = [one.stamp_ns for one in self.chain if not one.fixed]
        return max(int(one[0]) for one in moving), min(int(one[-1]) for one in moving)

    def at(self, stamp_ns: np.ndarray) -> np.ndarray:
        """Return (T, 7) poses of the camera, NaN where there is none; as `Trajectory.at`."""
        poses = self.chain[0].at(stamp_ns)
        for link in self.chain[1:]:
            poses = _compose(poses, link.at(stamp_ns))
        return _compose(poses, np.tile(self.source.camera_in_body, (len(poses), 1)))

    def theirs(self, stamp_ns: np.ndarray, found: float | None = None) -> np.ndarray:
        """Return stamps of the recording by the clock of the poses, `found` seconds apart."""
        offset = self.source.clock_offset if found is None else found
        return stamp_ns - round((offset or 0.0) * 1e9)

    @property
    def told(self) -> str:
        """Return what says how accurate the poses are; nothing if they are rough."""
        body = self.chain[0]
        if self.source.accuracy is not None or self.source.recorded:
            return '--pose-accuracy'
        return '' if body.covariances is None else f'{body.name}: {", ".join(_DEVIATIONS)}'

    def covariance(self, stamp_ns: np.ndarray) -> np.ndarray:
        """Return the mean (6, 6) covariance of poses, optical frame, where it is `told`."""
        body, mount = self.chain[0], Pose.from_numbers(self.source.camera_in_body)
        if self.source.accuracy is not None:
            return covariance_of(self.source.accuracy)
        assert body.covariances is not None
        out = []
        after = np.searchsorted(body.stamp_ns, stamp_ns).clip(0, len(body.stamp_ns) - 1)
        for numbers, own in zip(body.at(stamp_ns), body.covariances[after], strict=True):
            if np.isfinite(numbers).all():
                turn = Pose.from_numbers(numbers).R
                lever = np.eye(6)  # A body that turns moves its camera.
                lever[:3, 3:] = np.cross(turn @ mount.t, np.eye(3))
                slope = np.kron(np.eye(2), (turn @ mount.R).T) @ lever
                out.append(slope @ own @ slope.T)
        mean = np.mean(out, axis=0)
        return np.asarray(mean + mean.T) / 2

    def no_overlap(self, stamp_ns: np.ndarray) -> InputError:
        """Return the error that no pose is at these (T,) stamps."""
        moving = next(one for one in self.chain if not one.fixed)
        return InputError(
            f'{moving.name}: must have poses at the time of {shown_path(self.path)}, '
            f'{stamp_ns[0] / 1e9:.3f} to {stamp_ns[-1] / 1e9:.3f} s, got poses from '
            f'{moving.stamp_ns[0] / 1e9:.3f} to {moving.stamp_ns[-1] / 1e9:.3f} s; '
            'stamps must be seconds; --clock-offset adds to those of the poses'
        )


def camera_trajectory(source: PoseSource, path: Path, camera: str = '') -> CameraTrajectory:
    """Read a camera's poses; of several robots' TF, that of the camera's namespace is used."""
    return CameraTrajectory(path, tuple(_chain(source, path, camera)), source)


def covariance_of(accuracy: tuple[float, float]) -> np.ndarray:
    """Return the (6, 6) covariance of poses of these standard deviations, metres and degrees."""
    sigmas = np.array(accuracy) * (1, np.radians(1))
    return np.diag(np.repeat(sigmas**2, 3))


def _compose(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    out = np.full(outer.shape, np.nan)
    good = np.isfinite(outer).all(axis=1) & np.isfinite(inner).all(axis=1)
    if good.any():
        turn = Rotation.from_quat(outer[good, 3:])
        out[good, :3] = outer[good, :3] + turn.apply(inner[good, :3])
        out[good, 3:] = (turn * Rotation.from_quat(inner[good, 3:])).as_quat()
    return out


def _chain(source: PoseSource, path: Path, camera: str) -> list[Trajectory]:
    files = source.files_of(path)
    if files:
        return [read_trajectory(files[0])]
    if not (is_bag(path) or path.suffix in BAG_FILES):
        option = '--odometry' if source.topic else '--tf'
        raise InputError(f'{option}: must be given with bags only, got {shown_path(path)}')
    if source.topic:
        return [_of_topic(path, source.topic, source.recorded)]
    name = shown_path(path)
    return [
        _checked(
            f'{name}: tf of {shown(link.child)}', link.stamps, np.array(link.rows), link.fixed
        )
        for link in transforms_between(Bag(path), source.frames[0], source.frames[1], camera)
    ]


@lru_cache(maxsize=2)  # A worker process places many recordings along the same trajectory.
def read_trajectory(path: Path) -> Trajectory:
    """
    Read poses with stamps from a text file.

    Each line is ``t x y z qx qy qz qw`` (TUM; seconds, metres); the first line of a ``.csv`` names
    these columns in any order, among others, and may name sx, sy, sz (metres), srx, sry, srz
    (radians). Lines without numbers are left out. Raises `InputError` below two poses.
    """
    name = f'--trajectory: {shown_path(path)}'
    if not is_regular_file(path):
        raise InputError(f'{name}: must be a text file, got no such file')
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f'{name}: must be at most 1 GiB, got {path.stat().st_size / 2**30:.1f}')
    table = path.suffix.lower() == '.csv'
    try:
        # Stamps as text: nanoseconds since 1970 are too many digits for a float.
        with path.open(encoding='utf-8-sig', errors='replace') as file:
            lines = csv.reader(file) if table else (line.split() for line in file)
            columns = _columns(name, next(lines, [])) if table else tuple(range(8))
            rows = [row for row in (_numbers(line, columns) for line in lines) if row]
    except (OSError, csv.Error) as error:
        raise InputError(f'{name}: cannot be read: {shown(str(error))}') from error
    if len(rows) < 2:
        raise InputError(
            f'{name}: must have two poses or more, lines of {" ".join(_COLUMNS)} in seconds and '
            f'metres, got {len(rows)}'
        )
    numbers = np.array([row[1] for row in rows])
    deviations = numbers[:, 7:]
    covariances = deviations[..., None] ** 2 * np.eye(6) if deviations.size else None
    return _checked(name, [row[0] for row in rows], numbers[:, :7], covariances=covariances)


def _columns(name: str, first: Sequence[str]) -> tuple[int, ...]:
    head = [word.strip().lower() for word in first]
    time = next((word for word in _TIMES if word in head), '')
    wanted = (time, *_COLUMNS[1:])
    missing = [column for column in _COLUMNS if wanted[_COLUMNS.index(column)] not in head]
    if missing:
        raise InputError(
            f'{name}: must have the columns {", ".join(_COLUMNS)} in its first line, got '
            f'{shown(",".join(head))}'
        )
    told = [word for word in _DEVIATIONS if word in head]
    if told and len(told) < len(_DEVIATIONS):
        raise InputError(
            f'{name}: must have all of the columns {", ".join(_DEVIATIONS)} or none of them, got '
            f'{", ".join(told)}'
        )
    return tuple(head.index(word) for word in (*wanted, *told))


def _numbers(row: Sequence[str], columns: tuple[int, ...]) -> tuple[int, list[float]] | None:
    # Stamp in nanoseconds and a pose; None if the line has none.
    try:
        words = [row[column].strip() for column in columns]
        whole, _, digits = words[0].partition('.')
        exact = whole.isdigit() and (digits.isdigit() or not digits)
        stamp = int(whole + f'{digits:0<9}'[:9]) if exact else round(float(words[0]) * 1e9)
        pose = [float(word) for word in words[1:]]
    except (ValueError, IndexError, OverflowError):
        return None
    return (stamp, pose) if abs(stamp) < 1 << 63 and np.isfinite(pose).all() else None


def _checked(
    name: str,
    stamps: Sequence[int],
    poses: np.ndarray,
    fixed: bool = False,
    covariances: np.ndarray | None = None,
) -> Trajectory:
    good = np.isfinite(poses).all(axis=1)  # Motion capture that has lost the body.
    stamp, first = np.unique(np.array(stamps, np.int64)[good], return_index=True)
    if len(stamp) < 1 + (not fixed):
        raise InputError(f'{name}: must have poses at two times or more, got {len(stamp)}')
    poses = poses[good][first]
    turned = np.abs(poses[:, 3:]).max(axis=1)
    if not ((turned > 1e-6) & (turned < FARTHEST)).all():
        raise InputError(
            f'{name}: must have quaternions qx, qy, qz, qw, got zeros or huge numbers'
        )
    far = float(np.abs(poses[:, :3]).max())
    if far > FARTHEST:
        raise InputError(
            f'{name}: x, y, z: must be metres, at most {FARTHEST:g} from the origin, got {far:.4g}'
        )
    if covariances is not None:
        covariances = covariances[good][first]
        variances = np.einsum('nii->ni', covariances)
        good = (variances > 0) & (variances < _MOST_DEVIATION**2)
        most = np.sqrt(np.maximum(variances[:, None] * variances[..., None], 0))
        if not (good.all() and (np.abs(covariances) <= most * (1 + _ROUNDING)).all()):
            raise InputError(
                f'{name}: must have variances of all six axes, above 0 and below (1 m)2 and (90 '
                f'degrees)2, and correlations of at most 1, got variances from '
                f'{variances.min():.2g} to {variances.max():.2g}'
            )
    return Trajectory(name, stamp, poses, fixed, covariances)


def _of_topic(path: Path, topic: str, recorded: bool) -> Trajectory:
    bag = Bag(path)
    kind, kinds = bag.topics.get(topic), (POSE, ODOMETRY, COVARIANT)[recorded:]
    if kind not in kinds:
        known = [one for one, of in bag.topics.items() if of in kinds]
        raise InputError(
            f'--odometry: must be a topic of odometry or poses with stamps in '
            f'{shown_path(path)}, one of {listed(known)}, got {shown(topic)}'
        )
    stamps, poses, covariances = [], [], []
    for _, _, _, data in bag.messages({topic}):
        message = bag_messages.decode(kind, data, f'{shown_path(path)}: {topic}')
        stamps.append(stamp_nanoseconds(message.header.stamp))
        pose = message.pose if kind == POSE else message.pose.pose
        poses.append(pose_of(pose.position, pose.orientation))
        if recorded:
            covariances.append(np.reshape(message.pose.covariance, (6, 6)))
    told = np.array(covariances) if recorded else None
    return _checked(f'{shown_path(path)}: {topic}', stamps, np.array(poses), covariances=told)
