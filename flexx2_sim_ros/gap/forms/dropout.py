"""Tables of a dropout: the probability to be invalid over incidence or amplitude, monotone."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.effects.grazing_dropout import log_slant
from flexx2_sim_ros.effects.saturation import bled
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.bias_fit import is_surely_less
from flexx2_sim_ros.gap.forms.samples import images_at, light_of, surface_of
from flexx2_sim_ros.physics.geometry import ray_length
import numpy as np


@dataclass(frozen=True)
class DropoutTable:
    """
    One kind of table that a dropout may have, in a field of the effect.

    It is over ``incidence``, ``slant`` or ``light``, or over light that bleeds; `rises`: the
    probability rises with that. `fixed` are other parameters of the effect.
    """

    field: str
    over: str
    rises: bool
    fixed: tuple[tuple[str, float], ...] = ()


_BLED = {f'light that bleeds {reach:g} px': reach for reach in FORMS.bleeds}
KINDS = {
    'grazing_dropout': (
        DropoutTable('curve', 'incidence', True),
        DropoutTable('slant', 'slant', True),
    ),
    'low_signal_dropout': (DropoutTable('curve', 'light', False),),
    'saturation': (
        DropoutTable('curve', 'light', True),
        *(DropoutTable('curve', over, True, (('bleed', reach),)) for over, reach in _BLED.items()),
    ),
}
_EDGES = {
    'incidence': np.linspace(*FORMS.incidence),
    'slant': np.linspace(*FORMS.slant),
    **dict.fromkeys(('light', *_BLED), np.linspace(*FORMS.amplitude)),
}


@dataclass(frozen=True)
class Counts:
    """
    Pixels of a recording's surfaces (`seen`), and how many of them are invalid (`lost`).

    Both are (B,) over what the tables of `KINDS` are over.
    """

    seen: dict[str, np.ndarray]
    lost: dict[str, np.ndarray]

    def fractions(self, over: str) -> np.ndarray:
        """Return (B,) the fraction that is invalid, NaN where there are no pixels."""
        with np.errstate(invalid='ignore'):
            return np.asarray(self.lost[over] / self.seen[over])


def middles(over: str) -> np.ndarray:
    """Return the middles of the bins of a covariate."""
    return (_EDGES[over][1:] + _EDGES[over][:-1]) / 2


def counts_of(scene: PlacedScene) -> Counts:
    """Count the pixels of a recording."""
    seen, lost = ({over: np.zeros(len(e) - 1) for over, e in _EDGES.items()} for _ in range(2))
    moving = scene.moving
    for t in range(len(scene.placed.clean) if moving else 1):
        inside = scene.covariates[t if moving else 0].inside
        depth = scene.recording.depth[t : t + 1] if moving else scene.recording.depth
        gone = np.isnan(depth[:, inside]).sum(axis=0)
        for over, value in _covariates(scene, t).items():
            bins = len(_EDGES[over]) - 1
            place = np.clip(np.digitize(value[inside], _EDGES[over]) - 1, 0, bins - 1)
            seen[over] += len(depth) * np.bincount(place, minlength=bins)
            lost[over] += np.bincount(place, gone, minlength=bins)
    return Counts(seen, lost)


def _covariates(scene: PlacedScene, t: int) -> dict[str, np.ndarray]:
    # (H, W) each, as the effects have them.
    recording = scene.recording
    clean, light = images_at(scene.placed, t)
    cosine = surface_of(recording, clean).cos_incidence
    amplitude = light_of(recording, clean, light)
    return {
        'incidence': np.degrees(np.arccos(np.clip(cosine, 0, 1))),
        'slant': log_slant(cosine, clean * ray_length(recording.K, clean.shape)),
        'light': amplitude,
        **{over: bled(amplitude, reach) for over, reach in _BLED.items()},
    }


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
    """Return the kind that tells most of left-out recordings; light that bleeds: surely more."""

    def surprise(kind: DropoutTable) -> np.ndarray:
        # Negative log-likelihood a pixel, (R,).
        out = []
        for i, one in enumerate(counts):
            table = table_of(kind, [*counts[:i], *counts[i + 1 :]])
            p = np.clip(table.at(middles(kind.over)), FORMS.unlikely, 1 - FORMS.unlikely)
            seen, lost = one.seen[kind.over], one.lost[kind.over]
            out.append(-(lost * np.log(p) + (seen - lost) * np.log(1 - p)).sum() / seen.sum())
        return np.array(out)

    every = [(surprise(kind), kind) for kind in KINDS[effect]]
    groups = ([one for one in every if bool(one[1].fixed) == bleeds] for bleeds in (False, True))
    simple, *more = (min(group, key=lambda one: one[0].sum()) for group in groups if group)
    return more[0][1] if more and is_surely_less(more[0][0], simple[0]) else simple[1]
