"""The duration of raw frames is fitted beside the poses of moving recordings, which hide it."""

from dataclasses import replace

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.forms.scale import fit_scale, pose_width, ScaleColumns
from named_forms import fitted_forms
import numpy as np
import pytest

EFFECT = 'motion_artefact'
COUNT = 400
POSE, PRIOR = 0.002, 0.010  # metres: of the poses, and as a user says
SHIFT = 0.008  # metres at a scale of 1


def make_samples(rng, scale, moving):
    """Return samples of a camera that moved evenly, so that the effect is almost another pose."""
    own = np.zeros((6, COUNT))
    own[0] = 1.0
    error = own[0] * POSE * rng.standard_normal() + 1e-4 * rng.standard_normal(COUNT)
    x = np.linspace(-1, 1, COUNT)
    return Samples(
        np.zeros(6),
        error + scale * SHIFT * moving,
        np.full(COUNT, 1e-3),
        own,
        np.diag([PRIOR, 0, 0, 0, 0, 0]),
        np.ones(COUNT),
        2 + x,
        x,
        x,
        np.arange(COUNT),
    )


def make_columns(moving, edges=0):
    """Return the shifts of the two variants, in opposite directions, some of them at edges."""
    shift = np.full(COUNT, SHIFT * moving)
    surfaces = np.arange(COUNT) >= edges
    shift[:edges] = 0.3
    return ScaleColumns((-shift, shift), surfaces)


@pytest.mark.parametrize('edges', [0, 40])
def test_recordings_whose_poses_are_farther_off_show_an_effect(edges):
    """
    Assert size and variant.

    The poses of twelve moving recordings leave the scale uncertain by 0.002 / 0.008 / sqrt(12) =
    0.07; it is 1. It is off by 0.5 with a probability below 1e-11.
    """
    rng = np.random.default_rng(11)
    moving = [True] * 12 + [False] * 24
    samples = [make_samples(rng, 1.0, one) for one in moving]
    columns = [make_columns(one, edges * one) for one in moving]
    width = pose_width(samples, columns)
    # As wide as the still ones are, of which there are 24: off by 0.7 below 1e-6 (chi squared).
    assert PRIOR * width == pytest.approx(POSE, rel=0.7)
    usual = [replace(one, spread=width * one.spread) for one in samples]
    together, *without = fit_scale(EFFECT, usual, columns)
    assert len(without) == len(samples)
    for one in (together, *without):
        assert one['stamp_at'] == 0.0
        assert one['stretch'] == pytest.approx(1.0, abs=0.5)
    # Still recordings have no part in it.
    assert without[-1] == together != without[0]


def test_too_few_still_recordings_say_nothing_of_the_poses():
    rng = np.random.default_rng(12)
    samples = [make_samples(rng, 0.0, moving) for moving in (True, True, False, False)]
    columns = [make_columns(moving) for moving in (True, True, False, False)]
    assert pose_width(samples, columns) == 1.0


def test_the_stamp_of_raw_frames_is_found_from_a_diagnosis_with_the_other_one(tmp_path):
    camera = {EFFECT: {'stretch': 2.5, 'stamp_at': 0.0}}
    size = {'recordings': 10, 'frames': 8, 'scale': 0.4, 'moving': 6}
    write_campaign(tmp_path, seed=141, effects=camera, **size)
    found = fitted_forms(tmp_path, {EFFECT: {'stretch': 0.6, 'stamp_at': 1.0}})
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.proposal.label == 'duration of the raw frames, and the stamp'
    assert one.proposal.together['stamp_at'] == 0.0
    assert one.proposal.together['stretch'] == pytest.approx(2.5, abs=0.8)


def test_still_recordings_leave_raw_frames_as_diagnosed(tmp_path):
    size = {'recordings': 3, 'frames': 2, 'scale': 0.15, 'moving': 0}
    write_campaign(tmp_path, seed=151, **size)
    found = fitted_forms(tmp_path, {EFFECT: {'stretch': 0.6}})
    assert not found.explained.verdicts


def test_directions_that_still_scenes_leave_open_do_not_widen_the_poses():
    """Assert it of walls that say nothing of five of six parts of a pose."""
    rng = np.random.default_rng(13)
    samples = [
        replace(make_samples(rng, 0.0, False), spread=np.diag([PRIOR] * 6)) for _ in range(24)
    ]
    assert PRIOR * pose_width(samples, [make_columns(False)] * 24) < 0.5 * PRIOR
