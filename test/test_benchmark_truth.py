"""Where an effect acts, as the benchmark's scorer sees it, on effects whose place is known."""

import numpy as np
import pytest
from study.benchmark.overlap import overlap
from study.benchmark.partition import concavity, COVARIATES, partition_of
from study.benchmark.truth import affected_cells, Comparison
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


def test_noise_alone_affects_no_cell():
    # Two cameras with independent noise and 4000 pixels a cell. The estimate of a cell differs
    # from 0 by more than the tolerance of 0.04 with a probability below 1e-9: its own error is
    # 0.016 before it is shrunk to the mean.
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((20, 2, 50, 200))
    sums = np.zeros((20, 2, 50, 9))
    sums[..., 0] = sums[..., 1] = sums[..., 5] = sums[..., 7] = 200
    sums[..., 2] = errors.sum(-1)
    sums[..., 3] = np.square(errors).sum(-1)
    assert not affected_cells(sums).any()
    # A quarter of the cells with a bias of 0.3 sigma.
    sums[:, 0, :12, 3] += 2 * 0.3 * sums[:, 0, :12, 2] + 200 * 0.3**2
    sums[:, 0, :12, 2] += 200 * 0.3
    sums[:, 0, :12, (6, 8)] += 200 * 0.3**2
    np.testing.assert_array_equal(np.flatnonzero(affected_cells(sums)), np.arange(12))


def test_cells_are_small_and_of_one_recording_and_side_of_an_edge():
    partition = partition_of(SCENES)
    for recording in range(KEY.recordings):
        frames = KEY.frames if SCENES.scenes[recording].path.moving else 1
        start = SCENES.slot(recording, 0)
        cells = partition.cells[start : start + frames]
        number, size = np.unique(cells[cells >= 0], return_counts=True)
        assert size.max() <= 200 * frames
        edge = [SCENES.true_view(recording, i).near_edge for i in range(frames)]
        assert not set(cells[np.array(edge)]) - {-1} & set(cells[~np.array(edge)])
        others = np.delete(partition.cells, np.s_[start : start + frames], axis=0)
        assert not np.isin(number, others).any()


def test_concavity_is_positive_in_corners_only():
    # A wall that meets the floor, one metre below and two metres away; and a lone wall.
    y, x = np.mgrid[-1:1:41j, -1:1:41j]
    floor = y > 0.5
    wall = np.stack([2 * x, 2 * y, np.full_like(x, 2.0)], axis=-1)
    corner = np.where(floor[..., None], wall / (2 * np.maximum(y, 0.5))[..., None], wall)
    normals = np.where(floor[..., None], (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    assert not concavity(wall, np.broadcast_to((0.0, 0.0, -1.0), wall.shape)).any()
    found = concavity(corner, normals)
    assert found[29:32].min() > 0.3
    assert not found[:25].any()
