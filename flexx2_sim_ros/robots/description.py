"""The robot as links and joints: its URDF, and the pose of each link in a state."""

from dataclasses import dataclass
from xml.etree import ElementTree

from flexx2_sim_ros.robots.parts import body_name, find_parts, joint_name
from flexx2_sim_ros.robots.robot import Robot
import mujoco
import numpy as np

# The trunk's link, whatever its body is named, and the frame that it is fixed to.
TRUNK, BASE = 'trunk', 'base'
_HINGE, _SLIDE, _BALL = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_BALL,
    )
)
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX = (
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_BOX,
    )
)
_VISIBLE_GROUPS = 3  # MuJoCo's viewer shows groups 0, 1 and 2 by default


@dataclass(frozen=True)
class Link:
    """
    A body of the robot and the joint that connects it to its parent.

    A body with several joints has a link for each: all but the last are empty.

    Attributes
    ----------
    name, parent : str
        Of this link and of the one it is attached to. A link is named like its body, with a
        number where another link has this name.
    joint : str
        The joint's name.
    kind : int
        `mujoco.mjtJoint`, or -1 where nothing moves.
    position, quaternion : numpy.ndarray
        (3,) metres and (4,) (w, x, y, z): this link in its parent where the joint is at 0.
    axis : numpy.ndarray
        (3,) of the joint, in this link.
    address : int
        Of the joint in ``qpos``; -1 without one.
    limits : tuple of float
        Least and greatest position, radians or metres; empty without limits.
    body : int
        Id of the body whose shapes and mass this link carries; -1 for an empty link.
    shift : numpy.ndarray
        (3,) metres: the body's origin in this link.

    """

    name: str
    parent: str
    joint: str
    kind: int
    position: np.ndarray
    quaternion: np.ndarray
    axis: np.ndarray
    address: int
    limits: tuple[float, ...]
    body: int
    shift: np.ndarray

    @property
    def moves(self) -> bool:
        """Return whether the link has a joint."""
        return self.kind >= 0


def links_of(model: mujoco.MjModel, robot: Robot | None = None) -> list[Link]:
    """
    Return the links of the robot's trunk and its descendants, parents first.

    The first one is the trunk, fixed to the frame ``base``. ``model`` is from `build_model`, with
    `robot` (default `load_robot()`).
    """
    trunk = find_parts(model, robot).trunk
    links = [
        Link(
            TRUNK,
            BASE,
            f'{BASE}_{TRUNK}',
            -1,
            np.zeros(3),
            _UPRIGHT,
            np.zeros(3),
            -1,
            (),
            trunk,
            np.zeros(3),
        )
    ]
    last, taken = {trunk: links[0]}, {BASE, TRUNK}
    for body in range(trunk + 1, model.nbody):
        above = last.get(int(model.body_parentid[body]))
        if above is not None:
            found = _links_of_body(model, body, above, taken)
            links += found
            last[body] = found[-1]
    return links


def _unused(name: str, taken: set[str]) -> str:
    """Return a name like this one that no link has yet, and note it as taken."""
    found, number = name, 2
    while found in taken:
        found, number = f'{name}_{number}', number + 1
    taken.add(found)
    return found


def _links_of_body(model: mujoco.MjModel, body: int, above: Link, taken: set[str]) -> list[Link]:
    name = _unused(body_name(model, body), taken)
    position, quaternion = model.body_pos[body] + above.shift, model.body_quat[body]
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count == 0:
        return [
            Link(
                name,
                above.name,
                f'{name}_fixed',
                -1,
                position,
                quaternion,
                np.zeros(3),
                -1,
                (),
                body,
                np.zeros(3),
            )
        ]
    links, parent, anchor = [], above.name, np.zeros(3)
    for joint in range(first, first + count):
        # In URDF a link's origin is at its joint; in MuJoCo it is the body's.
        place = position + _rotated(model.jnt_pos[joint] - anchor, quaternion)
        moving = joint_name(model, joint)
        kind, axis = int(model.jnt_type[joint]), model.jnt_axis[joint]
        address = int(model.jnt_qposadr[joint])
        place, turn = _at_zero(kind, place, quaternion, axis, model.qpos0[address])
        limited = model.jnt_limited[joint] and kind in (_HINGE, _SLIDE)
        is_last = joint == first + count - 1
        links.append(
            Link(
                name if is_last else _unused(f'{name}_{moving}', taken),
                parent,
                moving,
                kind,
                place,
                turn,
                axis,
                address,
                tuple(model.jnt_range[joint]) if limited else (),
                body if is_last else -1,
                -model.jnt_pos[joint] if is_last else np.zeros(3),
            )
        )
        parent, anchor = links[-1].name, model.jnt_pos[joint]
        position, quaternion = np.zeros(3), _UPRIGHT
    return links


def _at_zero(
    kind: int, position: np.ndarray, quaternion: np.ndarray, axis: np.ndarray, reference: float
) -> tuple[np.ndarray, np.ndarray]:
    # The model's own pose is at qpos0, a URDF's at 0.
    if kind == _SLIDE:
        return position - reference * _rotated(axis, quaternion), quaternion
    if kind == _HINGE:
        return position, _product(quaternion, _turned(axis, -reference))
    return position, quaternion


