"""Parts of the joint fit, on views that are made up."""

from pathlib import Path

from flexx2_sim_ros.truth.alignment import AlignedPixels, ErrorColumns, PosedImage
from flexx2_sim_ros.truth.joint import Solution
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.shared import _hidden_by_bounce
import numpy as np
import pytest


@pytest.mark.parametrize(
    ('bias', 'said'),
    [(0.004, 'bounced light adds 6 mm; a smaller offset'), (-0.004, 'adds 6 mm'), (0.007, '')],
)
def test_bounced_light_hides_an_offset_that_is_smaller(bias, said):
    pixels = AlignedPixels(np.zeros((4, 2)), *np.ones((3, 4)), (), *np.zeros((2, 4), int))
    views = [
        PosedImage(0, Path(), pixels, Pose(np.eye(3), np.zeros(3)), bounce)
        for bounce in (np.array([0.02, -0.01, 0.0, 0.01]), np.full(4, 0.03))
    ]
    # A mean of 20 mm, of which the gain is 0.3.
    values = np.array([bias, 0.3])
    solution = Solution(ErrorColumns(), values, 0 * values, 1.0, tuple(views), (), (), 1)
    found = _hidden_by_bounce(solution)
    assert said in found
    assert bool(found) == bool(said)
