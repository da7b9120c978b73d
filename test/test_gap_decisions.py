"""The rule of the verdict: what it says, how it is fitted, and how often it is right."""

from dataclasses import replace

from bench.decision_fit import calibrate, campaign, DiagnosedCampaign
from bench.decision_lines import keep, KEPT, kept_arguments
from bench.journal import entries
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.decisions import calibrated, FILE, Margin, read_decisions
from flexx2_sim_ros.gap.inference.probability import gap_evidence, judge, p_value
from flexx2_sim_ros.gap.inference.support import EffectSupport, Support
from flexx2_sim_ros.paths import config_dir
import numpy as np
import pytest
from study.benchmark.reliability import calibration_error
import yaml


def support(excess, gain, rival, t):
    """Return the evidence of six recordings for an offset, with one rival."""
    offset = EffectSupport('offset', gain, t)
    other = EffectSupport('wiggling', rival, t * (gain - rival) / max(gain, 0.1))
    left = max(excess - gain, 0.0)
    improved = (gain + 0.5,) * 6
    return Support(
        6, 1e5, excess, left, gain, t, 0.1, improved, (offset,), (offset, other), (other,)
    )


def with_thresholds(**values):
    """Return the calibrated rule with some other thresholds of a gap."""
    return replace(calibrated(), thresholds=replace(calibrated().thresholds, **values))


def test_more_evidence_makes_an_effect_more_probable():
    rule = calibrated()
    nothing = judge(support(0.5, -0.3, -0.4, 0.1), rule)
    weak = judge(support(4.0, 1.5, 0.5, 1.5), rule)
    clear = judge(support(60.0, 50.0, 10.0, 8.0), rule)
    assert nothing.gap < weak.gap < clear.gap
    assert nothing.effects['offset'] < weak.effects['offset'] < clear.effects['offset']
    assert nothing.verdict == 'none'
    assert clear.verdict == 'identified'
    assert clear.effects['offset'] > 0.9 > 0.1 > clear.effects['wiggling']


def test_a_gain_in_all_recordings_is_a_gap_where_no_loss_is_in_excess():
    """Assert it of walls, whose own poses and few features leave none."""
    walls = replace(support(0.0, 4.0, 3.5, 8.0), left=-4.5, improved=(4.5,) * 6)
    assert judge(walls, calibrated()).verdict == 'identified'
    for other in (replace(walls, t=1.0), replace(walls, gain=-0.5, improved=(0.0,) * 6)):
        assert judge(other, calibrated()).verdict == 'none'


def test_a_large_gap_that_nothing_explains_is_unknown():
    rule = with_thresholds(
        probability=0.99, excess=10.0, excess_per_scatter=0.0, excess_per_fewer=0.0
    )
    assert judge(support(9.9, 0.1, 0.0, 0.5), rule).verdict == 'none'
    assert judge(support(10.1, 0.1, 0.0, 0.5), rule).verdict == 'unknown'


def test_the_same_loss_says_less_in_small_images():
    rule = calibrated()
    depths = rule.thresholds.most_depths
    least = rule.thresholds.excess_from(scatter=0.1, depths=depths)
    large = replace(support(least + 0.1, 0.1, 0.0, 0.5), depths=depths)
    assert judge(large, rule).verdict == 'unknown'
    assert judge(replace(large, depths=large.depths / 50), rule).verdict == 'none'
    # No campaign had more: the thresholds do not fall further.
    for excess in (least - 0.5, least + 0.1):
        some = replace(large, excess=excess, left=excess)
        more = replace(some, depths=100 * large.depths)
        assert judge(more, rule).verdict == judge(some, rule).verdict


def test_effects_that_leave_a_large_gap_explain_it_partly():
    rule = with_thresholds(
        probability=0.99, excess=10.0, excess_per_scatter=0.0, excess_per_fewer=0.0
    )
    clear = support(40.0, 28.0, 1.0, 10.0)
    assert judge(replace(clear, left=22.0), rule).verdict == 'partly'
    assert judge(replace(clear, left=9.9), rule).verdict == 'identified'


def test_effects_that_are_less_probable_than_not_explain_a_gap_partly():
    rule = replace(with_thresholds(probability=0.0), least_effect=0.0)
    noise = (EffectSupport('excess_noise', 0.6, 0.3),)
    weak = replace(support(5.0, 0.6, 0.5, 0.3), left=3.0, chosen=noise)
    clear = support(60.0, 50.0, 10.0, 8.0)
    assert judge(weak, rule).effects['excess_noise'] < 0.5 < judge(clear, rule).effects['offset']
    assert judge(weak, rule).verdict == 'partly'
    assert judge(clear, rule).verdict == 'identified'


def test_wrong_poses_leave_a_loss_that_is_no_gap():
    rule = with_thresholds(
        probability=0.999, excess=5.0, excess_per_scatter=20.0, excess_per_fewer=0.0
    )
    nothing = support(10.0, 0.1, 0.0, 0.5)
    assert judge(replace(nothing, scatter=0.2), rule).verdict == 'unknown'
    assert judge(replace(nothing, scatter=0.3), rule).verdict == 'none'


