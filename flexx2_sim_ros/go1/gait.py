"""
A trot, kinematic: commanded velocities in, the trunk's pose and twelve joint angles out.

Functions from one state to the next. A foot on the ground does not move at all. A foot in the air
goes up, over and down to a place that was found for it when it left the ground. The trunk's
height and tilt follow the ground under the four feet, which changes smoothly with them.
"""

from dataclasses import dataclass, replace
import math

from flexx2_sim_ros.go1.ground import Ground
from flexx2_sim_ros.go1.kinematics import feet, GO1, joint_angles, LegGeometry, rotation
import numpy as np

HOME = np.tile([0.0, 0.9, -1.8], (4, 1))

# Diagonal legs swing together: FR with RL, FL with RR.
_OFFSET = np.array([0.0, 0.5, 0.5, 0.0])
_LARGEST_STEP = 1.0 / 120.0
_TURN = np.arange(8) * np.pi / 4
_RING = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
# Displacements to try for an even foothold, the nearest first, metres.
_ASIDE = np.array(sorted(((x, y) for x in (-0.12, -0.09, -0.06, -0.03, 0.0, 0.03, 0.06, 0.09, 0.12)
                          for y in (-0.06, -0.03, 0.0, 0.03, 0.06)), key=lambda p: math.hypot(*p)))
# An even foothold: the ground is within this of a plane, metres.
_EVEN = 0.006
# No foothold is farther above or below the mean of the four feet, metres.
_REACH = 0.22
# An edge higher than this stops the robot, metres.
_LARGEST_EDGE = 0.14
# Where the way is judged, metres from the trunk's middle: as far as a stride and braking take.
_AHEAD = np.linspace(0.2, 0.48, 6)
_SIDES = np.array([-0.12, 0.0, 0.12])
_NO_FOOT = np.zeros(4, bool)


@dataclass(frozen=True)
class Gait:
    """
    How to trot.

    Attributes
    ----------
    max_speed : float
        In any direction, m/s.
    max_turn : float
        About the vertical, rad/s.
    period : float
        Of one cycle, seconds.
    duty : float
        The share of it that a foot stands; above 0.5, so that at times all four do.
    lift : float
        How far a foot is raised above what it passes, metres.
    acceleration, braking : float
        m/s^2.
    turn_acceleration : float
        rad/s^2.

    """

    max_speed: float = 0.8
    max_turn: float = 1.5
    period: float = 0.44
    duty: float = 0.56
    lift: float = 0.05
    acceleration: float = 2.0
    braking: float = 4.0
    turn_acceleration: float = 8.0


@dataclass(frozen=True)
class GaitState:
    """
    A moment of the walk.

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
    home : numpy.ndarray
        (4,) bool: that the foot stands under its hip, with no need to be put there.
    blocked : bool
        That something too high or too deep to walk on lies where it was told to go.

    """

    position: np.ndarray
    yaw: float
    velocity: np.ndarray
    phase: float
    lifted: np.ndarray
    landed: np.ndarray
    apex: np.ndarray
    home: np.ndarray
    blocked: bool = False


@dataclass(frozen=True)
class Pose:
    """
    What a state of the gait looks like.

    Attributes
    ----------
    position, rpy : numpy.ndarray
        (3,) of the trunk: metres, and roll, pitch, yaw in radians.
    angles : numpy.ndarray
        (4, 3) joint angles, radians.
    feet : numpy.ndarray
        (4, 3) metres in the world: where the feet are meant to be, which is where they are unless
        that is out of reach.
    standing : numpy.ndarray
        (4,) bool: whether the foot is on the ground.

    """

    position: np.ndarray
    rpy: np.ndarray
    angles: np.ndarray
    feet: np.ndarray
    standing: np.ndarray


def start(position: np.ndarray, yaw: float, top: float, ground: Ground,
          legs: LegGeometry = GO1) -> GaitState:
    """Return a robot that stands still at a place (2,), on the highest ground below `top`."""
    places = position + legs.neutral @ _plane_rotation(yaw).T
    heights = np.array([_rest_height(place, top, ground, legs)[0] for place in places])
    heights = np.where(np.isnan(heights), top - standing_height(legs) + legs.foot_radius, heights)
    landed = np.column_stack([places, heights])
    return GaitState(np.array(position, float), float(yaw), np.zeros(3), 0.0, landed, landed,
                     heights, np.ones(4, bool))


