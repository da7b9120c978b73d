"""Rays into a MuJoCo model: exact ones for images, and the ground that they find under a robot."""

import copy
from typing import Protocol

import mujoco
import numpy as np

# mj_version() of the first release that keeps large geoms near the origin of the rays.
_FIXED = 4_000_000
_SOLID = np.array([1, 0, 0, 0, 0, 0], np.uint8)
_DOWN = np.array([0.0, 0.0, -1.0])


def exact_for_rays(model: mujoco.MjModel) -> mujoco.MjModel:
    """
    Return a copy of a model in which `mujoco.mj_multiRay` finds every geom that `mj_ray` finds.

    ``mj_multiRay`` skips bodies by their bounding volume and geoms by the angles of their corners.
    Before MuJoCo 4.0 the angles are too small for large geoms near the origin, so it sees through
    parts of stairs and floors. In all versions the bounding volume of a body has only the geoms
    that collide, so it misses geoms that are there to be seen and are outside of it. Bodies
    without a bounding volume are not culled. The copy is for casting rays only, with the data of
    the original.
    """
    exact = copy.copy(model)
    if mujoco.mj_version() < _FIXED:
        exact.body_bvhadr[:] = -1
        return exact
    only_seen = (model.geom_contype | model.geom_conaffinity) == 0
    exact.body_bvhadr[np.unique(model.geom_bodyid[only_seen])] = -1
    return exact


class Ground(Protocol):
    """What the gait needs to know about the scene."""

    def heights(self, points: np.ndarray, top: float) -> np.ndarray:
        """Return (...) metres, the highest ground not above `top` at (..., 2) points, or NaN."""

    def free(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """Return how far one gets from a point in a (unit) direction, metres; may be inf."""


class SceneGround:
    """
    The ground of a MuJoCo scene.

    ``model`` is from `build_model` and not changed. ``data`` is a state of it, complete up to its
    positions whenever this is asked; it is kept. ``robot`` (ngeom,) bool are shapes that are not
    ground.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: np.ndarray) -> None:
        """Sort solid shapes of the scene from everything else."""
        # Rays are filtered by group: a copy of the model gets groups of its own. They also pass
        # through shapes that cannot be seen, which are often simpler ones to collide with.
        self._model = copy.copy(model)
        solid = (model.geom_contype | model.geom_conaffinity) != 0
        self._model.geom_group[:] = np.where(solid & ~robot, 0, 5)
        self._model.geom_rgba[:, 3] = self._model.mat_rgba[:, 3] = 1.0
        self._data = data
        self._hit = np.zeros(1, np.int32)

    def heights(self, points: np.ndarray, top: float) -> np.ndarray:
        """Return (...) metres, the highest ground not above `top` at (..., 2) points, or NaN."""
        flat = np.asarray(points, float).reshape(-1, 2)
        drops = np.array([self._ray(np.array([x, y, top]), _DOWN) for x, y in flat])
        return np.where(drops < 0, np.nan, top - drops).reshape(np.shape(points)[:-1])

    def free(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """Return how far one gets from a point in a (unit) direction, metres; may be inf."""
        distance = self._ray(np.asarray(origin, float), np.asarray(direction, float))
        return np.inf if distance < 0 else distance

    def _ray(self, origin: np.ndarray, direction: np.ndarray) -> float:
        return float(
            mujoco.mj_ray(self._model, self._data, origin, direction, _SOLID, 1, -1, self._hit)
        )
