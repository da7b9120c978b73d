"""The gray images of a recording."""

from collections.abc import Iterator
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import RecordingReader
import numpy as np

_SATURATED = 0.002  # fraction of pixels at the largest gray value


def has_gray(reader: RecordingReader) -> bool:
    """Return whether a recording has gray images."""
    return 'amplitude' in reader.layouts or 'amplitude' in reader.arrays


def has_gray_frames(reader: RecordingReader) -> bool:
    """Return whether a recording has a gray image for each frame."""
    return 'amplitude' in reader.layouts or (
        'amplitude' in reader.arrays and reader.arrays['amplitude'].ndim == 3
    )


def gray_images(reader: RecordingReader, moving: bool) -> Iterator[np.ndarray]:
    """
    Iterate over gray images: the mean of a still recording, or all of a moving one.

    Yields
    ------
    numpy.ndarray
        (H, W) float64, NaN where saturated or not a number.

    """
    images: Any = reader.arrays.get('amplitude')
    if images is None:
        images = reader.frames('amplitude')
    elif images.ndim == 2:
        images = [images]
    if moving:
        for image in images:
            yield _unsaturated(image.astype(np.float64), image)
        return
    total = top = None
    count = 0
    for image in images:
        image = image.astype(np.float64)
        total = image if total is None else total + image
        top = image if top is None else np.maximum(top, image)
        count += 1
    if total is None or top is None:
        raise InputError(f'{reader.path}: amplitude: must have an image, got none')
    yield _unsaturated(total / count, top)


def _unsaturated(image: np.ndarray, brightest: np.ndarray) -> np.ndarray:
    # Many pixels have the largest value of the image.
    with np.errstate(invalid='ignore'):
        full = brightest >= np.nanmax(brightest, initial=0)
    return np.where((full & (full.mean() > _SATURATED)) | ~np.isfinite(image), np.nan, image)
