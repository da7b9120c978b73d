"""Small motions of a camera: what they change, for ground truth and the diagnosis alike."""

from flexx2_sim_ros.effects.pose_error import PoseError
from flexx2_sim_ros.physics.poses import depth_slopes, Pose, ray_slopes
import numpy as np
import pytest

TINY = 1e-6  # metres and radians
AWAY = Pose(np.eye(3), np.zeros(3))

POINTS = np.random.default_rng(1).uniform((-1, -1, 1), (1, 1, 3), (20, 3)).T


def seen(pose):
    """Return x/z, y/z and z of the points as a camera at this pose sees them."""
    x, y, z = pose.R.T @ (POINTS - pose.t[:, None])
    return np.stack([x / z, y / z, z])


@pytest.mark.parametrize('motion', np.eye(6))
def test_slopes_are_those_of_a_camera_that_moves(motion):
    moved, (x, y, z) = AWAY.moved(TINY * motion), seen(AWAY)
    change = (seen(moved) - seen(AWAY))[:2] / TINY
    assert np.einsum('rmn,m->rn', ray_slopes(x, y, z), motion) == pytest.approx(change, abs=1e-4)
    # Along the same ray, the moved camera sees another point of the plane n . X = 1.
    ray, plane = np.stack([x, y, np.ones_like(x)]), np.tile([[0.1], [-0.2], [0.5]], len(z))
    depth = 1 / (plane * ray).sum(axis=0)
    then = (1 - plane[:, 0] @ moved.t) / (plane * (moved.R @ ray)).sum(axis=0)
    found = motion @ depth_slopes(ray, plane, depth)
    assert found == pytest.approx((then - depth) / TINY, abs=1e-4)


def test_a_pose_error_is_the_same_motion():
    metres, degrees = np.array([0.01, -0.02, 0.03]), np.array([4.0, -5.0, 6.0])
    turn, step = PoseError(1.0, *metres, *degrees).motion()
    moved = AWAY.moved(np.concatenate([metres, np.radians(degrees)]))
    assert (turn, step) == (pytest.approx(moved.R), pytest.approx(moved.t))
    assert moved.motion_to(AWAY)[3:] == pytest.approx(-np.radians(degrees))
