"""Colour tables for the page."""

import numpy as np

INVALID = (62, 66, 74)
# Light at both ends and dark at zero. Blue and orange are safe for colour-blind users.
_DIFFERENCE = ((163, 216, 255), (38, 122, 214), (17, 19, 23), (222, 112, 20), (255, 219, 138))


def depth_table() -> np.ndarray:
    """Return viridis, near to far: (256, 3) uint8, sRGB; safe for colour-blind users."""
    # Imported here: it takes half a second, which only the page needs.
    import matplotlib

    colours = matplotlib.colormaps['viridis'](np.arange(256))
    return np.rint(255 * np.asarray(colours)[:, :3]).astype(np.uint8)


def difference_table() -> np.ndarray:
    """Return blue (nearer) over dark to orange (farther): (256, 3) uint8, sRGB; 128 is zero."""
    knots = np.linspace(0, 256, len(_DIFFERENCE))
    channels = [
        np.interp(np.arange(256), knots, values) for values in zip(*_DIFFERENCE, strict=True)
    ]
    return np.rint(np.stack(channels, axis=1)).astype(np.uint8)
