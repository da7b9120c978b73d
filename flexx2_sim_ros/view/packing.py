"""
Frames as bytes for the page.

A message has the length of its head (uint32), the head (JSON, padded with spaces to a multiple of
four bytes), and the images of a `ViewedFrame` that there are, in its order (uint16, row by row).
All numbers are little-endian. Its colour tables are here, too.
"""

from dataclasses import dataclass
import json

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
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


# Metres. 0 is invalid; distances that exceed 16 bits are clipped.
UNIT = 0.00025
_FARTHEST = 65535


@dataclass(frozen=True)
class ViewedFrame:
    """
    A frame of one camera.

    Attributes
    ----------
    sequence : int
        Number of the frame.
    stamp : int
        Nanoseconds.
    simulated : numpy.ndarray
        (H, W) float32 metres; NaN, infinite, 0 and less are invalid.
    clean : numpy.ndarray or None
        The same for the clean depth that it was simulated from.
    intrinsics : Intrinsics
        Of all images.
    without : numpy.ndarray or None
        The same as `clean` without the effects of a diagnosis, where `clean` is with them.

    """

    sequence: int
    stamp: int
    simulated: np.ndarray
    clean: np.ndarray | None
    intrinsics: Intrinsics
    without: np.ndarray | None = None

    @property
    def invalid_fraction(self) -> float:
        """Return the fraction of simulated pixels that are invalid."""
        return float(1.0 - np.mean(_is_valid(self.simulated)))


def pack_depth(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) float32 metres as little-endian uint16 of `UNIT`, 0 where invalid."""
    with np.errstate(invalid='ignore', over='ignore'):
        steps = np.rint(depth * np.float32(1 / UNIT))
        # A valid pixel is never 0.
        steps = np.clip(steps, 1, _FARTHEST)
        return np.where(_is_valid(depth), steps, 0).astype('<u2')


def _is_valid(depth: np.ndarray) -> np.ndarray:
    return (depth > 0) & (depth < np.inf)


def pack(name: str, shot: ViewedFrame) -> bytes:
    """Return a camera's frame as a message."""
    camera = shot.intrinsics
    head = json.dumps(
        {
            'camera': name,
            'stamp': shot.stamp / 1e9,
            'unit': UNIT,
            'width': camera.width,
            'height': camera.height,
            'fx': camera.fx,
            'fy': camera.fy,
            'cx': camera.cx,
            'cy': camera.cy,
            'distortion': camera.distortion,
            'clean': shot.clean is not None,
            'without': shot.without is not None,
        }
    ).encode()
    head += b' ' * (-len(head) % 4)
    images = [one for one in (shot.simulated, shot.clean, shot.without) if one is not None]
    return b''.join(
        [len(head).to_bytes(4, 'little'), head, *(pack_depth(image).tobytes() for image in images)]
    )
