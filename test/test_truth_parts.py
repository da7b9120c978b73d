"""Parts of the registration to a room, on small rooms that are made up."""

from pathlib import Path

from flexx2_sim_ros.truth.alignment import align, AlignedPixels, AlignedPose, choose
from flexx2_sim_ros.truth.columns import ErrorColumns
from flexx2_sim_ros.truth.joint import PosedImage, Solution
from flexx2_sim_ros.truth.observation import Observation
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.rooms import MeshRoom
from flexx2_sim_ros.truth.search import _shaken
from flexx2_sim_ros.truth.shared import _hidden_by_bounce
import numpy as np
import pytest
import trimesh

TRUE = Pose(np.eye(3), np.array([0.1, -0.2, -1.0]))


@pytest.fixture
def room() -> MeshRoom:
    """Return a box of 4 x 3 x 5 m with a smaller one on its far wall."""
    parts = [((4, 3, 5), (0, 0, 0)), ((0.8, 0.6, 1.0), (0.5, 0.4, 2.0))]
    boxes = [trimesh.creation.box(size).apply_translation(at) for size, at in parts]
    triangles = np.concatenate([box.triangles for box in boxes])
    return MeshRoom(triangles, None, np.zeros(len(triangles), bool))


@pytest.fixture
def image(room: MeshRoom) -> Observation:
    v, u = np.mgrid[:43, :56]
    rays = np.stack([(u - 27.5) / 46, (v - 21) / 46], axis=-1)
    depth = room.cast(TRUE, rays.reshape(-1, 2)).depth.reshape(43, 56)
    return Observation(rays, depth, np.full(depth.shape, 0.002), ())


def off(fit: AlignedPose) -> float:
    return float(np.abs(TRUE.motion_to(fit.pose)).max())


def test_shaking_finds_a_better_pose_nearby(room: MeshRoom, image: Observation) -> None:
    wrong = TRUE.moved(np.array([0.14, 0, 0, 0, np.radians(-6), 0]))
    stuck = align(room, choose(image, 400), wrong, 3, 0.1)
    assert off(stuck) > 0.02
    assert off(_shaken(room, image, stuck)) < 0.001


def test_shaking_keeps_the_best_pose(room: MeshRoom, image: Observation) -> None:
    best = AlignedPose(TRUE, 0.0)
    assert _shaken(room, image, best) is best


@pytest.mark.parametrize(
    ('bias', 'said'),
    [(0.004, 'bounced light adds 6 mm; a smaller offset'), (-0.004, 'adds 6 mm'), (0.007, '')],
)
def test_bounced_light_hides_an_offset_that_is_smaller(bias: float, said: str) -> None:
    pixels = AlignedPixels(np.zeros((4, 2)), *np.ones((3, 4)), (), *np.zeros((2, 4), int))
    views = [
        PosedImage(0, Path(), pixels, TRUE, bounce)
        for bounce in (np.array([0.02, -0.01, 0.0, 0.01]), np.full(4, 0.03))
    ]
    # A mean of 20 mm, of which the gain is 0.3.
    values = np.array([bias, 0.3])
    solution = Solution(ErrorColumns(), values, 0 * values, 1.0, tuple(views), (), (), 1)
    found = _hidden_by_bounce(solution)
    assert said in found
    assert bool(found) == bool(said)
