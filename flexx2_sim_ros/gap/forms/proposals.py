"""Which effects have a form, a form for one, and whether left-out recordings pay for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.shapes import Shape
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.physical import distance, NOISE, TOLERANCES
from flexx2_sim_ros.gap.forms.bias import BIASES
from flexx2_sim_ros.gap.forms.bias_fit import is_surely_less
from flexx2_sim_ros.gap.forms.binned import KINDS
from flexx2_sim_ros.gap.forms.binned import NOISE as EXCESS
from flexx2_sim_ros.gap.forms.geometry import is_fitted_with_poses
from flexx2_sim_ros.gap.forms.looked import Settings
from flexx2_sim_ros.gap.forms.shape_search import evaluations
from flexx2_sim_ros.gap.inference.improvement import measured
from flexx2_sim_ros.physics.frame_state import Stage
import numpy as np

PATTERN, DEAD = 'fixed_pattern', 'random_dropout'  # effects that have a map of the image
_OTHERS = 'edge_sigma', *NOISE  # measures that the distance has no part of


def calibratable(effects: Settings, quick: bool) -> list[str]:
    """
    Return which effects have a form, in the order in which they are fitted.

    If ``quick``, the form takes no search by simulation, or a quick one.
    """
    shaped = [
        name
        for name, kind in registry().items()
        if (kind.shapes or kind.scale) and name in effects
    ]
    before = [name for name in shaped if registry()[name].stage <= Stage.PHASOR]
    after = [name for name in shaped if name not in before]
    places = *BIASES, PATTERN, DEAD, EXCESS, *(name for name in KINDS if name != EXCESS)
    names = [*before, *(name for name in places if name in effects), *after]
    return [one for one in names if not (quick and is_searched(one)) or shapes_of(one, quick)]


def is_searched(effect: str) -> bool:
    """Return whether an effect's form is found by simulation."""
    return bool(registry()[effect].shapes) and not is_fitted_with_poses(effect)


def shapes_of(effect: str, quick: bool) -> tuple[Shape, ...]:
    """Return which shapes of an effect are searched for when a search is quick, or not."""
    shapes = registry()[effect].shapes
    return tuple(one for one in shapes if one.quick) if quick else shapes


def rounds(effects: Settings, quick: bool) -> int:
    """Return about how often each recording is judged to fit the forms of these effects."""
    names = calibratable(effects, quick)
    searched = [one for one in names if is_searched(one)]
    return len(names) + sum(evaluations(shapes_of(one, quick), quick) for one in searched)


@dataclass(frozen=True)
class FormProposal:
    """
    A form for one effect; `label` says which.

    `together` has settings fitted to all recordings, `without` the same without each recording in
    turn. `varies` is how much a curve or table varies in the recordings: its standard deviation
    over its root mean square, 0..1; 1 for other forms. An effect that is the same everywhere acts
    like a constant. `with_poses`: it was fitted together with the poses.
    """

    effect: str
    label: str
    together: dict[str, Any]
    without: tuple[dict[str, Any], ...]
    varies: float = 1.0
    with_poses: bool = False


@dataclass(frozen=True)
class FormVerdict:
    """
    Whether a proposal is taken.

    `before` and `after` are (R,) how far each recording is from its simulation, with the effect as
    diagnosed and with the form fitted without this recording; see `physical.distance`. `worse` are
    measures outside the distance that get significantly worse.
    """

    proposal: FormProposal
    before: np.ndarray
    after: np.ndarray
    taken: bool
    worse: tuple[str, ...] = ()

    def as_table(self) -> dict[str, Any]:
        """Return it for a JSON file."""
        return {
            'name': self.proposal.effect,
            'form': self.proposal.label,
            'taken': self.taken,
            'before': float(self.before.mean()),
            'after': float(self.after.mean()),
            'recordings_better': int((self.after < self.before).sum()),
            'worse': list(self.worse),
            'varies': round(self.proposal.varies, 3),
        }


def judged(
    proposal: FormProposal, before: Sequence[dict[str, float]], after: Sequence[dict[str, float]]
) -> FormVerdict:
    """
    Take a proposal if left-out recordings are nearer by more than the standard error.

    It is also taken if they are as near, and a measure outside the distance gets significantly
    better and none worse: the kernel of a filter over frames shows in their correlation alone.
    What was fitted together with the poses is taken unless left-out recordings are surely farther
    away: their poses are fitted again, and make up for a wrong lens.
    """
    old, new = (np.array([distance(one) for one in some]) for some in (before, after))
    nearer, farther = _matters(new, old), _matters(old, new)
    others = {
        unit: measured(
            np.array([[a[unit], b[unit], 0.0] for a, b in zip(before, after, strict=True)]),
            TOLERANCES[unit],
        )
        for unit in _OTHERS
    }
    worse = tuple(unit for unit, one in others.items() if one['worse'])
    better = any(one['better'] for one in others.values())
    taken = nearer or ((better or proposal.with_poses) and not worse and not farther)
    return FormVerdict(proposal, old, new, taken, worse)


def _matters(near: np.ndarray, far: np.ndarray) -> bool:
    return float((far - near).mean()) > FORMS.least and is_surely_less(near, far)


def variation(values: np.ndarray, weights: np.ndarray | None = None) -> float:
    """Return the standard deviation of values over their root mean square, 0..1."""
    square = np.average(values**2, weights=weights)
    mean = np.average(values, weights=weights)
    return float(np.sqrt(max(1 - mean**2 / square, 0.0))) if square > 0 else 0.0
