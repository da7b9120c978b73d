"""What reads depth on a robot: each consumer on scenes whose answer is known."""

from dataclasses import replace
import math

from flexx2_sim_ros.batch.height_grid import HeightGrid as BatchHeightGrid
from flexx2_sim_ros.consumers import CameraView
from flexx2_sim_ros.consumers.elevation_map import ElevationMap
from flexx2_sim_ros.consumers.ground import best_centre, find_ground, mounted
from flexx2_sim_ros.consumers.height_grid import edge_error, height_errors, HeightGrid
from flexx2_sim_ros.consumers.obstacle import NearestObstacle
from flexx2_sim_ros.consumers.occupancy_map import OccupancyMap
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np
import pytest
import warp as wp

MODE = flexx2().mode('Mode_9_30fps')
LENS = Intrinsics.from_field_of_view(224, 172, 56.0, 44.0)
HEIGHT, PITCH = 0.6, 35.0


def look(step=0.0, wall=9.0, start=0.9):
    """Return what a camera sees of the ground, a step up at x = start, and a wall at x = wall."""
    standing = mounted(HEIGHT, PITCH)
    view = CameraView(
        np.ones((1, 172, 224), np.float32), LENS, MODE, standing.rotation, standing.position, None
    )
    rays = view.directions()
    with np.errstate(divide='ignore', invalid='ignore'):
        ground = np.where(rays[..., 2] < 0, -HEIGHT / rays[..., 2], np.inf)
        top = np.where(rays[..., 2] < 0, (step - HEIGHT) / rays[..., 2], np.inf)
        front, wall_at = start / rays[..., 0], wall / rays[..., 0]
    risen = top * rays[..., 0] >= start
    riser = ~risen & (ground * rays[..., 0] > start)
    depth = np.where(risen, top, np.where(riser, front, ground))
    depth = np.minimum(depth, wall_at).astype(np.float32)[None]
    view = replace(view, depth=np.where(depth < 5, depth, np.float32(np.nan)))
    return replace(view, centre=best_centre(view.points(0)))


def test_the_ground_is_found_below_a_tilted_camera():
    view = look(step=0.12, start=1.2)
    found = find_ground(view.depth[0], LENS, MODE.sensor)
    np.testing.assert_allclose(found.rotation, view.rotation, atol=0.01)
    np.testing.assert_allclose(found.position, view.position, atol=0.01)
    assert find_ground(np.full((172, 224), 1.5, np.float32), LENS, MODE.sensor) is None


def test_the_height_grid_is_that_of_the_batch():
    view = look(step=0.1)
    assert view.centre is not None
    own = HeightGrid().look(view)
    batch = BatchHeightGrid(1, LENS, 'cpu')
    position = view.position - [view.centre, 0, 0]
    batch.add(wp.array(view.depth, device='cpu'), position[None], view.rotation[None])
    np.testing.assert_allclose(own, batch.heights().numpy()[0], atol=1e-5)
    assert np.isfinite(own).mean() > 0.8


@pytest.mark.parametrize('consumer', [HeightGrid(), ElevationMap()])
def test_maps_measure_a_shift_and_holes(consumer):
    true, low = look(), look(step=-0.03, start=0.0)
    assert (low.points(0)[:, 2] < -0.02).all()
    low = replace(low, centre=true.centre)
    seen, real = consumer.look(low), consumer.look(true)
    errors = consumer.errors(seen, real)
    assert errors['height_error'] == pytest.approx(30, abs=1)
    assert errors['invented_steps'] == errors['missed_steps'] == 0
    assert consumer.picture(seen, real).shape == (11, 7) or isinstance(consumer, ElevationMap)
    holes = true.depth.copy()
    holes[:, :, :112] = np.nan
    errors = consumer.errors(consumer.look(replace(true, depth=holes)), real)
    assert errors['cells_without_data'] == pytest.approx(50, abs=8)
    assert errors['height_error'] < 1


def test_steps_are_missed_and_invented():
    flat, step = look(), look(step=0.12)
    step = replace(step, centre=flat.centre)
    grid = HeightGrid()
    missed = grid.errors(grid.look(flat), grid.look(step))
    invented = grid.errors(grid.look(step), grid.look(flat))
    assert missed['missed_steps'] > 0
    assert missed['invented_steps'] == 0
    assert invented['invented_steps'] == missed['missed_steps']


def test_the_edge_of_a_step_is_measured_within_a_cell():
    def profile(edge):
        return np.clip((np.arange(20)[:, None] - edge) / 0.8, 0, 1) * 0.1 * np.ones((1, 4))

    assert edge_error(profile(9.6), profile(9.1), 0.04) == pytest.approx(20, abs=1)
    assert edge_error(profile(9.1), profile(9.1), 0.04) == pytest.approx(0, abs=1e-6)
    assert edge_error(np.zeros((20, 4)), np.zeros((20, 4)), 0.04) is None
    assert height_errors(np.zeros((2, 2)), np.full((2, 2), np.nan)) == {}


def test_voxels_of_a_shifted_wall_are_wrong():
    pytest.importorskip('pyoctomap')
    consumer = OccupancyMap()
    true, behind, before = (consumer.look(look(wall=x)) for x in (1.0, 1.4, 0.7))
    assert consumer.errors(true, true) == {'wrongly_occupied': 0, 'wrongly_free': 0}
    assert consumer.errors(behind, true)['wrongly_free'] > 50
    assert consumer.errors(before, true)['wrongly_occupied'] > 50


def test_the_nearest_obstacle_is_found():
    consumer = NearestObstacle()
    true, near, none = (consumer.look(look(wall=x)) for x in (1.0, 0.9, 9.0))
    assert true.distance == pytest.approx(1.0, abs=0.01)
    assert true.tilt == pytest.approx(0, abs=0.5)  # the foot of the wall is near the ground
    assert true.height == pytest.approx(0, abs=0.005)
    assert consumer.errors(near, true)['distance_error'] == pytest.approx(100, abs=10)
    assert consumer.errors(near, true)['wrong_presence'] == 0
    assert math.isinf(none.distance[0])
    assert consumer.errors(none, true)['wrong_presence'] == 100
