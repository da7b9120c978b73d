"""What a camera is apart from its modes and lens: thresholds, scales, and how it works."""

from dataclasses import dataclass
from functools import lru_cache

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.valid_mask import ValidMask
import numpy as np

# How a camera measures depth, and what people call it.
KINDS = {
    'tof': 'time-of-flight camera',
    'stereo': 'stereo camera',
    'structured_light': 'structured-light camera',
}
MOST_CORNERS = 64


@dataclass(frozen=True)
class Sensor:
    """
    What all modes of a camera have in common; ``docs/model.md`` explains every number.

    The defaults are those of the Flexx2 (``config/flexx2.yaml``). They hold for a profile that
    does not give the field.

    Attributes
    ----------
    kind : str
        How it measures depth, out of `KINDS`.
    jump_share, steep_share : float
        When neighbours belong to different surfaces, as fractions of the distance.
    neighbourhood_px : int
        Edges no further apart move together.
    zero_at_sigma_m : float
        sigma_z at which confidence is 0, metres.
    full_scale_amplitude : float
        Amplitude of a white gray pixel, 1/m^2.
    readout_us : float
        Time to read one raw frame out, microseconds.
    valid_region : tuple of (float, float)
        Corners of the polygon outside of which the camera gives no depth, as slopes of rays
        (X/Z, Y/Z); empty where the whole image is valid. Slopes hold for any resolution and crop.
    valid_mask : ValidMask or None
        Pixels that may have depth, for patterns that are no polygon; both must allow a pixel.

    """

    kind: str = 'tof'
    jump_share: float = 0.01
    steep_share: float = 0.25
    neighbourhood_px: int = 8
    zero_at_sigma_m: float = 0.07
    full_scale_amplitude: float = 4.0
    readout_us: float = 600.0
    valid_region: tuple[tuple[float, float], ...] = ()
    valid_mask: ValidMask | None = None

    def outside(self, camera: Intrinsics) -> np.ndarray | None:
        """
        Return the pixels of the camera's image that never have depth, (H, W) bool.

        It is not to be changed; None where every pixel may have depth. Distortion is not used.
        """
        if not self.valid_region and self.valid_mask is None:
            return None
        return _outside(self.valid_region, self.valid_mask, camera)


DEFAULT_SENSOR = Sensor()


@lru_cache(maxsize=8)
def _outside(
    corners: tuple[tuple[float, float], ...], mask: ValidMask | None, camera: Intrinsics
) -> np.ndarray:
    outside = np.zeros((camera.height, camera.width), bool)
    if corners:
        outside |= _outside_polygon(corners, camera)
    if mask is not None:
        outside |= mask.outside(camera)
    outside.flags.writeable = False
    return outside


def _outside_polygon(corners: tuple[tuple[float, float], ...], camera: Intrinsics) -> np.ndarray:
    # A line from a pixel to the right crosses the polygon's sides an even number of times exactly
    # if the pixel lies outside.
    y, x = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    x, y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    outside = np.ones(x.shape, bool)
    for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True):
        if y0 != y1:
            crosses = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
            outside ^= crosses
    return outside
