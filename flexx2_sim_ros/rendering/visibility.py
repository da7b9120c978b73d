"""Find the robot's own shapes that its camera can never see; they need not be rendered."""

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.rays import exact_for_rays
import mujoco
import numpy as np

_POSES = 1000
_ONLY = np.array([1, 0, 0, 0, 0, 0], np.uint8)


def unseen_geoms(model: mujoco.MjModel, camera: int, intrinsics: Intrinsics) -> np.ndarray:
    """
    Return which shapes of a robot are always outside the view of a camera on it, (ngeom,) bool.

    Shapes that are fixed to the camera are tested with its rays. Shapes that move are tested in
    many poses from the whole range of the joints. Only shapes of the robot are tested; all False
    for a camera that is fixed to the world. ``camera`` is its id.
    """
    body = model.cam_bodyid[camera]
    bodies = model.geom_bodyid
    own = model.body_rootid[bodies] == model.body_rootid[body]
    if model.body_rootid[body] == 0:
        return np.zeros(model.ngeom, bool)
    data = mujoco.MjData(model)
    fixed = own & (model.body_weldid[bodies] == model.body_weldid[body])
    seen = _hit_by_rays(model, data, camera, intrinsics, fixed)
    moving = own & ~fixed
    seen[moving] = _crossing(model, data, camera, intrinsics, moving)
    # If part of a leg can come into view, the whole leg is kept: not every pose was tested.
    limbs = np.array([_limb(model, int(part), int(body)) for part in bodies])
    seen |= np.isin(limbs, limbs[seen & moving])
    return own & ~seen


def _limb(model: mujoco.MjModel, body: int, trunk: int) -> int:
    """Return the ancestor of a body that is attached to the trunk (or to parts fixed to it)."""
    parent = int(model.body_parentid[body])
    while parent and model.body_weldid[parent] != model.body_weldid[trunk]:
        body, parent = parent, int(model.body_parentid[parent])
    return body


def pixel_directions(intrinsics: Intrinsics) -> np.ndarray:
    """Return (H, W, 3) float64 rays in MuJoCo's camera frame (y up, looking along -z), z = -1."""
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    return np.stack(
        [*np.meshgrid(x, -y), -np.ones((intrinsics.height, intrinsics.width))], axis=-1
    )


def _hit_by_rays(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: int,
    intrinsics: Intrinsics,
    geoms: np.ndarray,
) -> np.ndarray:
    """Return (ngeom,) bool: those of `geoms` that a pixel's ray hits, without other geoms."""
    only = exact_for_rays(model)
    only.geom_group[:] = np.where(geoms, 0, 5)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    rays = pixel_directions(intrinsics).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hit = np.empty(len(rays), np.int32)
    mujoco.mj_multiRay(
        m=only,
        d=data,
        pnt=data.cam_xpos[camera],
        vec=(rays @ data.cam_xmat[camera].reshape(3, 3).T).ravel(),
        geomgroup=_ONLY,
        flg_static=1,
        bodyexclude=-1,
        geomid=hit,
        dist=np.empty(len(rays)),
        normal=None,
        nray=len(rays),
        cutoff=mujoco.mjMAXVAL,
    )
    seen = np.zeros(model.ngeom + 1, bool)
    seen[hit] = True
    return seen[:-1]


def _crossing(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: int,
    intrinsics: Intrinsics,
    geoms: np.ndarray,
) -> np.ndarray:
    """Return which of `geoms` have a bounding sphere that reaches into the view in some pose."""
    inward = _view_planes(intrinsics)
    low, high = model.jnt_range.T.copy()
    free = model.jnt_limited == 0
    low[free], high[free] = -np.pi, np.pi
    joints = np.flatnonzero(
        (model.body_rootid[model.jnt_bodyid] == model.body_rootid[model.cam_bodyid[camera]])
        & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE))
    )
    addresses = model.jnt_qposadr[joints]
    random = np.random.default_rng(0)
    radii = model.geom_rbound[geoms]
    seen = np.zeros(radii.size, bool)
    for _ in range(_POSES):
        data.qpos[addresses] = random.uniform(low[joints], high[joints])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        centres = (data.geom_xpos[geoms] - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(
            3, 3
        )
        seen |= (centres @ inward.T).min(axis=1) > -radii
    return seen


def _view_planes(intrinsics: Intrinsics) -> np.ndarray:
    """Return (5, 3) unit normals, pointing inwards, of the planes around a camera's view."""
    left, right = (np.array([-0.5, intrinsics.width - 0.5]) - intrinsics.cx) / intrinsics.fx
    top, bottom = (np.array([-0.5, intrinsics.height - 0.5]) - intrinsics.cy) / intrinsics.fy
    # Image y points down, the camera's y axis up.
    planes = np.array(
        [
            [1.0, 0.0, left],
            [-1.0, 0.0, -right],
            [0.0, -1.0, top],
            [0.0, 1.0, -bottom],
            [0.0, 0.0, -1.0],
        ]
    )
    return planes / np.linalg.norm(planes, axis=1, keepdims=True)
