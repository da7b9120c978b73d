"""Find a robot's parts in a model: its joints, leg geometry and trunk."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
import re

from flexx2_sim_ros.robots.kinematics import LegGeometry
from flexx2_sim_ros.robots.robot import LegJoints, load_robot, Robot
import mujoco
import numpy as np

_INDEX = {'0': 'hip', '1': 'thigh', '2': 'calf'}
_SLIDING = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class RobotParts:
    """
    The indices of a robot's parts in a model.

    Attributes
    ----------
    trunk : int
        Id of the trunk's body.
    free, free_velocity : int
        Addresses in ``qpos`` (-1 without one) and in ``qvel`` of the joint that lets the robot
        move freely.
    offset : tuple of numpy.ndarray or None
        Position (3,) and quaternion (4,) of the trunk in the body that this joint moves; None
        where joints between them change it.
    joints : dict of str to int
        Address in ``qpos`` of every hinge and slide, by its `joint_name`.
    velocities : numpy.ndarray
        (len(joints),) addresses of the same joints in ``qvel``.
    geoms : numpy.ndarray
        (ngeom,) bool: the robot's own shapes.
    legs : LegGeometry or None
        Its legs, if the model has the robot's joints in straight legs on the trunk.
    leg_addresses : numpy.ndarray
        (4, 3) addresses in ``qpos`` of hip, thigh and calf of each leg; empty without legs.

    """

    model: mujoco.MjModel
    trunk: int
    free: int
    free_velocity: int
    offset: tuple[np.ndarray, np.ndarray] | None
    joints: dict[str, int]
    velocities: np.ndarray
    geoms: np.ndarray
    legs: LegGeometry | None
    leg_addresses: np.ndarray

    def place(self, data: mujoco.MjData, position: np.ndarray, quaternion: np.ndarray) -> None:
        """
        Put the trunk at a position (3,) with an orientation (4,) (w, x, y, z) of norm 1.

        All other joints keep their positions.
        """
        offset = self._offset_now(data) if self.offset is None else self.offset
        inverse, turn, moved = np.empty(4), np.empty(4), np.empty(3)
        mujoco.mju_negQuat(inverse, offset[1])
        mujoco.mju_mulQuat(turn, quaternion, inverse)
        mujoco.mju_rotVecQuat(moved, offset[0], turn)
        data.qpos[self.free : self.free + 3] = position - moved
        data.qpos[self.free + 3 : self.free + 7] = turn

    def twist(self, data: mujoco.MjData, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the trunk's velocity in its own frame, (3,) m/s and (3,) rad/s.

        ``data`` is complete up to its positions. ``velocity`` is (nv,) as MuJoCo has it: of the
        free joint, linear in the world and angular in its body. Zeros for a robot that cannot move
        freely.
        """
        if self.free < 0:
            return np.zeros(3), np.zeros(3)
        if self.offset is None:
            return self._twist_with_joints(data, velocity)
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, self.offset[1])
        angular = (
            turned.reshape(3, 3).T @ velocity[self.free_velocity + 3 : self.free_velocity + 6]
        )
        rotation = data.xmat[self.trunk].reshape(3, 3)
        arm = turned.reshape(3, 3).T @ self.offset[0]
        linear = velocity[self.free_velocity : self.free_velocity + 3] @ rotation
        return linear + np.cross(angular, arm), angular

    def _offset_now(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        # With the freely moving body at the origin, the trunk's pose is its pose in that body.
        data.qpos[self.free : self.free + 7] = 0, 0, 0, 1, 0, 0, 0
        mujoco.mj_kinematics(self.model, data)
        return data.xpos[self.trunk].copy(), data.xquat[self.trunk].copy()

    def _twist_with_joints(
        self, data: mujoco.MjData, velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        # The joints between move the trunk as well.
        mujoco.mj_comPos(self.model, data)
        linear, angular = np.empty((3, self.model.nv)), np.empty((3, self.model.nv))
        mujoco.mj_jacBody(self.model, data, linear, angular, self.trunk)
        rotation = data.xmat[self.trunk].reshape(3, 3)
        return linear @ velocity @ rotation, angular @ velocity @ rotation


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's name, which is of its number where the model gives none."""
    return model.body(body).name or f'body_{body}'


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, which is of its body and number where the model gives none."""
    body = int(model.jnt_bodyid[joint])
    return model.joint(joint).name or f'{body_name(model, body)}_joint_{joint}'


def plain_name(name: str) -> str:
    """
    Return a joint's name without the differences between simulators.

    ``FR_hip_joint``, ``fr_hip``, ``go1/FR_hip_joint`` and Unitree's ``FR_0`` are one joint.
    """
    plain = name.rsplit('/', 1)[-1].lower().removesuffix('_joint')
    match = re.fullmatch(r'(f|r)(r|l)_([012])', plain)
    return f'{plain[:3]}{_INDEX[match[3]]}' if match else plain


class JointNames:
    """The joints of a robot, found by all their names from those in its model."""

    def __init__(self, joints: Iterable[str]) -> None:
        """Note the joints, and which of their plain names are only one joint's."""
        self._exact = frozenset(joints)
        plain = {name: plain_name(name) for name in self._exact}
        counts = Counter(plain.values())
        self._alone = {short: name for name, short in plain.items() if counts[short] == 1}

    def find(self, name: str) -> str | None:
        """Return the joint of this name, or else the only one with its `plain_name`."""
        return name if name in self._exact else self._alone.get(plain_name(name))


def find_parts(model: mujoco.MjModel, robot: Robot | None = None) -> RobotParts:
    """
    Return the indices of a robot's parts in a model from `build_model`.

    ``robot`` is the one that it was built with; default `load_robot()`.
    """
    robot = robot or load_robot()
    trunk = model.body(robot.trunk).id
    root = model.body_rootid[trunk]
    bodies = model.body_rootid == root
    free, free_velocity, joints, velocities = -1, -1, {}, []
    for joint in range(model.njnt):
        kind, body = int(model.jnt_type[joint]), model.jnt_bodyid[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE and body == root:
            free, free_velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        elif kind in _SLIDING and bodies[body]:
            joints[joint_name(model, joint)] = int(model.jnt_qposadr[joint])
            velocities.append(int(model.jnt_dofadr[joint]))
    legs, ids = _legs(model, int(trunk), robot.legs) or (None, np.empty((0, 3), int))
    return RobotParts(
        model,
        int(trunk),
        free,
        free_velocity,
        _offset(model, int(trunk), int(root)),
        joints,
        np.array(velocities, int),
        bodies[model.geom_bodyid],
        legs,
        model.jnt_qposadr[ids],
    )


def _offset(model: mujoco.MjModel, trunk: int, root: int) -> tuple[np.ndarray, np.ndarray] | None:
    position, quaternion = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    while trunk != root:
        if model.body_jntnum[trunk]:
            return None
        moved, turned = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(moved, position, model.body_quat[trunk])
        mujoco.mju_mulQuat(turned, model.body_quat[trunk], quaternion)
        position, quaternion = model.body_pos[trunk] + moved, turned
        trunk = int(model.body_parentid[trunk])
    return position, quaternion


def _legs(
    model: mujoco.MjModel, trunk: int, joints: LegJoints | None
) -> tuple[LegGeometry, np.ndarray] | None:
    """Return the leg geometry and the ids (4, 3) of the joints; None without such legs."""
    own = model.body_rootid[model.jnt_bodyid] == model.body_rootid[trunk]
    ids_of = {joint_name(model, int(joint)): joint for joint in np.flatnonzero(own)}
    names = JointNames(ids_of)
    found = [names.find(name) for name in joints.all_names] if joints else []
    if not joints or None in found:
        return None
    ids = np.array([ids_of[name] for name in found if name]).reshape(4, 3)
    bodies = model.jnt_bodyid[ids]
    above = np.column_stack([np.full(4, trunk), bodies[:, :2]])
    if (model.body_parentid[bodies] != above).any():
        return None
    hips, thighs, calves = np.moveaxis(model.body_pos[bodies], 1, 0)
    feet = [_foot(model, int(calf)) for calf in bodies[:, 2]]
    tips, radii = np.array([tip for tip, _ in feet]), [radius for _, radius in feet]
    straight = [
        thighs[:, [0, 2]],
        calves[:, :2],
        tips[:, :2],
        model.jnt_axis[ids] - [[1, 0, 0], [0, 1, 0], [0, 1, 0]],
    ]
    if not all(np.allclose(values, 0.0, atol=2e-3) for values in straight):
        return None
    limited, usual = model.jnt_limited[ids] != 0, np.array(joints.limits)
    lower, upper = (
        np.where(limited, model.jnt_range[ids][..., end], usual[:, end]) for end in (0, 1)
    )
    geometry = LegGeometry(
        hips,
        thighs[:, 1],
        -float(calves[0, 2]),
        -float(tips[0, 2]),
        lower,
        upper,
        float(radii[0]),
        np.array(joints.home),
    )
    return geometry, ids


def _foot(model: mujoco.MjModel, calf: int) -> tuple[np.ndarray, float]:
    """Return the middle (3,), in the calf's frame, and the radius of a leg's lowest sphere."""
    best, radius = np.full(3, np.inf), 0.0
    for geom in range(model.ngeom):
        body, place = model.geom_bodyid[geom], model.geom_pos[geom].copy()
        while body not in (calf, 0):
            place += model.body_pos[body]
            body = model.body_parentid[body]
        is_sphere = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        if body == calf and is_sphere and place[2] < best[2]:
            best, radius = place, float(model.geom_size[geom, 0])
    return best, radius
