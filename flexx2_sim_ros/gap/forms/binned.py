"""Curves and maps that are the mean of what recordings show in bins or pixels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import of_role, parse_effects
from flexx2_sim_ros.effects.saturation import bled
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.features.physical import Measures, SURFACES
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.bias_fit import is_surely_less
from flexx2_sim_ros.gap.forms.samples import covariates_at, frames_of, mean_error, shift_of
import numpy as np

NOISE = of_role('sigma').name
_SEED = 0  # the same for all, so that maps without one recording have what is unknown in common
_BLED = {f'light that bleeds {reach:g} px': reach for reach in FORMS.bleeds}
_EDGES = {
    'incidence': np.linspace(*FORMS.incidence),
    'slant': np.linspace(*FORMS.slant),
    **dict.fromkeys(('light', *_BLED), np.linspace(*FORMS.amplitude)),
}


@dataclass(frozen=True)
class Binned:
    """
    What surfaces show in bins of covariates, (B,) by covariate.

    `weight` is how much is known, `total` the value times that. Of invalid pixels these are the
    pixels, and how many are invalid. Of noise: pairs of frames, and times these the logarithm of
    the measured variance over that of the base model.
    """

    weight: dict[str, np.ndarray]
    total: dict[str, np.ndarray]

    def mean(self, over: str) -> np.ndarray:
        """Return (B,) the value, NaN where nothing is known."""
        with np.errstate(invalid='ignore'):
            return np.asarray(self.total[over] / self.weight[over])


def pooled(some: Sequence[Binned]) -> Binned:
    """Return what several recordings show together."""
    return Binned(
        {over: np.sum([one.weight[over] for one in some], axis=0) for over in some[0].weight},
        {over: np.sum([one.total[over] for one in some], axis=0) for over in some[0].total},
    )


@dataclass(frozen=True)
class LostTable:
    """
    A table of the probability to be invalid, in a field of an effect, that only `rises`.

    `fixed` are other parameters of the effect.
    """

    field: str
    over: str
    rises: bool
    label: str
    fixed: tuple[tuple[str, float], ...] = ()

    @property
    def middles(self) -> np.ndarray:
        """Return the middles of the bins."""
        edges = _EDGES[self.over]
        return (edges[1:] + edges[:-1]) / 2

    def curve(self, shown: Binned) -> Curve:
        """Return the monotone table that is the likeliest."""
        # Imported here: it takes a second, which other commands and workers need not wait for.
        from sklearn.isotonic import isotonic_regression

        known = shown.weight[self.over] > 0
        if not known.any():
            return Curve((0.0,), (0.0,))
        values = isotonic_regression(
            shown.mean(self.over)[known],
            sample_weight=shown.weight[self.over][known],
            increasing=self.rises,
        )
        return _curve(self.middles[known], values, 0.0, 1.0)

    def surprise(self, others: Binned, one: Binned) -> float:
        """Return the negative log-likelihood a pixel of a recording, by the table of others."""
        p = self.curve(others).at(self.middles).clip(FORMS.unlikely, 1 - FORMS.unlikely)
        seen, lost = one.weight[self.over], one.total[self.over]
        likelihood = (lost * np.log(p) + (seen - lost) * np.log(1 - p)).sum()
        return -float(likelihood / (seen.sum() or 1.0))  # A recording may show no such surface.


@dataclass(frozen=True)
class NoiseCurve:
    """A curve of the factor on sigma_z, in a field of an effect."""

    field: str
    over: str
    label: str
    fixed: tuple[tuple[str, float], ...] = ()

    @property
    def middles(self) -> np.ndarray:
        """Return the middles of the bins; those at the ends are as wide as those beside them."""
        edges = np.array(AXES[self.over].edges)
        step = np.diff(edges)
        ends = edges[0] - step[0] / 2, edges[-1] + step[-1] / 2
        return np.concatenate([ends[:1], (edges[1:] + edges[:-1]) / 2, ends[1:]])

    def curve(self, shown: Binned) -> Curve:
        """Return the curve that is the mean."""
        known = shown.weight[self.over] > 0
        if not known.any():
            return Curve((0.0,), (1.0,))
        return _curve(self.middles[known], np.exp(shown.mean(self.over)[known] / 2), 0.1, 10.0)

    def surprise(self, others: Binned, one: Binned) -> float:
        """Return by how much less a recording scatters about a constant than about a curve."""
        good = (others.weight[self.over] > 0) & (one.weight[self.over] > 0)
        if not good.any():
            return 0.0
        curve, level = others.mean(self.over)[good], one.mean(self.over)[good]
        count = one.weight[self.over][good]
        constant = np.average(curve, weights=count)
        gain = (level - constant) ** 2 - (level - curve) ** 2
        return -float(np.average(gain, weights=count))


KINDS: dict[str, tuple[LostTable | NoiseCurve, ...]] = {
    'grazing_dropout': (
        LostTable('curve', 'incidence', True, 'monotone table over incidence'),
        LostTable('slant', 'slant', True, 'monotone table over slant'),
    ),
    'low_signal_dropout': (LostTable('curve', 'light', False, 'monotone table over light'),),
    'saturation': (
        LostTable('curve', 'light', True, 'monotone table over light'),
        *(
            LostTable('curve', over, True, f'monotone table over {over}', (('bleed', reach),))
            for over, reach in _BLED.items()
        ),
    ),
    NOISE: (
        NoiseCurve('curve', 'log_amplitude', 'factor over amplitude'),
        NoiseCurve('slant', 'incidence', 'factor over incidence'),
    ),
}


def _curve(knots: np.ndarray, values: np.ndarray, low: float, high: float) -> Curve:
    return Curve(
        tuple(float(x) for x in np.round(knots, 4)),
        tuple(float(y) for y in np.clip(np.round(values, 4), low, high)),
    )


def best_kind(effect: str, some: Sequence[Binned]) -> LostTable | NoiseCurve:
    """
    Return the kind of curve that tells most of what left-out recordings show.

    One that fixes another parameter has to tell surely more.
    """

    def surprise(kind: LostTable | NoiseCurve) -> np.ndarray:
        rest = (pooled([*some[:i], *some[i + 1 :]]) for i in range(len(some)))
        return np.array(
            [kind.surprise(others, one) for others, one in zip(rest, some, strict=True)]
        )

    known = [kind for kind in KINDS[effect] if any(one.weight[kind.over].any() for one in some)]
    every = [(surprise(kind), kind) for kind in known or KINDS[effect]]
    groups = ([one for one in every if bool(one[1].fixed) == fixes] for fixes in (False, True))
    simple, *more = (min(group, key=lambda one: one[0].sum()) for group in groups if group)
    return more[0][1] if more and is_surely_less(more[0][0], simple[0]) else simple[1]


def lost_in(scene: PlacedScene) -> Binned:
    """Count the invalid pixels of a recording's surfaces."""
    seen = {over: np.zeros(len(edges) - 1) for over, edges in _EDGES.items()}
    lost = {over: np.zeros(len(edges) - 1) for over, edges in _EDGES.items()}
    moving = scene.moving
    for t in range(len(scene.placed.clean) if moving else 1):
        inside = scene.covariates[t if moving else 0].inside
        depth = scene.recording.depth[t : t + 1] if moving else scene.recording.depth
        gone = np.isnan(depth[:, inside]).sum(axis=0)
        shown = covariates_at(scene, t)
        shown |= {over: bled(shown['light'], reach) for over, reach in _BLED.items()}
        for over, value in shown.items():
            bins = len(_EDGES[over]) - 1
            place = np.clip(np.digitize(value[inside], _EDGES[over]) - 1, 0, bins - 1)
            seen[over] += len(depth) * np.bincount(place, minlength=bins)
            lost[over] += np.bincount(place, gone, minlength=bins)
    return Binned(seen, lost)