def poses(links: list[Link], qpos: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Return the poses of links in their parents: (3,) metres and (4,) (w, x, y, z) of each.

    ``qpos`` are the model's positions; ``links`` may be any of those of `links_of`.
    """
    result = []
    for link in links:
        position, quaternion = link.position, link.quaternion
        if link.kind == _HINGE:
            quaternion = _product(quaternion, _turned(link.axis, qpos[link.address]))
        elif link.kind == _SLIDE:
            position = position + qpos[link.address] * _rotated(link.axis, quaternion)
        elif link.kind == _BALL:
            quaternion = _product(quaternion, qpos[link.address : link.address + 4])
        result.append((position, quaternion))
    return result


def urdf(model: mujoco.MjModel, links: list[Link]) -> str:
    """
    Return a valid URDF of the robot, whose root link is ``base``; meshes are left out.

    Shapes are primitives. ``links`` are those of `links_of`.
    """
    robot = ElementTree.Element('robot', name='robot')
    ElementTree.SubElement(robot, 'link', name=BASE)
    for link in links:
        element = ElementTree.SubElement(robot, 'link', name=link.name)
        if link.body >= 0:
            _add_mass(element, model, link)
            for geom in _geoms(model, link.body):
                _add_visuals(element, model, link, geom)
        _add_joint(robot, link)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding='unicode')


def _add_joint(robot: ElementTree.Element, link: Link) -> None:
    kind = {
        _HINGE: 'revolute' if link.limits else 'continuous',
        _SLIDE: 'prismatic',
        _BALL: 'floating',
    }.get(link.kind, 'fixed')
    joint = ElementTree.SubElement(robot, 'joint', name=link.joint, type=kind)
    _add_origin(joint, link.position, link.quaternion)
    ElementTree.SubElement(joint, 'parent', link=link.parent)
    ElementTree.SubElement(joint, 'child', link=link.name)
    if link.kind in (_HINGE, _SLIDE):
        ElementTree.SubElement(joint, 'axis', xyz=_text(link.axis))
    if link.limits or link.kind == _SLIDE:
        lower, upper = link.limits or (-1e3, 1e3)
        ElementTree.SubElement(
            joint, 'limit', lower=f'{lower:g}', upper=f'{upper:g}', effort='0', velocity='0'
        )


def _add_mass(element: ElementTree.Element, model: mujoco.MjModel, link: Link) -> None:
    if model.body_mass[link.body] <= 0:
        return
    inertial = ElementTree.SubElement(element, 'inertial')
    _add_origin(inertial, link.shift + model.body_ipos[link.body], model.body_iquat[link.body])
    ElementTree.SubElement(inertial, 'mass', value=f'{model.body_mass[link.body]:g}')
    x, y, z = model.body_inertia[link.body]
    ElementTree.SubElement(
        inertial, 'inertia', ixx=f'{x:g}', iyy=f'{y:g}', izz=f'{z:g}', ixy='0', ixz='0', iyz='0'
    )


def _geoms(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the body's primitives: the visible ones, or, without such, the hidden ones."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    primitives = (_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX)
    found = [geom for geom in range(first, first + count) if model.geom_type[geom] in primitives]
    visible = [geom for geom in found if model.geom_group[geom] < _VISIBLE_GROUPS]
    return visible or found


def _add_visuals(
    element: ElementTree.Element, model: mujoco.MjModel, link: Link, geom: int
) -> None:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    position, quaternion = link.shift + model.geom_pos[geom], model.geom_quat[geom]
    shapes: list[tuple[np.ndarray, str, dict[str, str]]]
    if kind == _SPHERE:
        shapes = [(position, 'sphere', {'radius': f'{size[0]:g}'})]
    elif kind in (_CYLINDER, _CAPSULE):
        shapes = [(position, 'cylinder', {'radius': f'{size[0]:g}', 'length': f'{2 * size[1]:g}'})]
        if kind == _CAPSULE:  # URDF has none: a cylinder with a sphere at each end
            end = _rotated(np.array([0.0, 0.0, size[1]]), quaternion)
            shapes += [
                (place, 'sphere', {'radius': f'{size[0]:g}'})
                for place in (position + end, position - end)
            ]
    else:  # URDF has no ellipsoid either: the box around it
        shapes = [(position, 'box', {'size': _text(2 * size)})]
    material = int(model.geom_matid[geom])
    colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    for place, tag, sizes in shapes:
        visual = ElementTree.SubElement(element, 'visual')
        _add_origin(visual, place, quaternion)
        ElementTree.SubElement(ElementTree.SubElement(visual, 'geometry'), tag, sizes)
        paint = ElementTree.SubElement(
            visual,
            'material',
            name='colour_' + '_'.join(f'{round(255 * value)}' for value in colour),
        )
        ElementTree.SubElement(paint, 'color', rgba=_text(colour))


def _add_origin(
    element: ElementTree.Element, position: np.ndarray, quaternion: np.ndarray
) -> None:
    ElementTree.SubElement(element, 'origin', xyz=_text(position), rpy=_text(_rpy(quaternion)))


def _text(values: np.ndarray) -> str:
    return ' '.join(f'{value:.9g}' for value in values)


def _rpy(quaternion: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (rotations about the fixed x, y, z axes) of a unit quaternion."""
    m = np.empty(9)
    mujoco.mju_quat2Mat(m, quaternion)
    pitch = np.arctan2(-m[6], np.hypot(m[0], m[3]))
    if abs(m[6]) > 1 - 1e-12:  # looking straight up or down, roll and yaw are one
        return np.array([np.arctan2(-m[5], m[4]), pitch, 0.0])
    return np.array([np.arctan2(m[7], m[8]), pitch, np.arctan2(m[3], m[0])])


def _turned(axis: np.ndarray, angle: float) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return quaternion


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    result = np.empty(4)
    mujoco.mju_mulQuat(result, first, second)
    return result


def _rotated(vector: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, np.ascontiguousarray(vector, float), quaternion)
    return result
