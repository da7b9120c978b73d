"""
The fewest conditions that single out the pixels in which real and simulated differ.

In few recordings covariates are alike: the dark surfaces may be the distant ones. Where effects
are named, the covariates that these depend on by their formulas come first.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from flexx2_sim_ros.effects import ageing, Effect
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES, ENDLESS
from flexx2_sim_ros.gap.features.pixel_groups import GROUP_CHANNELS, PixelGroups
import numpy as np

_NOISE = GROUP_CHANNELS.index('log_variance')
_CLASSES = ('recording', 'region')  # whose bins are not in an order
# Covariates of effects, and the axes along which these show.
_SHOWS_ALONG = {
    'distance': ('distance', 'fine_distance'),
    'incidence': ('incidence',),
    'amplitude': ('log_amplitude',),
    'concavity': ('log_amplitude',),  # indirect light shows where direct light is weak
    'image': ('region', 'radius'),
    'edge': ('edge',),
    'none': ('all',),
}


@dataclass(frozen=True)
class WhereCondition:
    """
    An interval of one covariate.

    `axis` is one of `ENDLESS`, ``recording`` or ``uptime``; its bins `first` to `last` are
    inclusive. Over its pixels that differ there is, each (7,): the mean `difference`, its
    uncertainty `noise`, and the `size` that the real camera shows beyond the plain simulation.
    `bias` is that of the mean depth, metres.
    """

    axis: str
    first: int
    last: int
    difference: np.ndarray
    noise: np.ndarray
    size: np.ndarray
    bias: float


def shows_along(kind: type[Effect]) -> tuple[str, ...]:
    """Return the axes along which an effect shows, by its formula."""
    if kind.role == 'pose':
        return ('recording',)
    if kind.repeats:  # Each pixel has an error of its own.
        return ('all',)
    if kind.covariate != 'time':
        return _SHOWS_ALONG[kind.covariate]
    if ageing([kind.name]):
        return ('uptime',)
    return ('speed', 'edge' if kind.needs_motion else 'all')


def cover(
    recordings: Sequence[PixelGroups],
    real: bool,
    sigma_error: float = 0.0,
    expected: Collection[str] = (),
    uptimes: Sequence[float | None] = (),
) -> list[WhereCondition]:
    """
    Find conditions on covariates that select the pixels that differ, and few others.

    Covariates are added one by one. Each time the one is taken with which the selected pixels have
    the largest intersection over union with the pixels that differ. The conditions of the first
    covariate come first. The list is empty where nothing differs.

    * `recordings`: one for each recording.
    * `real`: whether to use the difference of the real camera. Otherwise that of the effects.
    * `sigma_error`: fraction by which sigma_z is wrong. It is taken off the real camera's
      difference.
    * `expected`: axes of which the first is taken, if the data allow it; see `shows_along`.
    * `uptimes`: seconds since power-on of each recording, for the axis ``uptime``.
    """
    count = np.concatenate([groups.count for groups in recordings])
    if not len(count):
        return []
    difference = np.concatenate([s.real if real else s.effect for s in recordings])
    if real:
        difference[:, _NOISE] -= 2 * np.log1p(sigma_error)
    limit = np.concatenate([s.real_limit if real else s.limit for s in recordings])
    shown = np.concatenate([groups.real for groups in recordings])
    bias = np.concatenate([groups.bias for groups in recordings])
    differs = (np.abs(difference) > limit).any(axis=1)
    if not differs.any():
        return []
    samples = np.concatenate([groups.samples for groups in recordings]).astype(int)
    known = samples[:, :, 0] >= 0
    weight = known * (count / np.maximum(known.sum(axis=1), 1))[:, None]
    bins = {name: samples[:, :, i] - AXES[name].start for i, name in enumerate(ENDLESS)}
    bins['recording'] = np.repeat(np.arange(len(recordings)), [len(s.count) for s in recordings])[
        :, None
    ] + np.zeros(known.shape, int)
    if 'uptime' in expected and None not in uptimes:
        intervals = np.searchsorted(np.array(WHERE.uptimes), np.array(uptimes, float))
        bins['uptime'] = intervals[bins['recording']]
    inside, outside = weight * differs[:, None], weight * ~differs[:, None]
    out = []
    for name, some in _select(bins, inside, outside, expected):
        for first, last in _stretches(some, bins[name][known], name in _CLASSES):
            here = (bins[name] >= first) & (bins[name] <= last)
            part = (inside * here).sum(axis=1)  # of each group's pixels, in this interval
            total = max(float(part.sum()), 1e-9)
            out.append(
                WhereCondition(
                    name,
                    first,
                    last,
                    part @ difference / total,
                    np.sqrt(np.square(part) @ np.square(limit / WHERE.standard_errors)) / total,
                    part @ shown / total,
                    float(part @ bias / total),
                )
            )
    return out


def _select(
    bins: dict[str, np.ndarray], inside: np.ndarray, outside: np.ndarray, expected: Collection[str]
) -> list[tuple[str, np.ndarray]]:
    # Forward selection of covariates: name of each, and which of its bins are selected.
    named, best = np.zeros(inside.shape, bool), 0.0
    chosen: list[tuple[str, np.ndarray]] = []
    for _ in range(WHERE.most_conditions):
        tries = [(*_pick(place, inside, outside, named), name) for name, place in bins.items()]
        meant = [
            one
            for one in tries
            if one[2] in expected and not chosen and one[0] > WHERE.worth[one[2]]
        ]
        value, some, name = max(meant or tries, key=lambda one: one[0] - WHERE.worth[one[2]])
        if value - WHERE.worth[name] <= best:
            break
        best = value
        chosen.append((name, some))
        named |= some[np.maximum(bins[name], 0)] & (bins[name] >= 0)
    return chosen


def _pick(
    place: np.ndarray, inside: np.ndarray, outside: np.ndarray, named: np.ndarray
) -> tuple[float, np.ndarray]:
    # Intersection over union, and the set of an axis's bins that makes it largest. Bins are added
    # in the order of the fraction of their pixels that differs.
    use = (place >= 0) & ~named
    size = max(int(place.max(initial=0)) + 1, 1)
    hits, misses = (np.bincount(place[use], w[use], minlength=size) for w in (inside, outside))
    order = np.argsort(-hits / np.maximum(hits + misses, 1e-9), kind='stable')
    both = np.cumsum(hits[order]) + (inside * named).sum()
    either = inside.sum() + (outside * named).sum() + np.cumsum(misses[order])
    value = both / np.maximum(either, 1e-9)
    best = int(np.argmax(value))
    some = np.zeros(size, bool)
    some[order[: best + 1]] = hits[order[: best + 1]] > 0
    return float(value[best]), some


def _stretches(some: np.ndarray, present: np.ndarray, classes: bool) -> list[tuple[int, int]]:
    # First and last bin of each interval of selected bins. Bins without pixels do not interrupt
    # an interval. Each class is an interval of its own.
    there = np.bincount(present[present >= 0], minlength=len(some)) > 0
    out: list[tuple[int, int]] = []
    for i in np.flatnonzero(some):
        if out and not classes and not there[out[-1][1] + 1 : i].any():
            out[-1] = out[-1][0], int(i)
        else:
            out.append((int(i), int(i)))
    return out
