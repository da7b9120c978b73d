"""Scenes to record, computed from words."""

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.gap.planning.scenes import render, Scene, standard_scenes
import numpy as np
import pytest

RANGE = 4.0
STAMP = np.arange(4) / 30


@pytest.fixture(scope='module')
def scenes() -> dict[str, Scene]:
    return {scene.name: scene for scene in standard_scenes(flexx2(), RANGE)}


def test_depth_is_what_the_words_say(scenes: dict[str, Scene]) -> None:
    lens = flexx2().intrinsics
    depth = {name: render(scene, lens, STAMP)[0] for name, scene in scenes.items()}
    assert np.allclose(depth['wall_2m'], 2.0)
    x = (np.arange(lens.width) - lens.cx) / lens.fx
    tilted = 3.0 / (1 - np.tan(np.radians(40)) * x)
    assert np.allclose(depth['tilted_wall_3m'], tilted, rtol=1e-6)
    middle = depth['corner'][86]
    assert middle.argmax() in (111, 112)
    assert middle.max() == pytest.approx(1.5, abs=0.01)
    assert set(np.unique(depth['box_30cm'])) == {np.float32(1.0), np.float32(1.3)}
    hand = depth['moving_hand'] < 1
    places = [np.flatnonzero(row[86]).mean() for row in hand]
    speed = 0.5 * lens.fx / 0.6 / 30  # pixels a frame
    assert np.diff(places) == pytest.approx(speed, abs=1.0)
    assert (np.diff([np.flatnonzero(row[86] < 1.2).mean() for row in depth['panning']]) < 0).all()


def test_all_that_is_seen_reflects_light(scenes: dict[str, Scene]) -> None:
    for scene in scenes.values():
        depth, reflectivity = render(scene, flexx2().intrinsics, STAMP)
        assert depth.shape == reflectivity.shape
        assert depth.ndim == (3 if scene.moving else 2)
        assert (np.isfinite(depth) == (reflectivity > 0)).all()


def test_walls_are_within_the_range() -> None:
    short = standard_scenes(flexx2(), 1.2)
    assert [scene.name for scene in short if scene.name.startswith('wall')] == [
        'wall_0.5m',
        'wall_1m',
    ]