def noise_in(
    real: Measures, simulated: Measures, effects: Mapping[str, Any]
) -> tuple[Binned, Binned]:
    """
    Return the noise of a recording, and the factor on sigma_z that its simulation has.

    `effects` has settings by effect in the simulation. The factor is NaN where it varies in a bin.
    """
    place = np.array([name for name in SURFACES for _ in range(AXES[name].bins)])
    weight, total, one, factors = {}, {}, {}, {}
    for kind in KINDS[NOISE]:
        mine = place == kind.over
        factor = _factor(effects, kind)
        count = np.asarray(real.noise[0][mine], float)
        with np.errstate(invalid='ignore'):  # No noise at all on both sides.
            level = (real.noise[1] - simulated.noise[1])[mine] + 2 * np.log(factor)
        some = np.minimum(count, simulated.noise[0][mine]) >= FORMS.known
        some &= np.isfinite(level)
        weight[kind.over] = np.where(some, count, 0.0)
        total[kind.over] = weight[kind.over] * np.nan_to_num(level)
        factors[kind.over], one[kind.over] = factor, np.ones(len(factor))
    return Binned(weight, total), Binned(one, factors)


def _factor(effects: Mapping[str, Any], kind: LostTable | NoiseCurve) -> np.ndarray:
    # (B,) the factor on sigma_z that these effects have.
    if NOISE not in effects:
        return np.ones(len(kind.middles))
    (effect,) = parse_effects({NOISE: effects[NOISE]})
    if not effect.forms:
        return np.full(len(kind.middles), effect.constants()['factor'])
    own = effect.forms.get(kind.field)
    if own is None:
        return np.full(len(kind.middles), np.nan)
    return np.asarray(1 + effect.strength * (own.at(kind.middles) - 1), float)


