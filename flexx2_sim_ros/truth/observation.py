"""The images of a recording: the median of a still one, frames of a moving one; gray images."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from flexx2_sim_ros.camera import flexx2, Intrinsics, Mode, Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE
from flexx2_sim_ros.recording import RecordingReader
from flexx2_sim_ros.recording.truth import read_truth
from flexx2_sim_ros.truth.solver import blocks
import numpy as np
from scipy import ndimage

_MOST_FRAMES = 40  # of a still recording; more would not make the median better than the mesh
_NEAREST = 0.02  # metres
# A recording moves if more than this fraction of its blocks of pixels changes by more than this
# many metres (and sigmas of a pixel), from its first to its middle or last frames. Warm-up changes
# depth by less.
_MOVED_SHARE, _MOVED, _TILE_NOISE = 0.1, 0.02, 1.5
_TILE = 6
# An edge: the second difference of depth exceeds this fraction of depth and this many sigmas of
# noise, which is four sigmas of a second difference.
_BEND, _BEND_NOISE = 0.02, 10.0
_LONGEST_GAP = 1000.0  # seconds between two frames; more means two clocks
_SATURATED = 0.002  # fraction of pixels at the largest gray value


@dataclass(frozen=True)
class Observation:
    """One depth image to be registered."""

    # (H, W, 2) x/z and y/z of each pixel, without lens distortion; NaN where the lens has no
    # inverse, and where a mask marks pixels as unknown.
    rays: np.ndarray
    depth: np.ndarray  # (H, W) float64 metres along the optical axis, NaN where invalid
    sigma: np.ndarray  # (H, W) float64 metres, standard deviation of `depth`
    wraps: tuple[float, ...]  # metres: range is ambiguous by multiples of each, likely ones first

    @cached_property
    def smooth(self) -> np.ndarray:
        """Return (H, W) bool: valid, and on one surface with all eight neighbours."""
        # At a jump, depth bends more than noise and a steep surface explain.
        bend = np.zeros(self.depth.shape)
        with np.errstate(invalid='ignore'):
            for image, out in ((self.depth, bend), (self.depth.T, bend.T)):
                change = np.abs(image[2:] - 2 * image[1:-1] + image[:-2])
                out[1:-1] = np.fmax(out[1:-1], change)
            jumps = grow(bend > _BEND * self.depth + _BEND_NOISE * self.sigma)
        return np.isfinite(self.depth) & np.isfinite(self.rays[..., 0]) & ~jumps

    @cached_property
    def directions(self) -> np.ndarray:
        """Return (H, W, 3) points of the rays at a depth of one metre."""
        return np.concatenate([self.rays, np.ones((*self.rays.shape[:2], 1))], axis=-1)

    @cached_property
    def length(self) -> np.ndarray:
        """Return (H, W) length of a ray per metre of depth."""
        return np.sqrt(1 + (self.rays**2).sum(axis=-1))

    def mirrored(self) -> 'Observation':
        """Return the view of a camera in the mirror image of the room."""
        return replace(self, rays=self.rays * (-1, 1))


def grow(mask: np.ndarray, times: int = 1) -> np.ndarray:
    """Return an (H, W) bool mask, grown by this number of pixels."""
    return np.asarray(ndimage.binary_dilation(mask, np.ones((3, 3), bool), times))


@dataclass(frozen=True)
class Footage:
    """A recording as registration needs it."""

    reader: RecordingReader
    still: Observation  # the median of a still recording, the first frame of a moving one
    moving: bool
    mode: Mode | None  # None where the file does not say, or names one that the profile lacks

    def frames(self) -> Iterator[np.ndarray]:
        """Yield the (H, W) depth of each frame, NaN where a mask of this frame hides it."""
        return _shown(self.reader)

    def observe(self, depth: np.ndarray) -> Observation:
        """Return the observation of one (H, W) frame."""
        good = np.where(depth > _NEAREST, depth, np.nan).astype(np.float64)
        return replace(self.still, depth=good, sigma=_typical_sigma(good, self.mode))

    def images(self) -> Iterator[Observation]:
        """Return each frame of a moving recording, the one image of a still one."""
        return map(self.observe, self.frames()) if self.moving else iter([self.still])


def observe(reader: RecordingReader, profile: Profile | None, motion: str = 'auto') -> Footage:
    """Prepare a recording for registration; motion is ``still``, ``moving`` or ``auto``."""
    _check_stamps(reader)
    rays = _rays(reader)
    mode = _mode(reader, profile or flexx2())
    frames, hidden = _chosen_frames(reader)
    if not np.isfinite(frames).any():
        raise InputError(f'{reader.path}: depth: all pixels of all frames are invalid')
    moving = motion == 'moving' or (motion == 'auto' and _moved(frames, mode))
    if moving:
        depth, sigma = frames[0], _typical_sigma(frames[0], mode)
    else:
        depth, sigma = _median(frames, hidden, mode)
    still = Observation(rays, depth, sigma, _wraps(mode))
    return Footage(reader, still, moving, mode)


def _check_stamps(reader: RecordingReader) -> None:
    steps = np.diff(reader.stamp_ns) / 1e9
    if len(steps) and np.abs(steps).max() > _LONGEST_GAP:
        raise InputError(
            f'{reader.path}: stamp: must be of one clock, got a jump of '
            f'{steps[np.abs(steps).argmax()]:+.6g} s between two frames'
        )
    if (steps <= 0).any():
        raise InputError(f'{reader.path}: stamp: must rise from frame to frame')


def _rays(reader: RecordingReader) -> np.ndarray:
    height, width = reader.shape[1:]
    try:
        camera = Intrinsics.from_matrix(reader.K, width, height, reader.distortion)
    except InputError as error:
        raise InputError(f'{reader.path}: {error}') from error
    rays = np.moveaxis(pixel_rays(camera), 0, -1)
    mask = mask_of(reader)
    if mask is not None:
        rays[~mask if mask.ndim == 2 else ~mask.any(axis=0)] = np.nan
    return rays


def mask_of(reader: RecordingReader) -> np.ndarray | None:
    """Return the user's mask, ``known``, (H, W) or (T, H, W) bool; None without, or with truth."""
    if 'clean_depth' in reader.layouts or 'clean_depth' in reader.arrays:
        return None
    return read_truth(reader.path, reader.arrays, reader.shape).known


