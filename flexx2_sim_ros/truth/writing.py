"""Write a recording with its ground truth."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from flexx2_sim_ros.recording import RecordingReader, RecordingWriter
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
from flexx2_sim_ros.truth.files import TruthSource
from flexx2_sim_ros.truth.observation import Footage, gray_images, has_gray, mask_of, Observation
from flexx2_sim_ros.truth.reflectivity import (
    gray_samples,
    GraySamples,
    GrayScale,
    with_reflectivity,
)
from flexx2_sim_ros.truth.requests import Placing, TruthRequest
import numpy as np

_WRITTEN = {'clean_depth', 'incidence', 'depth', *KEYS}
_FEW = 0.01  # of the pixels may contradict the ground truth without a note
_LIT_FRAMES = 6  # of a moving recording: enough to learn what gray values mean


@dataclass(frozen=True)
class GroundTruth:
    """
    What a recording should show.

    * `cleans`: one for each frame if the camera moved, else one.
    * `image`: a frame, or the median, for the page.
    * `accuracy`: the keys of the recording that say how accurate it is.
    * `number`: of the frame for the page.
    * `gray`: (H, W) gray values to show in the place of depth.
    * `found`: what else is learnt of the recording.
    """

    cleans: Sequence[Clean]
    image: Observation
    accuracy: Mapping[str, np.ndarray] = field(default_factory=dict)
    number: int = 0
    gray: np.ndarray | None = None
    found: Any = None


class Surfaces(Protocol):
    """What a recording shows of surfaces whose place is known: a room, a board or planes."""

    @property
    def moving(self) -> bool:
        """Return whether the camera moved."""

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return what a frame should show, for its light; None where its pose is not known."""

    def truth(self, footage: Footage) -> GroundTruth:
        """Return what the recording should show."""


@dataclass(frozen=True)
class Writing:
    """
    A recording to write, and its ground truth.

    `scale` is what gray values mean; None where they are not used.
    """

    request: TruthRequest
    source: TruthSource
    surfaces: Surfaces
    scale: GrayScale | None = None

    def footage(self) -> Footage:
        """Return the recording, open."""
        return Placing(self.source.path, self.request).footage(self.surfaces.moving)


@dataclass(frozen=True)
class Written:
    """
    A recording that was written, and its images for the page: of its first frame or median.

    * `image`: (H, W) float32: measured depth, or gray values.
    * `edges`: (H, W) bool, where clean depth jumps.
    * `residual`: (H, W) float32 metres, measured minus clean; NaN where unknown or invalid.
    * `part`: (H, W) uint8 as in `Clean`.
    * `shares`: the fraction of pixels of each of `PARTS`, over all frames.
    * `notes`: what a person should know of pixels that contradict the ground truth.
    * `found`: as in `GroundTruth`.
    """

    image: np.ndarray
    edges: np.ndarray
    residual: np.ndarray
    part: np.ndarray
    shares: dict[str, float]
    notes: tuple[str, ...]
    found: Any

    def table(self) -> dict[str, Any]:
        """Return the shares of pixels for ``truth.yaml``: known, and unknown by reason."""
        left = {name: round(part, 4) for name, part in self.shares.items() if name != 'known'}
        return {'known': round(self.shares['known'], 4), 'unknown': left}


def write_recording(what: Writing) -> Written:
    """Write a recording with `clean_depth` and its accuracy, whole or not at all."""
    footage, moving = what.footage(), what.surfaces.moving
    reader, truth = footage.reader, what.surfaces.truth(footage)
    cleans = truth.cleans
    if what.scale is not None and _shows_light(reader, moving):
        cleans = [
            with_reflectivity(clean, gray, footage.still.rays, what.scale)
            for clean, gray in zip(cleans, gray_images(reader, moving), strict=True)
        ]
    uptime = {} if what.source.uptime is None else {'uptime': what.source.uptime}
    keys = {**truth.accuracy, **uptime}
    shares = write_truth(reader, what.source.target, cleans, moving, keys)
    return _written(truth, shares)


def read_light(what: Writing) -> list[GraySamples]:
    """
    Return what a recording shows of the light that surfaces send back, of some frames.

    Empty where its reflectivity is known from the mesh or the recording, and where it has no gray
    images. Raises `InputError` when the recording cannot be read.
    """
    footage, moving = what.footage(), what.surfaces.moving
    reader = footage.reader
    if not _shows_light(reader, moving):
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


def _shows_light(reader: RecordingReader, moving: bool) -> bool:
    # Whether the reflectivity of a recording is to be taken from its gray images.
    known = 'reflectivity' in reader.layouts or 'reflectivity' in reader.arrays
    return not known and has_gray(reader, moving)


def write_truth(
    reader: RecordingReader,
    target: Path,
    truths: Sequence[Clean],
    moving: bool,
    keys: Mapping[str, np.ndarray],
) -> dict[str, float]:
    """Write a recording with a `Clean`, or one a frame; return `Written.shares`."""
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


def _written(truth: GroundTruth, shares: dict[str, float]) -> Written:
    clean, image = truth.cleans[truth.number], truth.image
    error = difference(clean, image)
    residual = np.where(clean.known, error, np.nan).astype(np.float32)
    few = _FEW * clean.known.size
    farther, hidden = (apart(clean, image) > 0).sum(), (clean.part == HIDDEN).sum()
    notes = []
    if farther > few:
        notes.append(
            f'{farther} pixels are farther than the ground truth, and stay known: an error of '
            'the camera, or a thing that is not there any more'
        )
    if hidden > few:
        notes.append(f'{hidden} pixels show something nearer that the ground truth has not')
    shown = image.depth if truth.gray is None else truth.gray
    return Written(
        shown.astype(np.float32),
        edges(clean),
        residual,
        clean.part,
        shares,
        tuple(notes),
        truth.found,
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
