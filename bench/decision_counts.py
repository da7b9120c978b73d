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
        named = []
        if said.verdict in EXPLAINED:
            named = [chosen.name for chosen in one.support.chosen]
            out['confidence'] += [(said.effects[name], name in one.true) for name in named]
        best = first(one, said.effects) if named else None
        interval = None
        if one.reduction is not None:
            middle, low, high, _ = one.reduction
            interval = rule.widened(
                (low, high), middle, said.verdict, one.support.recordings, one.support.depths
            )
        _count(out, one, said.verdict, best, {*named, *said.alternatives}, interval)
    return out


def _count(out, one, verdict, best, listed, interval):
    # Add a campaign: the most probable effect that is named, and all that are listed.
    finds = verdict != 'none'
    if not one.present:
        out['false_alarms'].append(finds)
    else:
        out['wrong'].append(best is not None and is_wrong(one, listed, verdict == 'partly'))
        if not one.findable:
            out['unexplained'].append(verdict in _UNEXPLAINED)
    if one.findable:
        out['named'].append(best in one.true)
        if finds:
            out['covered'].append(bool(listed & one.true))
            out['size'].append(len(listed))
    if interval is not None:
        out['held'].append(interval[0] <= one.reduction[3] <= interval[1])