def _shown(reader: RecordingReader) -> Iterator[np.ndarray]:
    mask = mask_of(reader)
    for number, image in enumerate(reader.frames('depth')):
        if mask is None or mask.ndim == 2:
            yield image
        else:
            yield np.where(mask[number], image, np.nan)


def _mode(reader: RecordingReader, profile: Profile) -> Mode | None:
    try:
        return profile.mode(reader.usecase) if reader.usecase else None
    except InputError:
        return None


def _wraps(mode: Mode | None) -> tuple[float, ...]:
    # The range at which all frequencies repeat, then those of each: a wrong choice of the whole
    # number of wraps at one frequency leaves a multiple of that frequency's.
    if mode is None or not mode.modulation_hz:
        return ()
    single = [SPEED_OF_LIGHT / (2 * frequency) for frequency in mode.modulation_hz]
    common = SPEED_OF_LIGHT / (2 * float(np.gcd.reduce(np.array(mode.modulation_hz, np.int64))))
    return tuple(dict.fromkeys([common, *single]))


def _chosen_frames(reader: RecordingReader) -> tuple[np.ndarray, np.ndarray]:
    # Also, in how many of them a mask hides a pixel: (H, W), or () for none.
    count = len(reader.stamp)
    wanted = np.unique(np.linspace(0, count - 1, min(count, _MOST_FRAMES)).round().astype(int))
    chosen = set(wanted.tolist())
    out = np.array([one for i, one in enumerate(_shown(reader)) if i in chosen], np.float64)
    mask = mask_of(reader)
    hidden = np.array(0) if mask is None or mask.ndim == 2 else (~mask[wanted]).sum(axis=0)
    with np.errstate(invalid='ignore'):
        return np.where((out > _NEAREST) & np.isfinite(out), out, np.nan), hidden


