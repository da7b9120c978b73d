"""
A kinematic trot: from commanded velocities to the trunk's pose and twelve joint angles.

Functions map one state to the next. A foot on the ground does not move. A foot in the air goes up,
over and down to a foothold that was chosen when it left the ground. The trunk's height and tilt
follow the ground under the four feet smoothly.
"""

from dataclasses import dataclass, replace
import math

from flexx2_sim_ros.rendering.rays import Ground
from flexx2_sim_ros.robots.footholds import blocked, EVEN, find_foothold, rest_height, way_height
from flexx2_sim_ros.robots.kinematics import feet, joint_angles, LegGeometry, rotation
from flexx2_sim_ros.robots.trot import apex_height, Gait, OFFSET, trunk_pose
import numpy as np

_LARGEST_STEP = 1.0 / 120.0
# A robot looks for obstacles this often, however long a time step is: in a second it walks into a
# wall that it did not see at the start.
_STEPS_PER_LOOK = 4
# The fraction of a foot's time in the air after which its foothold no longer changes, and the
# smallest change, metres.
_CHANGEABLE = 0.7
_WORTH_A_CHANGE = 0.002
# A foot farther than this from the point below its hip must step, even to a poor foothold, metres.
_LEFT_BEHIND = 0.2
# How far a standing foot may be dragged, metres.
_SLIP = 0.002

# Of one foot: where it left the ground (3,), where it comes down (3,), the height of its way, and
# where it was wanted (2,).
_Swing = tuple[np.ndarray, np.ndarray, float, np.ndarray]


@dataclass(frozen=True)
class GaitState:
    """
    The state of the gait at one time.

    Attributes
    ----------
    position : numpy.ndarray
        (2,) of the trunk in the world, metres.
    yaw : float
        Its heading, radians.
    velocity : numpy.ndarray
        (3,) forward, to the left (m/s) and about the vertical (rad/s), in its own heading.
    phase : float
        0 to 1 of a cycle.
    lifted, landed : numpy.ndarray
        (4, 3) metres in the world: where the middle of each foot left the ground, and where it
        comes down; the same for a foot that stands.
    apex : numpy.ndarray
        (4,) height of the way between them, metres.
    wanted : numpy.ndarray
        (4, 2) where it would come down if all places were equally good.
    home : numpy.ndarray
        (4,) bool: that the foot stands under its hip, with no need to be put there.
    blocked : bool
        Whether the commanded way leads over ground that is too high or too deep.

    """

    position: np.ndarray
    yaw: float
    velocity: np.ndarray
    phase: float
    lifted: np.ndarray
    landed: np.ndarray
    apex: np.ndarray
    wanted: np.ndarray
    home: np.ndarray
    blocked: bool = False


@dataclass(frozen=True)
class GaitPose:
    """
    The pose of the robot in a state of the gait.

    Attributes
    ----------
    position, rpy : numpy.ndarray
        (3,) of the trunk: metres, and roll, pitch, yaw in radians.
    angles : numpy.ndarray
        (4, 3) joint angles, radians.
    feet : numpy.ndarray
        (4, 3) metres in the world: where the feet are meant to be, which is where they are unless
        that is out of reach.
    standing, missed : numpy.ndarray
        (4,) bool, whether the foot is on the ground, and (4,) metres that it is away from where it
        is meant to be.

    """

    position: np.ndarray
    rpy: np.ndarray
    angles: np.ndarray
    feet: np.ndarray
    standing: np.ndarray
    missed: np.ndarray


def start(
    position: np.ndarray, yaw: float, top: float, ground: Ground, legs: LegGeometry
) -> GaitState:
    """Return a robot that stands still at a place (2,), on the highest ground below `top`."""
    places = position + legs.neutral @ _plane_rotation(yaw).T
    heights = np.array([rest_height(place, top, ground, legs.foot_radius)[0] for place in places])
    heights = np.where(np.isnan(heights), top - legs.standing_height + legs.foot_radius, heights)
    landed = np.column_stack([places, heights])
    return GaitState(
        np.array(position, float),
        float(yaw),
        np.zeros(3),
        0.0,
        landed,
        landed,
        heights,
        places,
        np.ones(4, bool),
    )


