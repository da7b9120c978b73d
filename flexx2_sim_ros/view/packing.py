"""
Frames as bytes for the page.

A message has the length of its head (uint32), the head (JSON, padded with spaces to a multiple of
four bytes), the simulated depth and, if there is one, the clean depth (uint16, row by row). All
numbers are little-endian.
"""

from dataclasses import dataclass
import json

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

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
        Of both images.

    """

    sequence: int
    stamp: int
    simulated: np.ndarray
    clean: np.ndarray | None
    intrinsics: Intrinsics

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
        }
    ).encode()
    head += b' ' * (-len(head) % 4)
    images = [shot.simulated] + ([] if shot.clean is None else [shot.clean])
    return b''.join(
        [len(head).to_bytes(4, 'little'), head, *(pack_depth(image).tobytes() for image in images)]
    )
