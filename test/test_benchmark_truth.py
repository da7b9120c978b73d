"""Where an effect acts, as the benchmark's scorer sees it, on effects whose place is known."""

import numpy as np
import pytest
from study.benchmark.overlap import overlap
from study.benchmark.partition import COVARIATES
from study.benchmark.truth import Comparison
from study.blind import BlindCamera, Case, SceneKey, SceneSet
from study.blind.frame import Effect

KEY = SceneKey('Mode_5_30fps', 7, 2.0, 112, 86, recordings=4, frames=8)
SCENES = SceneSet(KEY)
DISTANCE = COVARIATES.index('distance')


class Moved(Effect):
    """Depth of some pixels is 50 mm too large; nothing else changes."""

    def __init__(self, farthest, recordings):
        """Choose pixels nearer than this (metres), in the first recordings."""
        super().__init__(1.0, np.random.default_rng(0), SCENES.optics)
        self._farthest, self._recordings = farthest, recordings

    def report(self, frame):
        """Move the depth."""
        if frame.recording < self._recordings:
            frame.depth[frame.view.depth < self._farthest] += np.float32(0.05)


def affected(effects, *more):
    camera = BlindCamera(Case(KEY, effects, 3), SCENES)
    camera.effects += more
    comparison = Comparison(camera)
    for recording in range(KEY.recordings):
        for frame in camera.frames(recording):
            comparison.watch(recording, frame)
    return comparison.affected()


@pytest.fixture(scope='module')
def first_two():
    return affected({}, Moved(np.inf, 2))


@pytest.mark.parametrize(
    ('first', 'last', 'score'),
    [(0, 1, 1.0), (0, 0, 0.5), (1, 2, 1 / 3), (0, 3, 0.5), (2, 3, 0.0)],
    ids=['exactly', 'half of them', 'half of them and as many others', 'twice as many', 'others'],
)
def test_named_pixels_are_compared_with_the_affected_ones(first_two, first, last, score):
    where = [{'covariate': 'recording', 'low': first, 'high': last, 'unit': ''}]
    # Recordings have about the same number of pixels with a return.
    assert overlap(where, first_two) == pytest.approx(score, abs=0.02)


def test_pixels_across_a_limit_that_the_scorer_does_not_know():
    near = affected({}, Moved(2.0, KEY.recordings))
    # Cells across the limit count as affected as a whole: 6 % of the pixels at this resolution.
    where = [{'covariate': 'distance', 'low': 0.0, 'high': 2.0, 'unit': 'm'}]
    assert overlap(where, near) > 0.9


def test_a_camera_without_effects_is_affected_nowhere():
    # Errors of pose and of sigma are the same in both cameras.
    assert not affected({})['affected'].any()


def test_saturation_affects_near_pixels_only():
    found = affected({'saturation': 1.0})
    distance = found['samples'][:, DISTANCE]
    assert 0 < found['affected'].mean() < 0.4
    assert np.median(distance[found['affected']]) < np.median(distance[~found['affected']])
