"""The cameras of many walks: exact depth, or a simulated camera."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.walking.terrain import Terrain
import numpy as np


@dataclass(frozen=True)
class WalkViews:
    """
    What the cameras of N walks have before them, in L looks of C cameras.

    Attributes
    ----------
    depth, reflectivity : numpy.ndarray
        (C, L, N, H, W) float32: exact depth, metres, NaN where there is no return; 0 to 1.
    earlier : callable
        Returns depth and reflectivity as they were some seconds before each look.
    position, rotation : numpy.ndarray
        (C, L, N, 3) metres and (C, L, N, 3, 3): the optical frame (x right, y down, z ahead) in
        the world (x ahead, y left, z up).
    poses : callable
        Returns positions and rotations at any times, an array of seconds since the walk began.
    times : numpy.ndarray
        (L,) seconds since the walk began.
    lens, names
        Of the cameras.
    first : int
        Number of the first walk.

    """

    depth: np.ndarray
    reflectivity: np.ndarray
    earlier: Callable[[float], tuple[np.ndarray, np.ndarray]]
    position: np.ndarray
    rotation: np.ndarray
    poses: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    times: np.ndarray
    lens: Intrinsics
    names: Sequence[str]
    terrain: Terrain
    first: int


class WalkingCamera(Protocol):
    """A camera on a robot; it is sent to other processes."""

    def __call__(self, views: WalkViews) -> np.ndarray:
        """Return (C, L, N, H, W) float32 metres, NaN where invalid."""


@dataclass(frozen=True)
class ExactCamera:
    """
    Perfect depth.

    Attributes
    ----------
    range_max : float
        Largest depth, metres.

    """

    range_max: float

    def __call__(self, views: WalkViews) -> np.ndarray:
        """Return the exact depth up to the range."""
        return np.where(views.depth <= self.range_max, views.depth, np.float32(np.nan))


@dataclass(frozen=True)
class SimulatedCamera:
    """
    The simulated camera, with effects.

    The images are those of their stamps: ``delay`` of `TimeOffset` is left out.

    Attributes
    ----------
    usecase : str
        The mode.
    profile : Profile or None
        The camera; None: the Flexx2.
    effects : mapping
        Parameters by name.
    seed : int
        Of the noise. Cameras with the same seed have common random numbers.

    """

    usecase: str
    profile: Profile | None = None
    effects: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0

    def __call__(self, views: WalkViews) -> np.ndarray:
        """Simulate all walks in one batch."""
        count = views.depth.shape[2]
        # Looks are too far apart to tell from them what the cameras had before them in between.
        effects = parse_effects(self.effects)
        offset = time_offset_of(effects)
        rest = {one.name: one.settings for one in effects if one.name != offset.name}
        depth, reflectivity = views.depth, views.reflectivity
        if offset.latency_ns:
            depth, reflectivity = views.earlier(1e-9 * offset.latency_ns)
        seeds = [self.seed + views.first + walk for walk in range(count)]
        out = np.empty_like(views.depth)
        for c, name in enumerate(views.names):
            camera = BatchCamera(
                count,
                self.usecase,
                profile=self.profile,
                effects=rest,
                seed=seeds,
                name=name,
                K=views.lens.matrix,
                device='cpu',
            )
            for k, time in enumerate(views.times):
                camera.stamps.fill_(round(1e9 * float(time)))
                camera(depth[c, k], reflectivity[c, k], out=out[c, k])
        return out
