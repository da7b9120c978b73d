"""Which pixel is nearest, where an image has holes."""

import numpy as np
import scipy  # its parts are imported on use


def nearest_pixels(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return row and column, (H, W) int each, of the nearest known pixel: an index into images.

    ``known`` is (H, W) bool, True somewhere.
    """
    row, column = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    return row, column