def step(state: GaitState, command: np.ndarray, seconds: float, ground: Ground,
         gait: Gait, legs: LegGeometry = GO1) -> GaitState:
    """
    Return the state some time later.

    Parameters
    ----------
    state : GaitState
        Now.
    command : numpy.ndarray
        (3,) finite: forward and to the left in m/s, turn in rad/s. Held for the whole time, and
        to the limits of `gait`.
    seconds : float
        How long; not negative.
    ground : Ground
        The world.
    gait : Gait
        How to trot.
    legs : LegGeometry
        The robot's legs.

    """
    count = max(1, math.ceil(seconds / _LARGEST_STEP - 1e-9))
    target = _limited(np.asarray(command, float), gait)
    blocked = bool(target[:2].any()) and _blocked(state, target[:2], ground, gait, legs)
    if blocked:
        target = np.array([0.0, 0.0, target[2]])
    state = replace(state, blocked=blocked)
    for _ in range(count):
        state = _small_step(state, target, seconds / count, ground, gait, legs)
    return state


def pose(state: GaitState, gait: Gait, legs: LegGeometry = GO1) -> Pose:
    """Return the trunk's pose and the joint angles of a state."""
    points, heights, swinging = _feet(state, gait, legs)
    position, rpy = _trunk(state, heights, legs)
    angles = joint_angles((points - position) @ rotation(rpy), legs)
    return Pose(position, rpy, angles, points, ~swinging)


def standing_height(legs: LegGeometry = GO1) -> float:
    """Return the height of the trunk's middle above level ground, metres."""
    return float(legs.foot_radius - feet(HOME, legs)[:, 2].mean())


def _small_step(state: GaitState, target: np.ndarray, seconds: float, ground: Ground, gait: Gait,
                legs: LegGeometry) -> GaitState:
    velocity = _faster(state.velocity, target, seconds, gait)
    yaw = state.yaw + seconds * velocity[2]
    heading = _plane_rotation((state.yaw + yaw) / 2)
    position = state.position + seconds * heading @ velocity[:2]
    moving = bool(velocity.any() or target.any())
    home = _NO_FOOT if moving else state.home
    moved = replace(state, position=position, yaw=yaw, velocity=velocity, home=home)
    phase = state.phase + seconds / gait.period
    end = (math.floor(2 * state.phase) + 1) / 2
    resting = state.phase in (0.0, 0.5)
    if not moving and home.all():
        # Legs are put down before it stands still; four feet stand at the end of a half cycle.
        phase = state.phase if resting else min(phase, end)
    before = (state.phase + _OFFSET) % 1.0 >= gait.duty
    now = (phase + _OFFSET) % 1.0 >= gait.duty
    lifted, landed, apex = state.lifted.copy(), state.landed.copy(), state.apex.copy()
    landing = before & ~now
    lifted[landing] = landed[landing]
    apex[landing] = landed[landing, 2]
    for leg in np.flatnonzero(now & ~before):
        landed[leg], apex[leg] = _plan(moved, int(leg), ground, gait, legs)
        if not moving:
            home = home | (np.arange(4) == leg)
    return replace(moved, phase=phase % 1.0, lifted=lifted, landed=landed, apex=apex, home=home)


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
    # Exactly the target once it is reached, so that zero is zero.
    return np.where(np.abs(target - velocity - change) < 1e-12, target, velocity + change)


def _blocked(state: GaitState, course: np.ndarray, ground: Ground, gait: Gait,
             legs: LegGeometry) -> bool:
    """Say whether the way (2,) in the robot's heading leads against or over an edge."""
    _, heights, _ = _feet(state, gait, legs)
    position, rpy = _trunk(state, heights, legs)
    turned = rotation(rpy)
    ahead = turned @ np.append(course / np.hypot(*course), 0.0)
    across = turned @ np.append(np.array([-course[1], course[0]]) / np.hypot(*course), 0.0)
    starts = position + _SIDES[:, None] * across
    if any(ground.free(point, ahead) < _AHEAD[-1] for point in starts):
        return True
    places = starts[:, None] + _AHEAD[:, None] * ahead
    found = ground.heights(places[..., :2], float(places[..., 2].max()))
    edges = np.diff(found, axis=1, prepend=position[2] - standing_height(legs))
    return not bool((np.abs(edges) < _LARGEST_EDGE).all())


