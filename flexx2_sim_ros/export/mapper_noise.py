"""Noise, bias and lost pixels of a mode against distance: from its model, or by simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode, Profile
import numpy as np

DISTANCES = 12  # over the mode's range
ANGLES = (0.0, 30.0, 60.0)  # degrees, within the angles of the paper
FRAMES = 16  # of each wall
_SETTLING = 4  # frames before them, for effects with a memory
_BLOCK = (16, 24)  # pixels in the middle of the image that are measured
_FEWEST = 0.5  # of a block's pixels must be valid for a sigma
_CLEAR = 4.0  # sigma_z between the walls and the ends of the range
_GROSS = 0.1, 5.0  # of the distance, and sigma_z of the model: an error beyond both is gross


@dataclass(frozen=True)
class MapperNoise:
    """
    What a camera's depth is like, as far as a mapper can take it.

    Attributes
    ----------
    profile : Profile
    mode : Mode
    effects : tuple of str
        Names of the effects that are in it.
    angles : tuple of float
        Incidence angles, degrees.
    distance : numpy.ndarray
        (N,) metres.
    sigma : numpy.ndarray
        (N, A) standard deviation of depth at each distance and angle, metres. Over pixels and
        frames, so that a fixed pattern is part of it. NaN where most pixels are lost.
    bias : numpy.ndarray
        (N, A) mean error of depth, metres.
    lost : numpy.ndarray
        (N, A) fraction of pixels that are invalid or grossly wrong: by over a tenth of the
        distance and over 5 sigma_z. They are not part of sigma and bias.
    age : float
        Seconds from the exposure to the arrival of an image, by `time_offset`.

    """

    profile: Profile
    mode: Mode
    effects: tuple[str, ...]
    angles: tuple[float, ...]
    distance: np.ndarray
    sigma: np.ndarray
    bias: np.ndarray
    lost: np.ndarray
    age: float

    @property
    def typical(self) -> np.ndarray:
        """Return the root mean square of sigma over the angles, (N,) metres; may have NaN."""
        seen = np.isfinite(self.sigma)
        squares = np.where(seen, self.sigma, 0.0) ** 2
        with np.errstate(invalid='ignore'):
            typical: np.ndarray = np.sqrt(squares.sum(axis=1) / seen.sum(axis=1))
        return typical

    @property
    def mean_bias(self) -> float:
        """Return the mean error over distances and angles, metres."""
        return float(np.nanmean(self.bias))

    @property
    def lateral(self) -> float:
        """Return sigma_x per metre of distance."""
        return float(self.mode.noise.sigma_x / self.profile.intrinsics.fx)


def measure_noise(
    profile: Profile,
    usecase: str,
    effects: Sequence[Effect] = (),
    *,
    angles: Sequence[float] = ANGLES,
    distances: tuple[float, float] | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> MapperNoise:
    """
    Return the noise of a mode, with effects.

    Without effects it is the noise model itself. With effects white walls are simulated, and the
    middle of the image is compared with the exact depth.

    Parameters
    ----------
    profile : Profile
        The camera.
    usecase : str
        A mode of the profile.
    effects : sequence of Effect
        What the camera does beyond the noise model.
    angles : sequence of float
        Incidence angles, degrees.
    distances : (float, float), optional
        Nearest and farthest distance, metres; the range of the mode when left out.
    progress : callable
        Called with the fraction that is done.

    Raises
    ------
    InputError
        When there is no such mode, the mode does not have the distances, or the camera loses most
        pixels at all of them.

    """
    mode = profile.mode(usecase)
    distance = _distances(mode, max(angles), distances)
    shape = len(distance), len(angles)
    bias, lost = np.zeros(shape), np.zeros(shape)
    if not effects:
        sigma = mode.noise.sigma_z(distance[:, None], np.radians(angles)[None])
    else:
        sigma = np.empty(shape)
        camera = Camera(mode.name, profile=profile, effects=tuple(effects))
        for index in np.ndindex(shape):
            i, j = index
            sigma[index], bias[index], lost[index] = _wall(camera, float(distance[i]), angles[j])
            progress((i * shape[1] + j + 1) / sigma.size)
    if not np.isfinite(sigma).any():
        raise InputError(
            f'effects: must leave depth on a white wall, got {np.min(lost):.0%} to '
            f'{np.max(lost):.0%} invalid pixels in {mode.name}'
        )
    names = tuple(effect.name for effect in effects if effect.strength)
    offset = time_offset_of(effects)
    age = 1e-9 * (offset.latency_ns + offset.delay_ns)
    return MapperNoise(profile, mode, names, tuple(angles), distance, sigma, bias, lost, age)


def _distances(mode: Mode, steepest: float, asked: tuple[float, float] | None) -> np.ndarray:
    # A wall at an end of the range would lose the pixels that noise carries over it.
    near, far = mode.range_min, mode.range_max
    if asked is not None and not near <= asked[0] < asked[1] <= far:
        raise InputError(
            f'distances: must rise and be within {near:g} to {far:g} m, the range of {mode.name}, '
            f'got {asked[0]:g} to {asked[1]:g}'
        )
    at_near, at_far = mode.noise.sigma_z(np.array([near, far]), math.radians(steepest))
    margin = 0.1 * (far - near)
    # A tenth of the distance is also what a slanted wall extends over in the block.
    near += min(max(_CLEAR * float(at_near), 0.1 * near), margin)
    far -= min(max(_CLEAR * float(at_far), 0.1 * far), margin)
    if asked is not None:
        near, far = max(near, asked[0]), min(far, asked[1])
    return np.linspace(near, max(near, far), DISTANCES)


def _wall(camera: Camera, distance: float, angle: float) -> tuple[float, float, float]:
    # Sigma, bias and the fraction of lost pixels in the middle of a wall.
    intrinsics = camera.profile.intrinsics
    clean = wall_depth(intrinsics, distance, angle)
    camera.reset()
    # Whole milliseconds apart for each wall, so that walls do not share their noise.
    first = round(1e3 * distance) * 1_000_000_000 + round(angle) * 10_000_000_000_000
    stamps = first + np.arange(FRAMES + _SETTLING) * camera.mode.period_ns
    frames = camera.capture(clean, intrinsics.matrix, stamps).depth[_SETTLING:]
    middle = tuple(
        slice(max((size - part) // 2, 0), (size + part) // 2)
        for size, part in zip(clean.shape, _BLOCK, strict=True)
    )
    error = (frames[:, *middle] - clean[middle]).astype(np.float64)
    share, sigmas = _GROSS
    model = float(camera.mode.noise.sigma_z(distance, math.radians(angle)))
    seen = np.abs(error) <= max(share * distance, sigmas * model)  # False for NaN
    lost = 1.0 - float(seen.mean())
    if lost > 1.0 - _FEWEST:
        return math.nan, math.nan, lost
    values = error[seen]
    return float(values.std()), float(values.mean()), lost


def wall_depth(camera: Intrinsics, distance: float, angle: float) -> np.ndarray:
    """
    Return the exact depth of a wall that is turned about the horizontal axis of the image.

    It is (H, W) float64 metres; NaN where a ray misses the wall. ``distance`` is along the optical
    axis, metres, ``angle`` between that axis and the wall's normal, degrees.
    """
    slope = math.tan(math.radians(angle))
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = distance / (1.0 + slope * pixel_rays(camera)[1])
    depth[~(depth > 0)] = np.nan
    return np.asarray(depth)