def test_a_pose_error_with_scattered_poses_is_a_gap_although_no_loss_is_left():
    rule = with_thresholds(probability=0.99, excess=10.0)
    one = support(4.0, 1.5, 0.5, 1.5)
    posed = replace(one, chosen=(EffectSupport('pose_error', 1.5, 1.5),))
    assert judge(replace(posed, scatter=0.54), rule).verdict == 'none'
    assert judge(replace(posed, scatter=0.56), rule).verdict == 'identified'
    # As wrong as expected: an exact prior of the poses alone is no gap.
    considered = (*one.considered, EffectSupport('pose_error', 0.0, 0.0))
    other = replace(one, considered=considered, scatter=0.61)
    assert judge(other, rule).verdict == 'none'
    # A pose error that may not be named is one that nothing explains.
    left_out = replace(support(4.0, 0.1, 0.0, 0.5), scatter=0.61)
    assert judge(left_out, rule).verdict == 'unknown'


def test_intervals_are_widened_by_the_margin_of_their_group():
    few, large = Margin('partly', 4, 0.0, 0.2), Margin('partly', 100, 4e5, 0.1)
    many = Margin('partly', 100, 0.0, -0.3)
    rule = replace(calibrated(), margins=(few, large, many))
    assert rule.widened([0.4, 0.6], 0.5, 'partly', 4, 1e5) == pytest.approx([0.2, 0.8])
    assert rule.widened(None, 0.9, 'partly', 2, 8e5) == pytest.approx([0.7, 1.0])
    assert rule.widened([0.4, 0.6], 0.5, 'partly', 5, 8e5) == pytest.approx([0.3, 0.7])
    # A margin below zero makes the interval narrower, but the prediction stays in it.
    assert rule.widened([0.3, 0.9], 0.5, 'partly', 5, 1e5) == pytest.approx([0.5, 0.6])
    assert rule.widened([0.4, 0.6], 0.5, 'identified', 5, 1e5) is None
    # Nothing is known of large campaigns: the margin of small ones is not theirs.
    rule = replace(rule, margins=(few, replace(large, margin=None), many))
    assert rule.widened([0.4, 0.6], 0.5, 'partly', 5, 8e5) is None


@pytest.mark.parametrize(
    ('part', 'value'), [('gap', None), ('effect', {'threshold': float('nan')}), ('reduction', 3)]
)
def test_a_damaged_rule_is_an_error_that_names_the_file(part, value, tmp_path):
    table = yaml.safe_load((config_dir() / FILE).read_text())
    path = tmp_path / 'rule.yaml'
    path.write_text(yaml.safe_dump({**table, part: value}))
    with pytest.raises(InputError, match='rule.yaml: must be written by python -m bench'):
        read_decisions(path)


def made(rng, count):
    """Return campaigns of a made-up world: half without effect, one in six of a hidden cause."""
    out = []
    for k in range(count):
        kind = rng.choice(['none', 'offset', 'hidden'], p=[0.5, 0.4, 0.1])
        size = 0.0 if kind == 'none' else float(rng.exponential(6.0))
        gain = (0.8 if kind == 'offset' else 0.2) * size + float(rng.normal(0, 0.6))
        rival = (0.3 if kind == 'offset' else 0.2) * size + float(rng.normal(0, 0.6))
        excess = size + float(rng.normal(0, 0.8))
        evidence = support(excess, gain, rival, gain + float(rng.normal(0, 0.5)))
        both = ('offset', 'wiggling') if k % 20 == 0 else ('offset',)  # A rival can be true too.
        true = frozenset(both if kind == 'offset' else ())
        out.append(
            DiagnosedCampaign(
                {'group': kind, 'pose_mm': 0.0},
                {},
                evidence,
                true,
                kind != 'none',
                kind == 'offset',
                None,
            )
        )
    return out


def test_the_rule_is_what_the_kept_campaigns_give(tmp_path):
    """Assert it of nearly all verdicts: the last digits of a fit depend on the machine."""
    campaigns = [campaign(line) for line in entries(KEPT)]
    assert len(campaigns) == yaml.safe_load((config_dir() / FILE).read_text())['campaigns']
    rule, shipped = calibrate(campaigns), calibrated()
    same = [
        judge(one.support, rule).verdict == judge(one.support, shipped).verdict
        for one in campaigns
    ]
    assert np.mean(same) > 0.98
    copy = tmp_path / 'lines.jsonl.xz'
    keep(entries(KEPT), kept_arguments(), copy)
    assert entries(copy) == entries(KEPT)
    assert kept_arguments(copy) in (config_dir() / FILE).read_text().replace('\n  ', ' ')


def test_the_p_value_ranks_a_campaign_among_those_without_an_effect():
    """Assert that it is below 0.05 in 5 % of these, each left out, and smaller with an effect."""
    shipped = calibrated()
    campaigns = [campaign(line) for line in entries(KEPT)]

    def score(one):
        return shipped.gap_score(gap_evidence(one), one.depths)

    quiet = sorted((one.support for one in campaigns if not one.present), key=score)
    np.testing.assert_allclose([*map(score, quiet)], shipped.nulls, atol=1e-3)
    left_out = [
        p_value(one, replace(shipped, nulls=shipped.nulls[:k] + shipped.nulls[k + 1 :]))
        for k, one in enumerate(quiet)
    ]
    assert sum(p < 0.05 for p in left_out) == 19  # of 391
    assert np.mean(left_out) == pytest.approx(0.5, abs=0.01)
    effects = [p_value(one.support, shipped) for one in campaigns if one.present]
    assert np.mean(np.array(effects) < 0.05) > 0.6
    assert p_value(support(60.0, 50.0, 10.0, 8.0), shipped) == 1 / (len(quiet) + 1)


def test_a_confidence_that_is_too_high_is_a_calibration_error():
    assert calibration_error([(0.9, True)] * 9 + [(0.9, False)]) == pytest.approx(0.0)
    assert calibration_error([(0.9, True), (0.9, False)] * 5) == pytest.approx(0.4)
