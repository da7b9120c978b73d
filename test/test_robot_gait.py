"""The walk: feet that do not slip or sink, a trunk that follows the ground, and stopping."""

import itertools
import operator

from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.robots.gait import pose, start, step
from flexx2_sim_ros.robots.kinematics import feet, rotation
from flexx2_sim_ros.robots.model import build_model
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import load_robot
import numpy as np
import pytest
from walkers import GAIT, Walker

RATE = 60


def legs_of(name):
    """Return the legs of a robot's built-in model."""
    robot = load_robot(name)
    model = build_model(scene='corner', intrinsics=flexx2().intrinsics, robot=robot)
    return find_parts(model, robot).legs


GO1 = legs_of('go1')


@pytest.fixture(scope='module', params=['go1', 'go2'])
def legs(request):
    """Return the legs of each robot."""
    return legs_of(request.param)


class Flat:
    """A plain without end."""

    def heights(self, points, top):
        return np.zeros(points.shape[:-1])

    def free(self, origin, direction):
        return np.inf


def walk(commands, rate=RATE, legs=GO1):
    """Return the poses and states of a walk: (seconds, command) after (seconds, command)."""
    ground = Flat()
    state = start(np.zeros(2), 0.0, 0.3, ground, legs)
    poses, states = [pose(state, GAIT, legs)], [state]
    for seconds, command in commands:
        for _ in range(round(seconds * rate)):
            state = step(state, np.array(command, float), 1 / rate, ground, GAIT, legs)
            states.append(state)
            poses.append(pose(state, GAIT, legs))
    return poses, states


def true_feet(at, legs=GO1):
    """Return where the joint angles really put the feet, in the world."""
    return at.position + feet(at.angles, legs) @ rotation(at.rpy).T


def slips(poses, legs=GO1):
    """Return how far each foot strayed within each of its stances, metres."""
    result = []
    for leg in range(4):
        places = [(bool(at.standing[leg]), true_feet(at, legs)[leg]) for at in poses]
        for standing, group in itertools.groupby(places, key=operator.itemgetter(0)):
            if standing:
                stance = np.array([place for _, place in group])
                result.append(np.linalg.norm(stance - stance[0], axis=1).max())
    return np.array(result)


