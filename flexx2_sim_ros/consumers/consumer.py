"""What a consumer of depth is, and what it gets: depth images, the lens, and where they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from flexx2_sim_ros.formulas import on_images, surfaces
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode
import numpy as np

_model_sigma = on_images(surfaces.model_sigma)
_STRAIGHT_ON = np.float32(1.0)  # cosine of incidence


@dataclass(frozen=True)
class CameraView:
    """
    Depth images from one pose of the camera.

    The ground frame has x ahead, y left and z up; its origin is on the ground below the camera.

    Attributes
    ----------
    depth : numpy.ndarray
        (T, H, W) float32, metres along the optical axis, NaN where invalid.
    lens : Intrinsics
        Of the images.
    mode : Mode
        Of the camera, for its noise.
    rotation : numpy.ndarray
        (3, 3) from the optical frame (x right, y down, z ahead) to the ground frame.
    position : numpy.ndarray
        (3,) of the camera in the ground frame, metres.
    centre : float or None
        How far ahead the robot is that looks at the ground: the window of the height grid that
        shows most ground, metres. None where less than half of any window is seen.

    """

    depth: np.ndarray
    lens: Intrinsics
    mode: Mode
    rotation: np.ndarray
    position: np.ndarray
    centre: float | None

    def directions(self) -> np.ndarray:
        """
        Return (H, W, 3) from the camera to the points at depth 1 m, ground frame, metres.

        NaN where the distortion of the lens cannot be inverted. Frames of one pose share the
        array, so it is read-only.
        """
        return _directions(self.lens, tuple(map(tuple, self.rotation.tolist())))

    def points(self, frame: int) -> np.ndarray:
        """Return (N, 3) float64 points of the valid pixels of a frame, ground frame, metres."""
        depth = self.depth[frame]
        good = self.valid(frame)
        return np.asarray(self.position + self.directions()[good] * depth[good][:, None])

    def valid(self, frame: int) -> np.ndarray:
        """Return (H, W) bool: the pixels of a frame that have depth and a ray."""
        return np.asarray(np.isfinite(self.depth[frame]) & np.isfinite(self.directions()[..., 0]))

    def sigma(self, depth: np.ndarray) -> np.ndarray:
        """
        Return the standard deviation of depth that the camera's noise model gives, metres.

        A consumer does not know the true surface: incidence is taken to be straight on.
        """
        noise = self.mode.noise
        values = (noise.a, noise.b, noise.c, noise.d, noise.n, noise.incidence_cap)
        return np.asarray(_model_sigma(depth, _STRAIGHT_ON, *map(np.float32, values)))


@lru_cache(maxsize=8)  # All renditions and frames of a recording have the same few poses.
def _directions(lens: Intrinsics, rotation: tuple[tuple[float, ...], ...]) -> np.ndarray:
    across, down = pixel_rays(lens)
    rays = np.stack([across, down, np.ones_like(across)], axis=-1) @ np.array(rotation).T
    rays.flags.writeable = False
    return rays


class Consumer(Protocol):
    """
    Something on a robot that reads depth.

    Its class is called without arguments, once in a process of its own.

    Attributes
    ----------
    name : str
        Identifier in lower case.
    measures : mapping of str to str
        Names of its errors, and their units (empty for a plain number). 0 is perfect.

    """

    name: str
    measures: Mapping[str, str]

    def look(self, view: CameraView) -> Any:
        """Return what the consumer makes of depth images: a grid, a map, a distance."""

    def errors(self, seen: Any, true: Any) -> Mapping[str, float]:
        """
        Return the errors of what was made of depth images.

        Parameters
        ----------
        seen, true
            What `look` returned for the images, and for the true depth of the scene.

        Returns
        -------
        mapping of str to float
            A finite number for each measure. Leave out what the scene does not show.

        """