def step(
    state: GaitState,
    command: np.ndarray,
    seconds: float,
    ground: Ground,
    gait: Gait,
    legs: LegGeometry,
) -> GaitState:
    """
    Return the state after a time step of not negative `seconds`.

    ``command`` is (3,) finite: forward and to the left in m/s, turn in rad/s. It is held for the
    whole time, and to the limits of `gait`.
    """
    count = max(1, math.ceil(seconds / _LARGEST_STEP - 1e-9))
    wanted = target = _limited(np.asarray(command, float), gait)
    for k in range(count):
        if k % _STEPS_PER_LOOK == 0:
            stopped = _is_blocked(state, wanted, ground, gait, legs)
            state = replace(state, blocked=stopped)
            target = np.array([0.0, 0.0, wanted[2]]) if stopped else wanted
        state = _small_step(state, target, seconds / count, ground, gait, legs)
    return state


def _is_blocked(
    state: GaitState, target: np.ndarray, ground: Ground, gait: Gait, legs: LegGeometry
) -> bool:
    if not target[:2].any():
        return False
    under = _feet(state, gait, legs)[1]
    position, rpy = trunk_pose(state.position, state.yaw, under, legs)
    return blocked(position, rotation(rpy), target[:2], legs.standing_height, ground)


def pose(state: GaitState, gait: Gait, legs: LegGeometry) -> GaitPose:
    """Return the trunk's pose and the joint angles of a state."""
    points, heights, swinging = _feet(state, gait, legs)
    position, rpy = trunk_pose(state.position, state.yaw, heights, legs)
    wanted = (points - position) @ rotation(rpy)
    angles = joint_angles(wanted, legs)
    missed = np.linalg.norm(feet(angles, legs) - wanted, axis=1)
    return GaitPose(position, rpy, angles, points, ~swinging, missed)


def _small_step(
    state: GaitState,
    target: np.ndarray,
    seconds: float,
    ground: Ground,
    gait: Gait,
    legs: LegGeometry,
) -> GaitState:
    velocity = _faster(state.velocity, target, seconds, gait)
    yaw = state.yaw + seconds * velocity[2]
    heading = _plane_rotation((state.yaw + yaw) / 2)
    position = state.position + seconds * heading @ velocity[:2]
    moving = bool(velocity.any() or target.any())
    home = state.home & (not moving)
    moved = replace(state, position=position, yaw=yaw, velocity=velocity)
    phase = state.phase + seconds / gait.period
    end = (math.floor(2 * state.phase) + 1) / 2
    resting = state.phase in (0.0, 0.5)
    if not moving and home.all():
        # The feet land before the robot stands still; all four stand at the end of a half cycle.
        phase = state.phase if resting else min(phase, end)
    before, now = (state.phase + OFFSET) % 1.0, (phase + OFFSET) % 1.0
    swings = []
    for leg in range(4):
        if now[leg] < gait.duty:
            foot = state.landed[leg]
            swings.append((foot, foot, foot[2], foot[:2]))
        elif before[leg] < gait.duty:
            swings.append(_plan(moved, leg, ground, gait, legs))
            home[leg] = not moving
        elif now[leg] < gait.duty + _CHANGEABLE * (1 - gait.duty):
            left = (1.0 - now[leg]) * gait.period
            swings.append(_replan(moved, leg, left, ground, gait, legs))
        else:
            swings.append(
                (state.lifted[leg], state.landed[leg], state.apex[leg], state.wanted[leg])
            )
    lifted, landed, apex, wanted = map(np.array, zip(*swings, strict=True))
    moved = replace(
        moved, phase=phase % 1.0, lifted=lifted, landed=landed, apex=apex, wanted=wanted, home=home
    )
    if velocity.any():
        reached = pose(moved, gait, legs)
        if (reached.missed[reached.standing] > _SLIP).any():
            # The trunk waits until a foot steps, instead of dragging the foot.
            moved = replace(moved, position=state.position, yaw=state.yaw, velocity=np.zeros(3))
    return moved


def _limited(command: np.ndarray, gait: Gait) -> np.ndarray:
    speed = math.hypot(command[0], command[1])
    scale = min(1.0, gait.max_speed / speed) if speed > 0 else 1.0
    turn = np.clip(command[2], -gait.max_turn, gait.max_turn)
    return np.array([command[0] * scale, command[1] * scale, turn])


