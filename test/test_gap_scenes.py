"""Scenes to record, computed from panels."""

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.gap.planning.scenes import card, PlannedScene, render, wall
import numpy as np
import pytest

STAMP = np.arange(4) / 30
HAND = card(0.6, -0.1, 0.08, 0.5, (0.5, 0.0, 0.0))
SCENES = {
    scene.name: scene
    for scene in (
        PlannedScene('wall', (wall(2.0),)),
        PlannedScene('tilted', (wall(3.0, tilt=40.0),)),
        PlannedScene('corner', (wall(1.5, tilt=45.0), wall(1.5, tilt=-45.0))),
        PlannedScene('box', (wall(1.3), card(1.0, -0.4, 0.4, 0.6))),
        PlannedScene('hand', (wall(1.5), HAND)),
        PlannedScene('panning', (wall(1.5), card(0.8, 0.0, 0.15, 0.6)), turn_rate=40.0),
    )
}


def test_rendered_depth_agrees_with_the_scenes_description():
    lens = flexx2().intrinsics
    depth = {name: render(scene, lens, STAMP)[0] for name, scene in SCENES.items()}
    assert np.allclose(depth['wall'], 2.0)
    x = (np.arange(lens.width) - lens.cx) / lens.fx
    tilted = 3.0 / (1 - np.tan(np.radians(40)) * x)
    assert np.allclose(depth['tilted'], tilted, rtol=1e-6)
    middle = depth['corner'][86]
    assert middle.argmax() in (111, 112)
    assert middle.max() == pytest.approx(1.5, abs=0.01)
    assert set(np.unique(depth['box'])) == {np.float32(1.0), np.float32(1.3)}
    hand = depth['hand'] < 1
    places = [np.flatnonzero(row[86]).mean() for row in hand]
    speed = 0.5 * lens.fx / 0.6 / 30  # pixels a frame
    assert np.diff(places) == pytest.approx(speed, abs=1.0)
    assert (np.diff([np.flatnonzero(row[86] < 1.2).mean() for row in depth['panning']]) < 0).all()


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
def test_every_visible_surface_has_a_reflectivity(scene):
    depth, reflectivity = render(scene, flexx2().intrinsics, STAMP)
    assert depth.shape == reflectivity.shape
    assert depth.ndim == (3 if scene.moving else 2)
    assert (np.isfinite(depth) == (reflectivity > 0)).all()