def pixel_errors(scene: PlacedScene, effects: dict[str, dict[str, float]]) -> np.ndarray:
    """
    Return the errors of a recording's pixels that other effects do not explain, (2, H, W).

    First sums of errors in metres times weights, then weights in 1/m^2.
    """
    shifts = shift_of(scene, effects)
    sums, weights = out = np.zeros((2, *shifts.shape[1:]))
    for shift, t in zip(shifts, frames_of(scene.recording), strict=True):
        cover = scene.covariates[int(t) if len(scene.covariates) > 1 else 0]
        error, count = mean_error(scene, int(t))
        error = error - shift
        with np.errstate(invalid='ignore'):
            good = cover.inside & (np.abs(error) < 6 * cover.sigma)
        weight = np.where(good, 1 / (cover.sigma**2 / count + FORMS.grain**2), 0.0)
        sums += weight * np.where(good, error, 0.0)
        weights += weight
    return out


def pixels_lost(scene: PlacedScene) -> np.ndarray:
    """
    Return which share of a recording's frames each pixel is lost in, (H, W).

    It is NaN where the ground truth is unknown, or out of the camera's range.
    """
    depth, clean, mode = scene.recording.depth, scene.placed.clean, scene.recording.mode
    with np.errstate(invalid='ignore'):
        inside = (clean > mode.range_min) & (clean < mode.range_max)
        known = np.broadcast_to(inside, depth.shape)
        return np.asarray((known & np.isnan(depth)).sum(axis=0) / known.sum(axis=0))


def dead_of(shares: Sequence[np.ndarray], lost: float) -> np.ndarray | None:
    """
    Return the probability of each pixel to be lost, (H, W), where some are dead; None otherwise.

    Dead are pixels that most recordings lose in most frames. `shares` are as from `pixels_lost`,
    `lost` is the share of all pixels that is lost whatever they see: others lose the rest of it.
    """
    with np.errstate(all='ignore'):
        dead = np.nanmedian(shares, axis=0) > FORMS.dead
        often = np.nanmean(shares, axis=0)
    if not dead.any():
        return None
    rest = max(lost - often[dead].sum() / dead.size, 0.0) / max(1 - dead.mean(), 1e-9)
    return np.where(dead, often, min(rest, 1.0))


def map_of(errors: Sequence[np.ndarray]) -> np.ndarray:
    """
    Return a map, (H, W) metres, as recordings have it in common, from their `pixel_errors`.

    It is drawn at random of those that agree with the recordings, two or more. Their mean would be
    too smooth: a pixel of which nothing is known has a fixed error as well. It is 0 if nothing is
    in common.
    """
    sums, weights = np.array(errors).swapaxes(0, 1)
    # Products of two recordings' errors have the map's variance as their mean, whatever the
    # noise is.
    products = sums.sum(axis=0) ** 2 - (sums**2).sum(axis=0)
    pairs = weights.sum(axis=0) ** 2 - (weights**2).sum(axis=0)
    variance = products.sum() / pairs.sum() if pairs.any() else 0.0
    if variance <= 0:
        return np.zeros(sums.shape[1:])
    known = weights.sum(axis=0) + 1 / variance
    unknown = np.random.default_rng(_SEED).standard_normal(known.shape) / np.sqrt(known)
    return np.asarray(sums.sum(axis=0) / known + unknown)
