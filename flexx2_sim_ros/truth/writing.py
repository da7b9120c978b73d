"""Write a recording with its ground truth."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.recording import open_recording, RecordingReader, RecordingWriter
from flexx2_sim_ros.recording.truth import KEYS
from flexx2_sim_ros.truth.clean import (
    apart,
    Clean,
    difference,
    edges,
    HIDDEN,
    KNOWN,
    PARTS,
    REFUSED,
)
from flexx2_sim_ros.truth.gray_frames import gray_images, has_gray, has_gray_frames
from flexx2_sim_ros.truth.observation import Footage, mask_of, Observation, observe
from flexx2_sim_ros.truth.reflectivity import (
    gray_samples,
    GraySamples,
    GrayScale,
    with_reflectivity,
)
import numpy as np

_WRITTEN = {'clean_depth', 'incidence', 'depth', *KEYS}
_FEW = 0.01  # of the pixels may contradict the ground truth without a note
_LIT_FRAMES = 6  # of a moving recording: enough to learn what gray values mean


class Surfaces(Protocol):
    """What a recording shows of surfaces whose place is known: a room, a board or planes."""

    @property
    def moving(self) -> bool:
        """Return whether the camera moved."""

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return what a frame should show, for its light; None where its pose is not known."""

    def truths(self, footage: Footage) -> list[Clean]:
        """Return ground truth: one for each frame if the camera moved, else one."""

    def accuracy(self, footage: Footage, truths: Sequence[Clean]) -> dict[str, np.ndarray]:
        """Return the keys that say how accurate it is."""

    def shown(
        self, footage: Footage, truths: Sequence[Clean], shares: dict[str, float]
    ) -> tuple['PageImages', Any]:
        """Return images for the page, and what else is learnt of the recording."""


@dataclass(frozen=True)
class Writing:
    """
    A recording to write, and its ground truth.

    Attributes
    ----------
    path : pathlib.Path
    camera : str or None
        Which camera of a bag that has several.
    profile : Profile or None
    surfaces : Surfaces
    target : pathlib.Path
        The file to write.
    keys : mapping of str to numpy.ndarray
        Further keys to write.
    scale : GrayScale or None
        What gray values mean; None where they are not used.

    """

    path: Path
    camera: str | None
    profile: Profile | None
    surfaces: Surfaces
    target: Path
    keys: Mapping[str, np.ndarray]
    scale: GrayScale | None = None

    def opened(self) -> tuple[RecordingReader, Footage]:
        """Return the recording, open."""
        reader = open_recording(self.path, self.camera, self.profile)
        motion = 'moving' if self.surfaces.moving else 'still'
        return reader, observe(reader, self.profile, motion)


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


def write_recording(what: Writing) -> tuple[PageImages, Any]:
    """
    Write a recording with `clean_depth` and its accuracy, whole or not at all.

    Returns
    -------
    tuple
        As `Surfaces.shown`.

    Raises
    ------
    InputError
        When the recording cannot be read or the file cannot be written.

    """
    reader, footage = what.opened()
    surfaces = what.surfaces
    truths = surfaces.truths(footage)
    if what.scale is not None and shows_light(reader, surfaces.moving):
        truths = [
            with_reflectivity(truth, gray, footage.still.rays, what.scale)
            for truth, gray in zip(truths, gray_images(reader, surfaces.moving), strict=True)
        ]
    keys = {**surfaces.accuracy(footage, truths), **what.keys}
    shares = write_truth(reader, what.target, truths, surfaces.moving, keys)
    return surfaces.shown(footage, truths, shares)


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
    reader, footage = what.opened()
    moving = what.surfaces.moving
    if not shows_light(reader, moving):
        return []
    every = max(len(reader.stamp) // _LIT_FRAMES, 1) if moving else 1
    out = []
    for number, gray in enumerate(gray_images(reader, moving)):
        clean = None if number % every else what.surfaces.at(footage, number)
        if clean is None:
            continue
        if clean.reflectivity is not None:
            return []
        out.append(gray_samples(gray, clean, footage.still.rays))
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
