"""The ground under a walking robot: the scene's solid shapes, found with rays."""

import copy
from typing import Protocol

import mujoco
import numpy as np

_SOLID = np.array([1, 0, 0, 0, 0, 0], np.uint8)
_DOWN = np.array([0.0, 0.0, -1.0])


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