def _moved(frames: np.ndarray, mode: Mode | None) -> bool:
    few = max(len(frames) // 8, 1)
    if len(frames) < 2:
        return False
    middle = len(frames) // 2
    parts = frames[:few], frames[middle : middle + few], frames[-few:]
    first, *others = (np.median(part, axis=0) for part in parts)
    noise = _tiles(_typical_sigma(first, mode)) * _TILE_NOISE
    shares = []
    for other in others:
        change = np.abs(_tiles(other - first))
        good = np.isfinite(change + noise)
        shares.append((change > _MOVED + noise)[good].mean() if good.any() else 0.0)
    return bool(max(shares) > _MOVED_SHARE)


def _tiles(image: np.ndarray) -> np.ndarray:
    # Medians of blocks have less noise than pixels; NaN where most of a block is invalid.
    return np.median(blocks(image, _TILE), axis=1) if min(image.shape) >= _TILE else image


def _median(
    frames: np.ndarray, hidden: np.ndarray, mode: Mode | None
) -> tuple[np.ndarray, np.ndarray]:
    # Sorted with NaN last: quantiles of the valid ones, without the cost of nanquantile.
    ordered = np.sort(frames, axis=0)
    valid = np.isfinite(ordered).sum(axis=0)

    def take(share: float) -> np.ndarray:
        place = np.maximum(share * (valid - 1), 0)
        low, high = (
            np.take_along_axis(ordered, index.astype(int)[None], axis=0)[0]
            for index in (np.floor(place), np.ceil(place))
        )
        return low + (place - np.floor(place)) * (high - low)

    median = np.where(valid > (len(frames) - hidden) // 2, take(0.5), np.nan)
    spread = (take(0.84) - take(0.16)) / 2
    if len(frames) < 8:
        return median, _typical_sigma(median, mode)
    return median, np.maximum(spread, 1e-4) * 1.25 / np.sqrt(np.maximum(valid, 1))


def _typical_sigma(depth: np.ndarray, mode: Mode | None) -> np.ndarray:
    noise = (mode or flexx2().mode(DEFAULT_USECASE)).noise
    return np.maximum(noise.sigma_z(depth, 0.0), 1e-4)


def has_gray(reader: RecordingReader, moving: bool = False) -> bool:
    """Return whether a recording has a gray image; if it moves, whether each frame has one."""
    images = reader.arrays.get('amplitude')
    one = images is not None and (images.ndim == 3 or not moving)
    return one or 'amplitude' in reader.layouts


def gray_images(reader: RecordingReader, moving: bool) -> Iterator[np.ndarray]:
    """
    Iterate over gray images: the mean of a still recording, or all of a moving one.

    They are (H, W) float64, NaN where saturated, not a number or hidden by a mask.
    """
    if moving:
        yield from (_unsaturated(image, image) for image in _gray_shown(reader))
        return
    total = top = None
    count: Any = 0
    for image in _gray_shown(reader):
        # A bag lacks the images of some frames: they are black.
        there = ~np.isnan(image) & bool(np.nan_to_num(image).any())
        total = np.where(there, image, 0) + (0 if total is None else total)
        top = image if top is None else np.fmax(top, image)
        count = count + there
    if total is None or top is None:
        raise InputError(f'{reader.path}: amplitude: must have an image, got none')
    with np.errstate(invalid='ignore'):
        yield _unsaturated(total / count, top)


def _gray_shown(reader: RecordingReader) -> Iterator[np.ndarray]:
    # NaN where a mask of this frame hides the room; of one image for all, where it does in any.
    images: Any = reader.arrays.get('amplitude')
    mask = mask_of(reader)
    if images is None:
        images = reader.frames('amplitude')
    elif images.ndim == 2:
        images = [images]
        mask = mask if mask is None or mask.ndim == 2 else np.asarray(mask.all(axis=0))
    for number, image in enumerate(images):
        image = image.astype(np.float64)
        if mask is not None:
            image[~(mask if mask.ndim == 2 else mask[number])] = np.nan
        yield image


def _unsaturated(image: np.ndarray, brightest: np.ndarray) -> np.ndarray:
    # Many pixels have the largest value of the image.
    with np.errstate(invalid='ignore'):
        full = brightest >= np.nanmax(brightest, initial=0)
    return np.where((full & (full.mean() > _SATURATED)) | ~np.isfinite(image), np.nan, image)
