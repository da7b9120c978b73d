"""Write a recording with its ground truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

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
from flexx2_sim_ros.truth.observation import Footage, gray_images, has_gray, mask_of, Observation
from flexx2_sim_ros.truth.reflectivity import (
    gray_samples,
    GraySamples,
    GrayScale,
    with_reflectivity,
)
from flexx2_sim_ros.truth.run import GivenRecording
import numpy as np

_WRITTEN = {'clean_depth', 'incidence', 'depth', *KEYS}
_FEW = 0.01  # of the pixels may contradict the ground truth without a note
_LIT_FRAMES = 6  # of a moving recording: enough to learn what gray values mean


@dataclass(frozen=True)
class GroundTruth:
    """What a recording should show."""

    cleans: Sequence[Clean]  # one for each frame if the camera moved, else one
    image: Observation  # a frame, or the median, for the page
    accuracy: Mapping[str, np.ndarray]  # the keys of the recording that say how accurate it is
    number: int = 0  # of the frame for the page
    gray: np.ndarray | None = None  # (H, W) gray values to show in the place of depth
    found: Any = None  # what else is learnt of the recording


@dataclass(frozen=True)
class Surfaces:
    """What a recording shows of surfaces whose place is known: a room, a board or planes."""

    given: GivenRecording
    placed: Any  # what `Source.place` found; ``moving`` says whether the camera moved

    def at(self, footage: Footage, number: int) -> Clean | None:
        """Return what a frame should show, for its light; None where its pose is not known."""
        raise NotImplementedError

    def truth(self, footage: Footage) -> GroundTruth:
        """Return what the recording should show."""
        raise NotImplementedError


@dataclass(frozen=True)
class Written:
    """A recording that was written, and its (H, W) images for the page: of a frame or median."""

    image: np.ndarray  # float32: measured depth, or gray values
    edges: np.ndarray  # bool, where clean depth jumps
    residual: np.ndarray  # float32 metres, measured minus clean; NaN where unknown or invalid
    part: np.ndarray  # uint8 as in `Clean`
    shares: dict[str, float]  # the fraction of pixels of each of `PARTS`, over all frames
    notes: tuple[str, ...]  # what a person should know of pixels that contradict the ground truth
    found: Any  # as in `GroundTruth`

    def table(self) -> dict[str, Any]:
        """Return the shares of pixels for ``truth.yaml``: known, and unknown by reason."""
        left = {name: round(part, 4) for name, part in self.shares.items() if name != 'known'}
        return {'known': round(self.shares['known'], 4), 'unknown': left}


def write_recording(job: tuple[Surfaces, GrayScale | None]) -> Written:
    """
    Write a recording with `clean_depth` and its accuracy, whole or not at all.

    Its reflectivity follows from what gray values mean; None where they are not used.
    """
    (surfaces, scale), given, moving = job, job[0].given, job[0].placed.moving
    footage = given.footage(moving)
    reader, truth = footage.reader, surfaces.truth(footage)
    cleans = truth.cleans
    if scale is not None and _shows_light(reader, moving):
        cleans = [
            with_reflectivity(clean, gray, footage.still.rays, scale)
            for clean, gray in zip(cleans, gray_images(reader, moving), strict=True)
        ]
    keys = dict(truth.accuracy)
    if given.uptime is not None:
        keys['uptime'] = given.uptime
    part, arrays = _arrays(cleans, moving, mask_of(reader))
    with RecordingWriter(given.target, *reader.shape) as file:
        for image in reader.frames('depth'):
            file.add_depth(image[None])
        for key, value in {**arrays, **keys}.items():
            file.add_array(key, value)
        for key, value in _copied(reader, {*arrays, *keys}):
            if isinstance(value, np.ndarray):
                file.add_array(key, value)
            else:
                file.add_frames(key, reader.layouts[key].dtype, value)
    counts = np.bincount(part.ravel(), minlength=len(PARTS))
    return _written(truth, dict(zip(PARTS, (counts / part.size).tolist(), strict=True)))


def read_light(surfaces: Surfaces) -> list[GraySamples]:
    """Return what some frames show of the light of surfaces; nothing where that is not needed."""
    moving = surfaces.placed.moving
    footage = surfaces.given.footage(moving)
    reader = footage.reader
    if not _shows_light(reader, moving):
        return []
    every = max(len(reader.stamp) // _LIT_FRAMES, 1) if moving else 1
    out = []
    for number, gray in enumerate(gray_images(reader, moving)):
        clean = None if number % every else surfaces.at(footage, number)
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


def _copied(reader: RecordingReader, written: set[str]) -> Iterator[tuple[str, Any]]:
    # Everything else that the recording has, as arrays or as iterators over frames.
    left = _WRITTEN | written
    own = {'K': reader.K, 'stamp': reader.stamp, 'stamp_ns': reader.stamp_ns}
    yield from own.items()
    yield from ((key, one) for key, one in reader.arrays.items() if key not in left | own.keys())
    yield from ((key, reader.frames(key)) for key in reader.layouts if key not in left)
