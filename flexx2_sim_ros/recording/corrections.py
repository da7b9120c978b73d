"""What a user says of a recording, where its file does not."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

from flexx2_sim_ros.errors import did_you_mean, InputError, shown, shown_path
from flexx2_sim_ros.messages.decoding import NO_DEPTH
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.png import read_mask_png
from flexx2_sim_ros.profiles.files import find_profile, shipped
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.calibration import Calibration, calibration_of, read_calibration
from flexx2_sim_ros.recording.reader import ASSUMED, Content, Layout, RecordingReader
from flexx2_sim_ros.recording.truth import read_truth
import numpy as np

MILLIMETRE = 0.001


@dataclass(frozen=True)
class Given:
    """What a user says of a recording."""

    usecase: str | None = None
    # A PNG of the images' size: the ground truth of its black pixels is unknown.
    mask: Path | None = None
    rate_hz: float | None = None  # for files without stamps
    calibration: Path | None = None  # a file with the lens; see `read_calibration`
    # Of files of other programs: metres of a count of depth, and their names of keys.
    unit: float | None = None
    keys: Mapping[str, str] = field(default_factory=dict)
    # Whether the ground truth is unknown where `clean_depth` is NaN, and not "no return".
    partial_truth: bool = False
    # Topics of a bag: of clean depth, if it is not ``clean/depth_image``, and of the infrared
    # image, where the bag does not tell.
    clean: str | None = None
    infrared: str | None = None
    radial: bool = False  # depth is along the ray of each pixel, not along the optical axis
    intrinsics: tuple[float, ...] | None = None  # fx, fy, cx, cy, pixels: no calibration file
    # Whether depth has the projection matrix of the lens, and no distortion. None: the name of a
    # bag's topic says it.
    rectified: bool | None = None
    profile: Profile | None = None  # has the mode; None: that may be a mode of any camera
    episode: int | None = None  # of a LeRobot data set

    @property
    def of_files(self) -> list[str]:
        """Return the options that only images and ``.npz`` files of other programs have."""
        values = {'--unit': self.unit, '--key': self.keys}
        return [name for name, value in values.items() if value]

    @property
    def of_lens(self) -> list[str]:
        """Return the options that say the lens."""
        values = {
            '--calibration': self.calibration,
            '--intrinsics': self.intrinsics,
            '--rectified': self.rectified,
        }
        return [name for name, value in values.items() if value is not None]

    @cached_property
    def lens(self) -> Calibration | None:
        """Return the lens, or None if it is not given; raise `InputError` as its file does."""
        if self.intrinsics is None:
            return None if self.calibration is None else read_calibration(self.calibration)
        if self.calibration is not None:
            raise InputError('--intrinsics: must be left out with --calibration, got both')
        return calibration_of(self.intrinsics)


def in_metres(depth: np.ndarray, unit: float | None = None) -> np.ndarray:
    """
    Return depth as a recording has it: float32 metres, NaN where invalid.

    ``depth`` are counts of any real dtype; 0, negative and not finite values are invalid, and of
    16 bits 65535. ``unit`` is metres of a count; left out, whole numbers are millimetres, and
    others metres.
    """
    if unit is None:
        unit = MILLIMETRE if depth.dtype.kind in 'iu' else 1.0
    with np.errstate(invalid='ignore', over='ignore'):
        metres = depth.astype(np.float32) * np.float32(unit)
        valid = (metres > 0) & (metres < np.inf)
        if depth.dtype.kind == 'u' and depth.dtype.itemsize == 2:
            valid &= depth != NO_DEPTH
        return np.where(valid, metres, np.float32(np.nan))


class ChangedRecording(RecordingReader):
    """
    A recording with other arrays or images than its file, `source`, has.

    ``arrays`` replace those of `source`, or are added; ``change`` has functions of the images of a
    stack, which become float32; ``order`` are the numbers of the frames that remain; ``profile``
    replaces that of `source`; ``notes`` are added. Raises InputError when they do not fit the
    recording.
    """

    def __init__(
        self,
        source: RecordingReader,
        arrays: Mapping[str, np.ndarray],
        change: Mapping[str, Callable[[np.ndarray], np.ndarray]],
        notes: Sequence[str],
        order: np.ndarray | None = None,
        profile: Profile | None = None,
    ) -> None:
        """Check them."""
        self._source, self._change, self._order = source, change, order
        layouts = {
            key: Layout(np.dtype(np.float32), layout.shape) if key in change else layout
            for key, layout in source.layouts.items()
        }
        kept = [note for note in source.notes if ASSUMED not in note]
        content = Content(
            layouts,
            {**source.arrays, **arrays},
            [*kept, *notes],
            source.changes,
            len(source.stamp),
        )
        super().__init__(source.path, source.camera, content, profile or source.profile)

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        images = self._source.frames(key)
        if self._order is not None:
            images = _in_order(images, self._order)
        return map(self._change[key], images) if key in self._change else images


def _in_order(images: Iterator[np.ndarray], order: np.ndarray) -> Iterator[np.ndarray]:
    # Keeps only images that come before one that belongs before them.
    wanted = set(order.tolist())
    kept: dict[int, np.ndarray] = {}
    source = enumerate(images)
    for number in order.tolist():
        while number not in kept:
            at, image = next(source)
            if at in wanted:
                kept[at] = image
        yield kept.pop(number)


def complete(reader: RecordingReader, given: Given) -> RecordingReader:
    """
    Return a recording with what a user says of it.

    Of `given` the mode, profile, mask, rate, whether the ground truth is partial and depth along
    the ray are used. Raises InputError when the profile lacks the mode, the mask cannot be read or
    has another size, the file has stamps and a rate is given, or its ground truth is partial and
    it has none.
    """
    arrays: dict[str, np.ndarray] = {}
    notes: list[str] = []
    usecase = given.usecase or reader.usecase
    if given.profile is not None and usecase is not None:
        arrays['usecase'] = np.array(given.profile.mode(usecase).name)
    elif given.usecase is not None:
        arrays['usecase'] = np.array(given.usecase)
        notes += _unknown_mode(given.usecase)
    if given.mask is not None:
        arrays['known'] = _read_mask(given.mask, reader.shape[1:])
    if given.partial_truth:
        known = _where_known(reader)
        arrays['known'] = known & arrays['known'] if given.mask is not None else known
    if 'known' in arrays:
        own = read_truth(reader.path, reader.arrays, reader.shape).known
        arrays['known'] = arrays['known'] if own is None else arrays['known'] & own
    if given.rate_hz is not None:
        if not reader.assumed_stamps:
            raise InputError(
                f'--rate: must be left out for a recording with stamps, got {given.rate_hz:g}'
            )
        arrays['stamp'] = np.arange(len(reader.stamp)) / given.rate_hz
    if not (arrays or given.radial):
        return reader
    change = {'depth': _along_axis(reader)} if given.radial else {}
    return ChangedRecording(reader, arrays, change, notes, profile=given.profile)


def _along_axis(reader: RecordingReader) -> Callable[[np.ndarray], np.ndarray]:
    @cache
    def axis() -> np.ndarray:  # not before the lens is checked
        camera = Intrinsics.from_matrix(reader.K, *reader.shape[:0:-1], reader.distortion)
        return (1 / np.sqrt(1 + (pixel_rays(camera) ** 2).sum(axis=0))).astype(np.float32)

    return lambda image: image * axis()


def _unknown_mode(usecase: str) -> list[str]:
    modes = [name for profile in shipped() for name in find_profile(profile).names]
    if usecase.strip().lower() in (name.lower() for name in modes):
        return []
    return [
        f'usecase: {shown(usecase)} is a mode of no shipped profile'
        f'{did_you_mean(usecase, modes)} (--profile checks it against that of your camera)'
    ]


def _where_known(reader: RecordingReader) -> np.ndarray:
    # (H, W) or (T, H, W) bool.
    if 'clean_depth' in reader.layouts:
        return np.array([np.isfinite(image) for image in reader.frames('clean_depth')])
    if 'clean_depth' in reader.arrays:
        return np.isfinite(reader.arrays['clean_depth'])
    raise InputError(f'--partial-truth: must come with clean_depth, which {reader.path} lacks')


def _read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    known = read_mask_png(path)
    if known.shape != size:
        raise InputError(
            f'{shown_path(path)}: must have the size of depth, {size[1]} x {size[0]}, got '
            f'{known.shape[1]} x {known.shape[0]}'
        )
    if not known.any():
        raise InputError(f'{shown_path(path)}: must have a pixel that is not black, got none')
    return known
