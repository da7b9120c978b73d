"""Tables of a dropout: the probability to be invalid over incidence or amplitude, monotone."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.samples import covariates_at
import numpy as np


@dataclass(frozen=True)
class DropoutTable:
    """
    One kind of table that a dropout may have, in a field of the effect.

    It is over ``incidence``, ``slant`` or ``light``; `rises`: the probability rises with that.
    """

    field: str
    over: str
    rises: bool


KINDS = {
    'grazing_dropout': (
        DropoutTable('curve', 'incidence', True),
        DropoutTable('slant', 'slant', True),
    ),
    'low_signal_dropout': (DropoutTable('curve', 'light', False),),
    'saturation': (DropoutTable('curve', 'light', True),),
}
_EDGES = {
    'incidence': np.linspace(*FORMS.incidence),
    'slant': np.linspace(*FORMS.slant),
    'light': np.linspace(*FORMS.amplitude),
}


@dataclass(frozen=True)
class Counts:
    """
    Pixels of a recording's surfaces (`seen`), and how many of them are invalid (`lost`).

    Both are (B,) over ``incidence``, ``slant`` and ``light``.
    """

    seen: dict[str, np.ndarray]
    lost: dict[str, np.ndarray]

    def fractions(self, over: str) -> np.ndarray:
        """Return (B,) the fraction that is invalid, NaN where there are no pixels."""
        with np.errstate(invalid='ignore'):
            return np.asarray(self.lost[over] / self.seen[over])


def middles(over: str) -> np.ndarray:
    """Return the middles of the bins of a covariate."""
    edges = _EDGES[over]
    return (edges[1:] + edges[:-1]) / 2


def counts_of(scene: PlacedScene) -> Counts:
    """Count the pixels of a recording."""
    seen = {over: np.zeros(len(edges) - 1) for over, edges in _EDGES.items()}
    lost = {over: np.zeros(len(edges) - 1) for over, edges in _EDGES.items()}
    moving = scene.moving
    for t in range(len(scene.placed.clean) if moving else 1):
        inside = scene.covariates[t if moving else 0].inside
        depth = scene.recording.depth[t : t + 1] if moving else scene.recording.depth
        gone = np.isnan(depth[:, inside]).sum(axis=0)
        for over, value in covariates_at(scene, t).items():
            bins = len(_EDGES[over]) - 1
            place = np.clip(np.digitize(value[inside], _EDGES[over]) - 1, 0, bins - 1)
            seen[over] += len(depth) * np.bincount(place, minlength=bins)
            lost[over] += np.bincount(place, gone, minlength=bins)
    return Counts(seen, lost)


def together(counts: Sequence[Counts]) -> Counts:
    """Return the counts of several recordings together."""
    return Counts(
        {over: np.sum([one.seen[over] for one in counts], axis=0) for over in _EDGES},
        {over: np.sum([one.lost[over] for one in counts], axis=0) for over in _EDGES},
    )


def table_of(kind: DropoutTable, counts: Sequence[Counts]) -> Curve:
    """Return the monotone table that is the likeliest for the pixels of some recordings."""
    every = together(counts)
    seen = every.seen[kind.over]
    known = seen > 0
    if not known.any():
        return Curve((0.0,), (0.0,))
    # Imported here: it takes a second, which other commands and workers need not wait for.
    from sklearn.isotonic import isotonic_regression

    values = isotonic_regression(
        every.fractions(kind.over)[known], sample_weight=seen[known], increasing=kind.rises
    )
    return Curve(
        tuple(float(x) for x in np.round(middles(kind.over)[known], 4)),
        tuple(float(y) for y in np.clip(np.round(values, 4), 0, 1)),
    )


def best_kind(effect: str, counts: Sequence[Counts]) -> DropoutTable:
    """Return the kind of table that tells most of the invalid pixels of left-out recordings."""

    def surprise(kind: DropoutTable) -> float:
        # Negative log-likelihood a pixel, mean over recordings.
        total = 0.0
        for i, one in enumerate(counts):
            rest = [*counts[:i], *counts[i + 1 :]]
            p = np.clip(
                table_of(kind, rest).at(middles(kind.over)), FORMS.unlikely, 1 - FORMS.unlikely
            )
            seen, lost = one.seen[kind.over], one.lost[kind.over]
            total -= float((lost * np.log(p) + (seen - lost) * np.log(1 - p)).sum() / seen.sum())
        return total

    return min(KINDS[effect], key=surprise)