def _faster(velocity: np.ndarray, target: np.ndarray, seconds: float, gait: Gait) -> np.ndarray:
    change = target - velocity
    slower = np.hypot(*target[:2]) < np.hypot(*velocity[:2])
    most = seconds * (gait.braking if slower else gait.acceleration)
    size = math.hypot(change[0], change[1])
    if size > most:
        change[:2] *= most / size
    most = seconds * gait.turn_acceleration
    change[2] = np.clip(change[2], -most, most)
    # End exactly at the target, so that zero is reached.
    return np.where(np.abs(target - velocity - change) < 1e-12, target, velocity + change)


def _place(
    state: GaitState, leg: int, seconds: float, gait: Gait, legs: LegGeometry
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a foot (2,) that lands after a time is best put, and the heading there."""
    # Under the hip half-way through the stance that follows, if the velocity stays.
    seconds += gait.period * gait.duty / 2
    yaw = state.yaw + seconds * state.velocity[2]
    heading, turn = _plane_rotation((state.yaw + yaw) / 2), _plane_rotation(yaw)
    middle = state.position + seconds * heading @ state.velocity[:2]
    return middle + turn @ legs.neutral[leg], turn


def _plan(state: GaitState, leg: int, ground: Ground, gait: Gait, legs: LegGeometry) -> _Swing:
    """Find where a foot that leaves the ground now comes down, and how high it goes."""
    foot = state.landed[leg]
    place, turn = _place(state, leg, gait.period * (1 - gait.duty), gait, legs)
    level = float(state.landed[:, 2].mean())
    found = find_foothold(
        foot, place, turn, level, level + legs.standing_height, ground, legs.foot_radius
    )
    if found is None:
        # The foot stays, unless it is too far from its hip.
        hip = state.position + _plane_rotation(state.yaw) @ legs.neutral[leg]
        if math.hypot(*(foot[:2] - hip)) > _LEFT_BEHIND:
            found = np.append(hip, level), max(foot[2], level)
        else:
            found = foot, foot[2]
    landed, highest = found
    return foot, landed, float(apex_height(highest, level, gait)), place


def _replan(
    state: GaitState, leg: int, seconds: float, ground: Ground, gait: Gait, legs: LegGeometry
) -> _Swing:
    """Adapt the foothold of a foot in the air to a changed velocity."""
    foot, landed, apex, wanted = (
        state.lifted[leg],
        state.landed[leg],
        float(state.apex[leg]),
        state.wanted[leg],
    )
    place, _ = _place(state, leg, seconds, gait, legs)
    if math.hypot(*(place - wanted)) > _WORTH_A_CHANGE:
        point, top = landed[:2] + place - wanted, apex + gait.lift
        height, rough = rest_height(point, top, ground, legs.foot_radius)
        if abs(height - landed[2]) < EVEN and rough < EVEN:
            moved = np.append(point, landed[2])
            if way_height(foot, moved, top, ground, legs.foot_radius) <= apex - gait.lift / 2:
                return foot, moved, apex, place
    return foot, landed, apex, wanted


def _feet(
    state: GaitState, gait: Gait, legs: LegGeometry
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the feet's middles (4, 3), the ground (4,) for each, and which are in the air."""
    phase = (state.phase + OFFSET) % 1.0
    swinging = phase >= gait.duty
    along = np.where(swinging, (phase - gait.duty) / (1 - gait.duty), 1.0)
    lifted, landed, apex = state.lifted, state.landed, state.apex
    # At a step the foot first goes straight up; on level ground it may move on a curve.
    climb = apex - gait.lift - np.minimum(lifted[:, 2], landed[:, 2])
    corner = 0.12 + 0.16 * np.clip(climb / 0.03, 0.0, 1.0)
    over = _smooth((along - corner) / (1 - 2 * corner))
    up, down = _smooth(along / 0.42), _smooth((along - 0.58) / 0.42)
    points = lifted + over[:, None] * (landed - lifted)
    points[:, 2] = lifted[:, 2] + up * (apex - lifted[:, 2]) + down * (landed[:, 2] - apex)
    # The trunk follows during the whole time in the air, so that it moves smoothly.
    eased = along**2 * (3 - 2 * along)
    ground = lifted[:, 2] + eased * (landed[:, 2] - lifted[:, 2]) - legs.foot_radius
    return np.where(swinging[:, None], points, landed), ground, swinging


def _smooth(x: np.ndarray) -> np.ndarray:
    """Return 0 below 0, 1 above 1, and between them the curve without jumps in acceleration."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 + x * (6 * x - 15))


def _plane_rotation(yaw: float) -> np.ndarray:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([[cosine, -sine], [sine, cosine]])
