"""Make `mujoco.mj_multiRay` exact: switch its culling off where it drops visible geoms."""

import copy

import mujoco
import numpy as np

# mj_version() of the first release that keeps large geoms near the origin of the rays.
_FIXED = 4_000_000


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
