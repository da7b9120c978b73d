"""The gray images of a recording."""

from collections.abc import Iterator
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import RecordingReader
from flexx2_sim_ros.truth.observation import mask_of
import numpy as np

_SATURATED = 0.002  # fraction of pixels at the largest gray value


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
        for image in _shown(reader):
            yield _unsaturated(image, image)
        return
    total = top = None
    count: Any = 0
    for image in _shown(reader):
        # A bag lacks the images of some frames: they are black.
        there = ~np.isnan(image) & bool(np.nan_to_num(image).any())
        total = np.where(there, image, 0) + (0 if total is None else total)
        top = image if top is None else np.fmax(top, image)
        count = count + there
    if total is None or top is None:
        raise InputError(f'{reader.path}: amplitude: must have an image, got none')
    with np.errstate(invalid='ignore'):
        yield _unsaturated(total / count, top)


def _shown(reader: RecordingReader) -> Iterator[np.ndarray]:
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