COMMANDS = {
    'ahead': [(3, (0.5, 0, 0))],
    'at the limit': [(3, (9.0, 9.0, 9.0))],
    'back': [(3, (-0.5, 0, 0))],
    'sideways': [(3, (0, 0.4, 0))],
    'turning': [(3, (0, 0, 1.5))],
    'slowly': [(3, (0.02, 0, 0.05))],
    'there and back': [
        (1.3, (0.8, 0, 0)),
        (1.1, (-0.8, 0, 1.5)),
        (0.9, (0, 0.8, -1.5)),
        (0.7, (0, -0.8, 1.5)),
        (1, (0, 0, 0)),
    ],
    'nervous': [(0.1, (0.8 * (-1) ** k, 0.5 * (-1) ** (k // 2), 0)) for k in range(20)],
}


@pytest.mark.parametrize('name', COMMANDS)
def test_no_standing_foot_slips_on_the_level(name, legs):
    poses, _ = walk(COMMANDS[name], legs=legs)
    assert slips(poses, legs).max() < 0.005
    heights = np.array([true_feet(at, legs)[:, 2] for at in poses])
    standing = np.array([at.standing for at in poses])
    assert np.abs(heights[standing] - legs.foot_radius).max() < 1e-3
    assert heights.min() > legs.foot_radius - 1e-3
    # The trunk keeps its height and stays level.
    assert np.ptp([at.position[2] for at in poses]) < 1e-9
    assert np.abs([at.rpy[:2] for at in poses]).max() < 1e-9
    angles = np.array([at.angles for at in poses])
    assert (angles >= legs.lower - 1e-9).all()
    assert (angles <= legs.upper + 1e-9).all()


def test_diagonal_legs_move_together():
    poses, _ = walk([(4, (0.6, 0, 0))])
    standing = np.array([at.standing for at in poses])
    right_front, left_front, right_rear, left_rear = standing.T
    np.testing.assert_array_equal(right_front, left_rear)
    np.testing.assert_array_equal(left_front, right_rear)
    assert (right_front | left_front).all()  # one diagonal or both, never in flight
    walking = standing[RATE:]
    assert walking[:, 0].mean() == pytest.approx(GAIT.duty, abs=0.03)
    steps = np.flatnonzero(np.diff(walking[:, 0].astype(int)) == 1)
    assert np.diff(steps).mean() / RATE == pytest.approx(GAIT.period, rel=0.05)
    lifted = np.array([true_feet(at)[:, 2] for at in poses]).max(axis=0) - GO1.foot_radius
    assert (lifted > 0.04).all()
    # Smooth: no foot is faster than a leg can be, and the trunk moves evenly.
    paths = np.array([true_feet(at) for at in poses])
    assert np.linalg.norm(np.diff(paths, axis=0), axis=2).max() * RATE < 8.0
    assert np.abs(np.diff([at.position[0] for at in poses[RATE:]]) * RATE - 0.6).max() < 1e-6


@pytest.mark.parametrize(
    ('command', 'limit'),
    [
        ((3, 4, 0), (0.6 * GAIT.max_speed, 0.8 * GAIT.max_speed, 0)),
        ((0, 0, 9), (0, 0, GAIT.max_turn)),
        ((0.3, 0.1, 0.7), (0.3, 0.1, 0.7)),
    ],
)
def test_the_robot_walks_at_the_commanded_speed_up_to_its_limits(command, limit):
    _, states = walk([(4, command)])
    first, last = states[2 * RATE], states[-1]
    np.testing.assert_allclose(last.velocity, limit, atol=1e-9)
    assert last.yaw - first.yaw == pytest.approx(2 * limit[2], rel=1e-6, abs=1e-9)
    if limit[2] == 0:
        moved = last.position - first.position
        np.testing.assert_allclose(moved, 2 * np.array(limit[:2]), atol=1e-6)


def test_after_stopping_the_feet_stand_under_the_hips():
    poses, states = walk([(2.13, (0.8, 0.2, 1.0)), (3, (0, 0, 0))])
    stop = round(2.13 * RATE)
    # Braking takes a fifth of a second, putting the feet back two steps more.
    still = states[stop + round(0.4 * RATE)]
    assert not still.velocity.any()
    np.testing.assert_array_equal(still.position, states[-1].position)
    rest = poses[stop + round(1.5 * GAIT.period * RATE) + 15 :]
    assert all(at.standing.all() for at in rest)
    np.testing.assert_array_equal(rest[0].angles, rest[-1].angles)
    np.testing.assert_allclose(rest[-1].angles, np.tile([0, 0.9, -1.8], (4, 1)), atol=1e-6)
    assert slips(poses).max() < 0.005


@pytest.mark.parametrize('robot', ['go1', 'go2'])
def test_thirty_seconds_over_the_stairs(robot):
    world = Walker('stairs', robot)
    deepest, tops, tilts, reached = 0.0, [], [], 0.0
    for k in range(900):
        world.walk((0.25, 0.0, 0.0))
        if k % 3 == 0:
            deepest = max(deepest, world.depth_of_feet())
        under = world.ground.heights(world.pose.position[:2], world.pose.position[2])
        tops.append(world.pose.position[2] - under)
        tilts.append(world.pose.rpy[1])
        reached = max(reached, world.pose.missed[world.pose.standing].max())
    assert deepest < 0.01
    assert reached < 0.002
    assert world.pose.position[0] > 7.0  # up, along and down
    assert min(tops) > 0.15
    assert max(tops) < 0.42
    assert min(tilts) < -0.2  # nose up
    assert max(tilts) > 0.2  # nose down
    assert np.abs(tilts).max() < 0.41
    assert np.abs(np.diff(tilts)).max() < 0.06
    assert world.pose.position[2] == pytest.approx(world.robot.legs.standing_height, abs=1e-6)


def test_feet_avoid_rubble_and_the_robot_turns_on_stairs():
    for scene, command in (('rubble', (0.4, 0.0, 0.1)), ('stairs', (0.3, 0.0, 0.4))):
        world = Walker(scene)
        deepest = 0.0
        for k in range(240):
            turn = np.array([1.0, 1.0, (-1.0) ** (k // 60)])
            world.walk(np.array(command) * turn)
            if k % 3 == 0:
                deepest = max(deepest, world.depth_of_feet())
        assert deepest < 0.01
        assert world.pose.position[0] > 1.5


@pytest.mark.parametrize(
    ('scene', 'rate', 'least', 'most'),
    [*(('corner', rate, 0.8, 1.2) for rate in (60, 5, 1, 0.4)), ('board', 30, 0.0, 0.2)],
)
def test_walls_and_drops_stop_it_however_long_a_step_is(scene, rate, least, most):
    """A wall is ahead in the corner; the board's scene is a pedestal, which ends."""
    world = Walker(scene)
    for _ in range(round(6 * rate)):
        world.walk((0.8, 0.0, 0.0), 1 / rate)
        assert 0.0 <= world.pose.position[0] < most
    assert world.state.blocked
    reached = world.pose.position[0]
    assert reached >= least
    if scene == 'corner':
        for _ in range(15):
            world.walk((-0.2, 0.0, 0.0))
        assert not world.state.blocked
        assert world.pose.position[0] < reached