def _plan(state: GaitState, leg: int, ground: Ground, gait: Gait,
          legs: LegGeometry) -> tuple[np.ndarray, float]:
    """Return where a foot that leaves the ground now comes down, and how high it goes."""
    foot = state.landed[leg]
    # Under the hip half-way through the coming stance, if the velocity stays.
    ahead = gait.period * ((1 - gait.duty) + gait.duty / 2)
    yaw = state.yaw + ahead * state.velocity[2]
    heading = _plane_rotation((state.yaw + yaw) / 2)
    middle = state.position + ahead * heading @ state.velocity[:2]
    turned = _plane_rotation(yaw)
    place = middle + turned @ legs.neutral[leg]
    level = float(state.landed[:, 2].mean())
    top = level + standing_height(legs)
    best, best_cost = foot, np.inf
    for aside in _ASIDE:
        candidate = place + turned @ aside
        height, rough = _rest_height(candidate, top, ground, legs)
        if not abs(height - level) < _REACH:
            continue
        cost = math.hypot(*aside) + 10.0 * rough
        if cost < best_cost:
            best, best_cost = np.append(candidate, height), cost
        if rough < _EVEN:
            break
    way = np.linspace(foot[:2], best[:2], 9)
    passed = [_rest_height(point, top, ground, legs)[0] for point in way]
    return best, float(np.nanmax([*passed, foot[2], best[2]])) + gait.lift


def _rest_height(place: np.ndarray, top: float, ground: Ground,
                 legs: LegGeometry) -> tuple[float, float]:
    """Return the height of a foot's middle when it rests at a place, and how rough that is."""
    radius = legs.foot_radius
    inner, outer = 0.7 * radius, 1.8 * radius
    points = np.concatenate([place[None], place + inner * _RING, place + radius * _RING,
                             place + outer * _RING])
    heights = ground.heights(points, top)
    lifts = np.repeat([radius, math.sqrt(radius ** 2 - inner ** 2), 0.0, -np.inf], [1, 8, 8, 8])
    edge = heights[-8:]
    # On an even slope the ring's heights are those of a plane: a constant and a first harmonic.
    plane = edge.mean() + _RING @ (_RING.T @ edge / 4)
    return float((heights + lifts).max()), float(np.abs(edge - plane).max())


def _feet(state: GaitState, gait: Gait,
          legs: LegGeometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the feet's middles (4, 3), the ground (4,) they count for, and which are in the air."""
    phase = (state.phase + _OFFSET) % 1.0
    swinging = phase >= gait.duty
    along = np.where(swinging, (phase - gait.duty) / (1 - gait.duty), 1.0)
    lifted, landed, apex = state.lifted, state.landed, state.apex
    # Over a step the foot goes straight up before it goes over; on the level it may cut corners.
    climb = apex - gait.lift - np.minimum(lifted[:, 2], landed[:, 2])
    corner = 0.12 + 0.16 * np.clip(climb / 0.03, 0.0, 1.0)
    over = _smooth((along - corner) / (1 - 2 * corner))
    up, down = _smooth(along / 0.42), _smooth((along - 0.58) / 0.42)
    points = lifted + over[:, None] * (landed - lifted)
    points[:, 2] = lifted[:, 2] + up * (apex - lifted[:, 2]) + down * (landed[:, 2] - apex)
    ground = lifted[:, 2] + over * (landed[:, 2] - lifted[:, 2]) - legs.foot_radius
    return np.where(swinging[:, None], points, landed), ground, swinging


def _trunk(state: GaitState, ground: np.ndarray,
           legs: LegGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Return the trunk's position (3,) and roll, pitch, yaw (3,) over the ground under its feet."""
    length = legs.hips[:2, 0].mean() - legs.hips[2:, 0].mean()
    width = np.abs(legs.neutral[:, 1]).mean() * 2
    front, left = ground[:2].mean() - ground[2:].mean(), ground[1::2].mean() - ground[::2].mean()
    # Less than the ground tilts: the legs make up for the rest.
    pitch = np.clip(-0.8 * np.arctan2(front, length), -0.4, 0.4)
    roll = np.clip(0.5 * np.arctan2(left, width), -0.25, 0.25)
    height = ground.mean() + standing_height(legs)
    return np.append(state.position, height), np.array([roll, pitch, state.yaw])


def _smooth(x: np.ndarray) -> np.ndarray:
    """Return 0 below 0, 1 above 1, and between them the curve without jumps in acceleration."""
    x = np.clip(x, 0.0, 1.0)
    return x ** 3 * (10 + x * (6 * x - 15))


def _plane_rotation(yaw: float) -> np.ndarray:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([[cosine, -sine], [sine, cosine]])
