"""Count how often a rule of the verdict is right about simulated campaigns."""

from bench.decision_fit import first, is_wrong
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge

_UNEXPLAINED = 'unknown', 'partly'  # right where the diagnosis does not know the effect
_COUNTED = 'false_alarms', 'wrong', 'named', 'covered', 'size', 'unexplained', 'held'


def counted(rule, campaigns):
    """
    Count how often a rule is right about campaigns it was not fitted to.

    Returns lists: ``false_alarms``, ``wrong``, ``named`` (of campaigns with a findable effect),
    ``covered`` (a true effect is named or an alternative), ``size`` (of that set), ``unexplained``
    (of campaigns whose effect the diagnosis does not know: the verdict is ``unknown`` or
    ``partly``) and ``held`` (intervals of the reduction) of bool or int; ``confidence`` of
    (probability, present) of each named effect.
    """
    out = {name: [] for name in (*_COUNTED, 'confidence')}
    for one in campaigns:
        said = judge(one.support, rule)
        finds, names = said.verdict != 'none', said.verdict in EXPLAINED
        if not one.present:
            out['false_alarms'].append(finds)
        else:
            listed = {*said.alternatives, *(c.name for c in one.support.chosen)}
            out['wrong'].append(names and is_wrong(one, listed, said.verdict == 'partly'))
            if not one.findable:
                out['unexplained'].append(said.verdict in _UNEXPLAINED)
        if names:
            out['confidence'] += [
                (said.effects[c.name], c.name in one.true) for c in one.support.chosen
            ]
        if one.findable:
            out['named'].append(names and first(one, said.effects) in one.true)
            if finds:
                listed = set(said.alternatives)
                listed |= {c.name for c in one.support.chosen} if names else set()
                out['covered'].append(bool(listed & one.true))
                out['size'].append(len(listed))
        if one.reduction is not None:
            middle, low, high, real = one.reduction
            wide = rule.widened(
                (low, high), middle, said.verdict, one.support.recordings, one.support.depths
            )
            if wide is not None:
                out['held'].append(wide[0] <= real <= wide[1])
    return out


def before(campaigns):
    """Count the same of the rule with which the campaigns were diagnosed."""
    out = {name: [] for name in _COUNTED}
    for one in campaigns:
        finds = one.verdict not in ('none', 'not_decidable', 'too_little')
        if not one.present:
            out['false_alarms'].append(finds)
        else:
            listed = {*one.named, *one.alternatives}
            wrong = bool(one.named) and is_wrong(one, listed, one.verdict == 'partly')
            out['wrong'].append(wrong)
            if not one.findable:
                out['unexplained'].append(one.verdict in _UNEXPLAINED)
        if one.findable:
            out['named'].append(bool(one.named) and one.named[0] in one.true)
            if finds:
                listed = {*one.named, *one.alternatives}
                out['covered'].append(bool(listed & one.true))
                out['size'].append(len(listed))
        if one.reduction is not None:
            _, low, high, real = one.reduction
            out['held'].append(low <= real <= high)
    return out
