"""Fit the rule of the verdict to simulated campaigns."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

from bench.gap_novel import NAMEABLE
from flexx2_sim_ros.gap.calibration.decisions import (
    Decisions,
    fewer_by,
    GapThresholds,
    Logistic,
    Margin,
    times_odds,
)
from flexx2_sim_ros.gap.inference.probability import (
    agreement,
    effect_evidence,
    explain_little,
    explain_partly,
    EXPLAINED,
    gap_evidence,
    has_gap,
    judge,
)
from flexx2_sim_ros.gap.inference.support import EffectSupport, Support
import numpy as np
from sklearn.linear_model import LogisticRegression, QuantileRegressor
from sklearn.model_selection import cross_val_predict, GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

WRONG = 0.03
FALSE_ALARMS = 0.025  # below the 3 % that are wanted: two thresholds are chosen to find most
FAR_ALARMS = 0.05  # of those whose poses are wrong by `_FAR` or more
_FAR = 5.0  # mm
HELD = 0.9  # intervals of the reduction
COVERED = 0.95  # named effects and alternatives; with fewer, causes are named wrongly more often
_FOLDS = 10
# Chosen effects and others have models of their own, because the same evidence means less where
# an effect was not chosen: with one model the calibration error is 0.10 instead of 0.03. Campaigns
# without a gap have no part in them: they are not asked for effects.
_QUANTILE = 0.9  # over the scatter of wrong poses and the number of depths
POSE_IS_AN_EFFECT = 5.0  # mm; larger errors of the poses are to be named
_MOST_STEPS = 1000  # of the fit of a logistic model; it takes a few hundred
# Groups of campaigns for the margins: largest number of recordings, and how many depths there are
# per recording. 10 frames of the Flexx2 are a large campaign.
_LARGE = 10 * 224 * 172.0
_GROUPS = (4, 0.0, math.inf), (100, _LARGE, math.inf), (100, 0.0, _LARGE)
_FEWEST = 9  # campaigns of a group, for a quantile of 0.9


@dataclass(frozen=True)
class DiagnosedCampaign:
    """
    A diagnosed campaign and what is true.

    * `planned`, `more`: how it was made, see `decision_campaigns.plan`
    * `true`: effects of the catalogue that are present
    * `present`: whether there is any effect, of the catalogue or not
    * `findable`: whether a true effect was in the catalogue of the diagnosis
    * `reduction`: predicted, lower end, upper end, and realised; None where it was not measured
    """

    planned: Mapping[str, Any]
    more: Mapping[str, Any]
    support: Support
    true: frozenset[str]
    present: bool
    findable: bool
    reduction: tuple[float, float, float, float] | None

    @property
    def plain(self):
        """Whether the camera has no effect; its poses may be wrong by any amount."""
        return bool(self.planned['group'] == 'none')


def campaign(line):
    """Read a line of `decision_campaigns.run`."""
    planned, table = line['planned'], line['diagnosis']
    depths = planned['width'] * planned['height'] * planned['frames']
    true = set(planned['effects'])
    if line['more']['novel'] in NAMEABLE:
        true.add(NAMEABLE[line['more']['novel']])
    if planned['pose_mm'] > POSE_IS_AN_EFFECT:
        true.add('pose_error')
    reduction = None
    realised = line['realised']
    if realised is not None and realised['shrink'] is not None:
        gap = table['gap']
        low, high = gap[gap['measured_by']]['shrink_interval'] or [gap['shrink']] * 2
        reduction = gap['shrink'], low, high, min(realised['shrink'], 1.0)
    return DiagnosedCampaign(
        planned,
        line['more'],
        support_from({'depths': depths, **table['evidence']}),  # Earlier lines lack them.
        frozenset(true),
        bool(true or line['more']['novel']),
        bool(true - set(planned['without'])),
        reduction,
    )


def support_from(table):
    """Return the evidence that `Support.as_table` wrote."""
    rows = {
        name: tuple(EffectSupport(**one) for one in table[name])
        for name in ('chosen', 'considered', 'rivals')
    }
    return Support(**{**table, **rows, 'improved': tuple(table['improved'])})


def calibrate(campaigns):
    """
    Fit the rule.

    Probabilities are logistic models. Their thresholds are set on predictions of
    cross-validation: the smallest with which at most `FALSE_ALARMS` of the campaigns without an
    effect have a gap, by probability or excess loss, `FAR_ALARMS` of those with poses wrong by
    `_FAR`, none of these by agreement, and at most `WRONG` of all others are named wrongly.
    Alternatives and intervals are split-conformal
    (Angelopoulos and Bates, A gentle introduction to conformal prediction, 2021): the quantile
    holds in `COVERED` or `HELD` of further ones.
    """
    rows = [gap_evidence(one.support) for one in campaigns]
    gap, gap_odds = _logistic(rows, [one.present for one in campaigns], range(len(rows)))
    rule = Decisions(
        gap,
        effect=Logistic(0.0, {}),
        rival=Logistic(0.0, {}),
        thresholds=_thresholds(campaigns, gap_odds),
        least_effect=0.0,
        least_alternative=0.0,
        margins=(),
    )
    found = [
        one for one, p in zip(campaigns, gap_odds, strict=True) if has_gap(one.support, p, rule)
    ]
    rows_of = [effect_evidence(one.support) for one in found]
    effect, of_chosen = _of_effects(found, [chosen for chosen, _ in rows_of])
    rival, of_rivals = _of_effects(found, [rivals for _, rivals in rows_of])
    rule = replace(rule, effect=effect, rival=rival)
    gaps = [
        (one, chosen | rivals)
        for one, chosen, rivals in zip(found, of_chosen, of_rivals, strict=True)
    ]
    count = sum(one.present for one in campaigns)
    rule = replace(rule, least_alternative=_least_alternative(gaps))
    rule = replace(rule, least_effect=_least_effect(gaps, count, rule))
    nothing = [one.support for one in campaigns if not one.present]
    scores = sorted(rule.gap_score(gap_evidence(one), one.depths) for one in nothing)
    return replace(rule, margins=_margins(campaigns, rule), nulls=tuple(scores))


def _of_effects(campaigns, rows):
    # The model of effects with these rows for each campaign, and their probabilities.
    pairs = [(k, name) for k, of_one in enumerate(rows) for name in of_one]
    model, probabilities = _logistic(
        [rows[k][name] for k, name in pairs],
        [name in campaigns[k].true for k, name in pairs],
        [k for k, _ in pairs],
    )
    out = [{} for _ in campaigns]
    for (k, name), p in zip(pairs, probabilities, strict=True):
        out[k][name] = p
    return model, out


def _logistic(rows, labels, groups):
    # The model, and the probability of each row by models of the other folds.
    x, y = np.array([[*row.values()] for row in rows]), np.array(labels)
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=_MOST_STEPS))
    left_out = cross_val_predict(
        model, x, y, groups=groups, cv=GroupKFold(_FOLDS), method='predict_proba'
    )[:, 1]
    scaler, fitted = model.fit(x, y)[0], model[1]
    weights = fitted.coef_[0] / scaler.scale_
    constant = float(fitted.intercept_[0] - weights @ scaler.mean_)
    return Logistic(constant, dict(zip(rows[0], map(float, weights), strict=True))), left_out


def _thresholds(campaigns, odds):
    # Of all thresholds with which at most `FALSE_ALARMS` of the campaigns without an effect have a
    # gap, those with which most of the campaigns with an effect have one; with as few of those
    # whose poses are far off as are allowed, or as few as there can be.
    present = np.array([one.present for one in campaigns])
    far = ~present & np.array([one.planned['pose_mm'] >= _FAR for one in campaigns])
    slopes = _slopes(campaigns, odds)
    odds, excess = _without_slopes(campaigns, odds, slopes)
    allowed, allowed_far = _allowed(FALSE_ALARMS, ~present), _allowed(FAR_ALARMS, far)
    best, most = slopes, (-math.inf, -1)
    for large in range(allowed + 1):
        least = _above(np.sort(excess[~present])[::-1], large)
        left = allowed - int((~present & (excess >= least)).sum())
        end = _above(np.sort(odds[~present & (excess < least)])[::-1], left)
        found = (odds >= end) | (excess >= least)
        too_many = max(int((found & far).sum()) - allowed_far, 0)
        found_here = -too_many, int((found & present).sum())
        if found_here > most:
            most = found_here
            best = replace(slopes, probability=end, excess=least)
    return best


def _slopes(campaigns, odds):
    # How the evidence of campaigns without an effect depends on the scatter of the poses and on
    # how many depths there are; the other thresholds are 0, but no campaign without an effect
    # reaches that of the agreement.
    depths = [one.support.depths for one in campaigns]
    fewer = np.array([fewer_by(one, max(depths)) for one in depths])
    present, plain = (
        np.array([getattr(one, name) for one in campaigns]) for name in ('present', 'plain')
    )
    scatter, losses = (
        np.array([getattr(one.support, name) for one in campaigns])
        for name in ('scatter', 'excess')
    )
    line = QuantileRegressor(quantile=_QUANTILE, alpha=0.0)
    by_scatter, by_fewer = line.fit(np.stack([scatter, fewer], 1)[plain], losses[plain]).coef_
    logits = np.log(odds / (1 - odds))
    of_odds = line.fit(fewer[~present, None], logits[~present]).coef_[0]
    most = max(agreement(one.support) for one in campaigns if not one.present)
    return GapThresholds(
        probability=0.0,
        excess=0.0,
        excess_per_scatter=max(float(by_scatter), 0.0),
        agreement=float(np.nextafter(most, np.inf)),
        most_depths=float(max(depths)),
        odds_per_fewer=max(float(of_odds), 0.0),
        excess_per_fewer=max(float(by_fewer), 0.0),
    )


def _without_slopes(campaigns, odds, slopes):
    # The odds and excess losses that mean as much in a campaign with most depths.
    fewer = [fewer_by(one.support.depths, slopes.most_depths) for one in campaigns]
    excess = [
        one.support.excess - slopes.excess_from(one.support.scatter, one.support.depths)
        for one in campaigns
    ]
    lower = [math.exp(-slopes.odds_per_fewer * one) for one in fewer]
    return np.array(list(map(times_odds, odds, lower))), np.array(excess)


def _allowed(rate, group):
    # How many alarms there may be in a group so that further ones have about this rate.
    return max(math.floor(rate * (group.sum() + 1)), 1) - 1


def _above(ordered, count):
    # The smallest value that at most so many of these reach.
    return float(np.nextafter(ordered[count], np.inf)) if count < len(ordered) else 0.0


def _least_effect(gaps, count, rule):
    # The probability from which on effects are named: at most `WRONG` of the campaigns with an
    # effect, which are so many, are then named wrongly.
    wrong = []
    for one, effects in gaps:
        chosen = {c.name for c in one.support.chosen}
        listed = chosen | {name for name, p in effects.items() if p >= rule.least_alternative}
        best = max(effects[name] for name in chosen)
        partly = explain_partly(one.support, best, rule)
        if not explain_little(one.support) and is_wrong(one, listed, partly):
            wrong.append(best)
    wrong.sort(reverse=True)
    allowed = max(math.floor(WRONG * (count + 1)), 1)
    return float(np.nextafter(wrong[allowed - 1], 2.0)) if len(wrong) >= allowed else 0.0


def is_wrong(one, listed, partly):
    """
    Say whether an answer that lists effects is wrong.

    It is if no true effect is listed, as in the benchmark. Where the diagnosis has no true effect
    to choose from, `partly` is right.
    """
    return one.present and not listed & one.true and (one.findable or not partly)


def first(one, effects):
    """Return the most probable one of the chosen effects."""
    return max((c.name for c in one.support.chosen), key=lambda name: effects[name])


def _least_alternative(gaps):
    # The probability that a true effect reaches in `COVERED` of the campaigns with a gap.
    reached = np.sort(
        [
            max((effects.get(name, 0.0) for name in one.true), default=0.0)
            for one, effects in gaps
            if one.findable
        ]
    )
    at = math.floor((1 - COVERED) * (len(reached) + 1)) - 1
    return float(reached[at]) if at >= 0 else 0.0


def _margins(campaigns, rule):
    # Conformalised quantile regression (Romano et al., 2019): by how much intervals must be
    # widened so that they hold in `HELD` of further campaigns.
    verdicts = [judge(one.support, rule).verdict for one in campaigns]
    out = []
    for verdict in EXPLAINED:
        for group in _GROUPS:
            some = [
                max(one.reduction[1] - one.reduction[3], one.reduction[3] - one.reduction[2])
                for one, said in zip(campaigns, verdicts, strict=True)
                if one.reduction is not None and said == verdict and _group(one.support) == group
            ]
            at = math.ceil(HELD * (len(some) + 1)) - 1
            enough = len(some) >= _FEWEST and at < len(some)
            out.append(Margin(verdict, *group[:2], float(np.sort(some)[at]) if enough else None))
    return tuple(out)


def _group(support):
    # The group of a campaign.
    return next(
        group
        for group in _GROUPS
        if support.recordings <= group[0] and group[1] <= support.depths < group[2]
    )
