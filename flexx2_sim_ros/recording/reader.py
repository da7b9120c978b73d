"""A recording, whichever file it lies in: whole, or frame by frame in bounded memory."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import DISTORTION_MODELS, full_distortion
from flexx2_sim_ros.profiles.modes import flexx2, Profile
from flexx2_sim_ros.recording.stamps import LONGEST, read_stamps
import numpy as np

# Keys that can have one image a frame; all other arrays are the recording's as a whole.
STACKS = ('depth', 'clean_depth', 'reflectivity', 'amplitude')
# Keys that can have an entry a frame; () or (H, W) is for all frames.
TIMES = ('stamp', 'stamp_ns', 'received', 'uptime')
ONE_EACH = (*TIMES, *STACKS, 'known', 'clean_sigma', 'incidence', 'reflectivity_spread')
_KNOWN = {*STACKS, 'K', 'stamp', 'stamp_ns', 'usecase'}
_USUAL_RATE = 30.0  # Hz
ASSUMED = 'stamp: not in the file'  # part of a note
PROCESSED = 'depth: processed by'  # part of a note


@dataclass(frozen=True)
class Recording:
    """
    What one camera recorded, or a part of it.

    Attributes
    ----------
    depth : numpy.ndarray
        (T, H, W) float32, metres along the optical axis, NaN where invalid.
    K : numpy.ndarray
        (3, 3) float64 camera matrix, pixels.
    stamp : numpy.ndarray
        (T,) float64, seconds.
    stamp_ns : numpy.ndarray
        (T,) int64, nanoseconds: exact where seconds since 1970 do not fit a float64.
    usecase : str or None
        The camera's mode, None where the file does not say.
    clean_depth : numpy.ndarray or None
        (H, W) or (T, H, W) ground truth, metres, NaN where there is no return.
    reflectivity : numpy.ndarray or None
        (H, W) or (T, H, W), 0 to 1.
    amplitude : numpy.ndarray or None
        (H, W) or (T, H, W): the camera's gray image, in its own units.
    extra : dict of str to numpy.ndarray
        All else that the file has, whole (never cut to the part). From a bag: ``camera``,
        ``frame_id`` and, where it is not zero, ``distortion`` as in `Intrinsics.distortion`.
    path : pathlib.Path
        Where it was read from.
    camera : str or None
        Which camera of a bag it is; None for ``.npz``.
    notes : tuple of str
        What a person should know: a bag that was cut off, frames without clean depth, a mode
        that changed on the way.

    """

    depth: np.ndarray
    K: np.ndarray  # noqa: N815
    stamp: np.ndarray
    stamp_ns: np.ndarray
    usecase: str | None
    clean_depth: np.ndarray | None
    reflectivity: np.ndarray | None
    amplitude: np.ndarray | None
    extra: dict[str, np.ndarray]
    path: Path
    camera: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layout:
    """Dtype and (H, W) of the images of a stack."""

    dtype: np.dtype
    shape: tuple[int, int]


@dataclass
class Content:
    """What a file has."""

    layouts: dict[str, Layout]  # keys with one image a frame; ``depth`` is float32
    arrays: dict[str, np.ndarray]  # all other keys
    notes: list[str] = field(default_factory=list)  # as in `Recording`
    # Notes that say that the mode or the camera changes midway: `arrays` has those at the start.
    changes: list[str] = field(default_factory=list)
    frames: int = 0  # images of ``depth``; needed where there is no stamp


class RecordingReader(ABC):
    """
    A recording that is read when it is asked for, in bounded memory.

    Made by `open_recording`. Files are open only while they are read from.

    Attributes
    ----------
    path : pathlib.Path
        The file or folder.
    camera : str or None
        Which camera of a bag.
    profile : Profile
        The camera whose modes give the rate of a file without stamps.
    K, stamp, stamp_ns, usecase
        As in `Recording`, of all frames.
    distortion : tuple of float
        Of the lens, as in `Intrinsics.distortion`; zeros where the file has none.
    layouts, arrays, notes, changes
        As in `Content`.
    assumed_stamps : bool
        Whether the file has no stamps: those here are at the rate of the mode, from 0.

    Examples
    --------
    >>> def brightest(path):
    ...     reader = open_recording(path)
    ...     return max(np.nanmax(part.depth) for part in reader.chunks(64))

    """

    def __init__(
        self, path: Path, camera: str | None, content: Content, profile: Profile | None = None
    ) -> None:
        """Check what is there against the recording format."""
        self.path = path
        self.camera = camera
        self.profile = profile or flexx2()
        self.layouts = content.layouts
        self.arrays = content.arrays
        self.notes = content.notes
        self.changes = content.changes
        self.K = self._matrix()
        self.distortion = self._lens()
        usecase = self.arrays.get('usecase')
        if usecase is not None and (usecase.dtype.kind != 'U' or usecase.ndim):
            raise InputError(
                f'{path}: usecase: must be a string, got dtype {usecase.dtype} and shape '
                f'{usecase.shape}'
            )
        self.usecase = None if usecase is None else str(usecase)
        self.assumed_stamps = not {'stamp', 'stamp_ns'} & self.arrays.keys()
        self.stamp, self.stamp_ns = (
            self._usual_stamps(content.frames)
            if self.assumed_stamps
            else read_stamps(self.path, self.arrays)
        )
        self._check_images()

    @abstractmethod
    def frames(self, key: str) -> Iterator[np.ndarray]:
        """
        Iterate over the images of a stack.

        Parameters
        ----------
        key : str
            One of `layouts`.

        Yields
        ------
        numpy.ndarray
            (H, W) of the stack's dtype, one for each of `stamp`.

        Raises
        ------
        InputError
            When an image cannot be read.

        """

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return (T, H, W)."""
        return len(self.stamp), *self.layouts['depth'].shape

    @property
    def received_ns(self) -> np.ndarray | None:
        """
        Return when each frame arrived, (T,) int64 nanoseconds; None where the file does not say.

        Raises
        ------
        InputError
            When ``received`` is not (T,) finite seconds.

        """
        if 'received' not in self.arrays:
            return None
        wanted = f'seconds ({len(self.stamp)},), one for each frame, at most {LONGEST:g}'
        found = self._numbers('received', wanted)
        if found.shape != self.stamp.shape or not (np.abs(found) <= LONGEST).all():
            raise InputError(
                f'{self.path}: received: must be {wanted}, got {found.dtype} of shape '
                f'{found.shape}'
            )
        return np.rint(found.astype(np.float64) * 1e9).astype(np.int64)

    def chunks(self, size: int = 64) -> Iterator[Recording]:
        """Iterate over consecutive parts of up to `size` frames."""
        images = {key: self.frames(key) for key in self.layouts}
        for start in range(0, len(self.stamp), size):
            count = min(size, len(self.stamp) - start)
            yield self._recording(start, self._take(images, count))

    def load(self) -> Recording:
        """Return the whole recording."""
        return next(self.chunks(len(self.stamp)))

    def _take(self, images: dict[str, Iterator[np.ndarray]], count: int) -> dict[str, np.ndarray]:
        # Frame by frame: in a bag, the images of a frame are beside each other.
        blocks = {
            key: np.empty((count, *self.layouts[key].shape), self.layouts[key].dtype)
            for key in images
        }
        for index in range(count):
            for key, source in images.items():
                blocks[key][index] = next(source)
        return blocks

    def _recording(self, start: int, stacks: dict[str, np.ndarray]) -> Recording:
        part = slice(start, start + len(stacks['depth']))

        def image(key: str) -> np.ndarray | None:
            array = self.arrays.get(key)
            if array is None:
                return stacks.get(key)
            return array[part] if array.ndim == 3 else array

        return Recording(
            stacks['depth'],
            self.K,
            self.stamp[part],
            self.stamp_ns[part],
            self.usecase,
            image('clean_depth'),
            image('reflectivity'),
            image('amplitude'),
            {key: value for key, value in self.arrays.items() if key not in _KNOWN},
            self.path,
            self.camera,
            tuple(self.notes),
        )

    def _matrix(self) -> np.ndarray:
        matrix = self._numbers('K', 'a camera matrix (3, 3)')
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InputError(
                f'{self.path}: K: must be a camera matrix (3, 3) of finite numbers, got shape '
                f'{matrix.shape}'
            )
        return matrix.astype(np.float64)

    def _lens(self) -> tuple[float, ...]:
        if 'distortion' not in self.arrays:
            return full_distortion(())
        wanted = 'k1, k2, p1, p2, k3 (5,) or these and k4, k5, k6 (8,), finite'
        found = self._numbers('distortion', wanted)
        if found.size > max(DISTORTION_MODELS) or not np.isfinite(found).all():
            raise InputError(
                f'{self.path}: distortion: must be {wanted}, got {found.dtype} of shape '
                f'{found.shape}'
            )
        return full_distortion(found.ravel())

    def _usual_stamps(self, frames: int) -> tuple[np.ndarray, np.ndarray]:
        rate, whose = _USUAL_RATE, 'usual'
        for mode in self.profile.modes:
            if self.usecase is not None and mode.name.lower() == self.usecase.strip().lower():
                rate, whose = mode.rate_hz, f'that of {mode.name}'
        self.notes.append(f'{self.path}: {ASSUMED}: taken for {rate:g} Hz, {whose}')
        exact = np.rint(np.arange(frames) * (1e9 / rate)).astype(np.int64)
        return exact / 1e9, exact

    def _numbers(self, key: str, wanted: str) -> np.ndarray:
        found = self.arrays.get(key)
        if found is None:
            names = ', '.join([*self.layouts, *self.arrays]) or 'nothing'
            raise InputError(
                f'{self.path}: {key}: must be {wanted}, got none; the file has {names}'
            )
        if found.dtype.kind not in 'fiu':
            raise InputError(f'{self.path}: {key}: must be {wanted}, got dtype {found.dtype}')
        return found

    def _check_images(self) -> None:
        for key in STACKS:
            if key in self.arrays:
                shape = self._numbers(key, 'numbers (H, W) or (T, H, W)').shape
            elif key in self.layouts:
                shape = (len(self.stamp), *self.layouts[key].shape)
            else:
                continue
            if shape not in (self.shape, self.shape[1:]):
                raise InputError(
                    f'{self.path}: {key}: must have the size of depth, {self.shape} or '
                    f'{self.shape[1:]}, got {shape}'
                )


def uptime_of(reader: RecordingReader) -> np.ndarray | None:
    """
    Return (T,) seconds since power-on of each frame, as the recording says; None if it does not.

    Raises InputError when `uptime` is not one number or one for each frame.
    """
    uptime = reader.arrays.get('uptime')
    if uptime is None:
        return None
    if uptime.dtype.kind not in 'fiu' or uptime.shape not in ((), (len(reader.stamp),)):
        raise InputError(
            f'{reader.path}: uptime: must be seconds since power-on ({len(reader.stamp)},), '
            f'got {uptime.dtype} of shape {uptime.shape}'
        )
    since = 0.0 if uptime.ndim else (reader.stamp_ns - reader.stamp_ns[0]) / 1e9
    return np.asarray(uptime + since, float)
