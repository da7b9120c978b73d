"""How strongly the recordings support each effect: the evidence that a decision rests on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.selection import Choice, Selection, Trials
from flexx2_sim_ros.gap.inference.uncertainty import advantage, improvements
import numpy as np


@dataclass(frozen=True)
class EffectSupport:
    """
    What speaks for one effect, or for one set of effects, against another explanation.

    `gain` is the reduction of the loss of left-out recordings, minus the cost of the effect's
    parameters; per recording. `t` is the reduction over its standard error (paired over
    recordings).
    """

    name: str
    gain: float
    t: float


@dataclass(frozen=True)
class Support:
    """
    The evidence of a campaign. Losses and gains are per recording.

    * `recordings`: how many there are.
    * `depths`: pixels of an image times frames, valid or not: per recording.
    * `excess`, `left`: excess loss without effects, and with the chosen ones.
    * `gain`, `t`: of the chosen effects together, against the simulation without effects.
    * `scatter`: spread of the recordings' poses, as a fraction of the usual spread.
    * `improved`: by how much the chosen effects reduce the loss of each left-out recording; their
      mean minus the cost of the parameters is ``gain``.
    * `chosen`: each chosen effect against the others without it.
    * `considered`: each effect of the catalogue alone against no effect, best first.
    * `rivals`: other effects in place of the last chosen one, best first: their gain there, and
      how clearly (t) the chosen set is better.
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


def _rounded(value: float) -> float:
    return round(float(value), 3)


def support_of(
    trials: Trials, selection: Selection, without: Sequence[Choice], considered: Sequence[Choice]
) -> Support:
    """
    Collect the evidence of a campaign.

    `without` has the chosen effects without each one in turn, `considered` each effect alone, best
    first.
    """
    count, chosen = trials.count, selection.chosen
    evidence = trials.model.evidence

    def support(name: str, gain: float, one: Choice, other: Fit) -> EffectSupport:
        return EffectSupport(name, gain / count, advantage(one.fit, other))

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
            support(part.effect, chosen.gain - one.gain, chosen, one.fit)
            for part, one in zip(chosen.fit.candidates, without, strict=True)
        ),
        tuple(
            support(one.fit.candidates[-1].effect, one.gain, one, trials.base)
            for one in considered
        ),
        tuple(
            support(one.fit.candidates[-1].effect, one.gain - selection.gained, chosen, one.fit)
            for one in selection.rivals
        ),
    )
