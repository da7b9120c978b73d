"""Which pixel is nearest, where an image has holes."""

import numpy as np
import scipy  # its parts are imported on use


def nearest_pixels(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return where the nearest known pixel of each pixel is.

    Parameters
    ----------
    known : numpy.ndarray
        (H, W) bool, True somewhere.

    Returns
    -------
    tuple of numpy.ndarray
        Row and column, (H, W) int each: an index into images.

    """
    row, column = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    return row, column
