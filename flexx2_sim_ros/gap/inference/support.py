"""How strongly the recordings support each effect: the evidence that a decision rests on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.gap.inference.selection import Choice, Selection, Trials
from flexx2_sim_ros.gap.inference.uncertainty import advantage, improvements
import numpy as np


@dataclass(frozen=True)
class EffectSupport:
    """
    What speaks for one effect, or for one set of effects, against another explanation.

    Attributes
    ----------
    name : str
        The effect.
    gain : float
        Reduction of the loss of left-out recordings, minus the cost of the effect's parameters;
        per recording.
    t : float
        The reduction of the loss over its standard error (paired over recordings).

    """

    name: str
    gain: float
    t: float


@dataclass(frozen=True)
class Support:
    """
    The evidence of a campaign. Losses and gains are per recording.

    Attributes
    ----------
    recordings : int
        How many there are.
    depths : float
        Pixels of an image times frames, valid or not: per recording.
    excess, left : float
        Excess loss without effects, and with the chosen ones.
    gain, t : float
        Of the chosen effects together, against the simulation without effects.
    scatter : float
        Spread of the recordings' poses, as a fraction of the usual spread.
    improved : tuple of float
        By how much the chosen effects reduce the loss of each left-out recording; their mean minus
        the cost of the parameters is ``gain``.
    chosen : tuple of EffectSupport
        Each chosen effect against the others without it.
    considered : tuple of EffectSupport
        Each effect of the catalogue alone against no effect, best first.
    rivals : tuple of EffectSupport
        Other effects in place of the last chosen one, best first: their gain there, and how
        clearly (t) the chosen set is better.

    """

    recordings: int
    depths: float
    excess: float
    left: float
    gain: float
    t: float
    scatter: float
    improved: tuple[float, ...]
    chosen: tuple[EffectSupport, ...]
    considered: tuple[EffectSupport, ...]
    rivals: tuple[EffectSupport, ...]

    @property
    def least_gain(self) -> float:
        """Gain in the recordings without the one that gains most, per recording."""
        cost = sum(self.improved) / len(self.improved) - self.gain
        rest = sorted(self.improved)[:-1] or self.improved
        return sum(rest) / len(rest) - cost

    def as_table(self) -> dict[str, Any]:
        """Return it as plain values, rounded to what can matter."""
        rows = {
            name: [
                {'name': one.name, 'gain': _rounded(one.gain), 't': _rounded(one.t)}
                for one in getattr(self, name)
            ]
            for name in ('chosen', 'considered', 'rivals')
        }
        numbers = ('depths', 'excess', 'left', 'gain', 't', 'scatter')
        return {
            'recordings': self.recordings,
            **{name: _rounded(getattr(self, name)) for name in numbers},
            'improved': [_rounded(one) for one in self.improved],
            **rows,
        }


def support_from(table: Mapping[str, Any]) -> Support:
    """Return the evidence that `Support.as_table` wrote."""
    rows = {
        name: tuple(EffectSupport(**one) for one in table[name])
        for name in ('chosen', 'considered', 'rivals')
    }
    return Support(**{**table, **rows, 'improved': tuple(table['improved'])})


def _rounded(value: float) -> float:
    return round(float(value), 3)


def support_of(
    trials: Trials, selection: Selection, without: Sequence[Choice], considered: Sequence[Choice]
) -> Support:
    """
    Collect the evidence of a campaign.

    Parameters
    ----------
    trials : Trials
        Of the recordings.
    selection : Selection
        The chosen effects, and what could be in place of the last one.
    without : sequence of Choice
        The chosen effects without each one in turn.
    considered : sequence of Choice
        Each effect alone, best first.

    """
    count, chosen = trials.count, selection.chosen
    evidence = trials.model.evidence
    return Support(
        count,
        float(np.mean([one.grain.size * one.frames for one in evidence])),
        trials.excess(chosen) / count,
        (float(chosen.fit.loss.sum()) - trials.null) / count,
        chosen.gain / count,
        advantage(chosen.fit, trials.base),
        trials.model.pose_scatter(),
        tuple(improvements(chosen.fit, trials.base).tolist()),
        tuple(
            EffectSupport(
                part.effect, (chosen.gain - one.gain) / count, advantage(chosen.fit, one.fit)
            )
            for part, one in zip(chosen.fit.candidates, without, strict=True)
        ),
        tuple(
            EffectSupport(
                one.fit.candidates[-1].effect, one.gain / count, advantage(one.fit, trials.base)
            )
            for one in considered
        ),
        tuple(
            EffectSupport(
                one.fit.candidates[-1].effect,
                (one.gain - selection.gained) / count,
                advantage(chosen.fit, one.fit),
            )
            for one in selection.rivals
        ),
    )
