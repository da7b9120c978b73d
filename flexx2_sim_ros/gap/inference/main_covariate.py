"""
The covariate along which a difference varies most: what singles out the pixels that differ.

The energy of a difference along a covariate is the sum over its bins of pixels times the squared
mean difference of the bin, in tolerances, minus what noise adds. A covariate that the difference
depends on has the largest energy, because its bins do not average the difference away.

In few recordings, covariates are alike: the dark surfaces may be the distant ones. Where effects
are named, the covariates that these depend on by their formulas therefore count more than others.
What the named effects change at single pixels is known from simulation. If no covariate tells
anything about it, the effects act on all pixels alike, unless the difference itself varies along a
covariate of their formulas: a loss of one pixel in a hundred tells little about any pixel.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from flexx2_sim_ros.effects import ageing, Effect
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.features.features import CHANNEL_UNITS, LAYOUT, STRUCTURE_UNITS, TOLERANCE
from flexx2_sim_ros.gap.inference.model import Model
import numpy as np

_INDEX = {(f.channel, f.axis, f.place): i for i, f in enumerate(LAYOUT)}
_CLASSES = ('region', 'recording')  # whose bins have no order
# Covariates of effects, and the axes along which these show.
_SHOWS_ALONG = {
    'distance': ('distance', 'fine_distance'),
    'incidence': ('incidence',),
    'amplitude': ('log_amplitude',),
    'concavity': ('concavity', 'log_amplitude'),  # indirect light shows where direct light is weak
    'image': ('region', 'radius'),
    'edge': ('edge',),
    'none': ('all',),
}
_IN_METRES = tuple(name for name, unit in CHANNEL_UNITS.items() if unit == 'sigma')


@dataclass(frozen=True)
class MainCovariate:
    """
    Where a difference is largest along the covariate that it depends on most.

    Attributes
    ----------
    axis : str
        Of `AXES`, ``recording``, ``uptime``, or ``structure`` for what whole images show.
    first, last : int
        Bins of it, inclusive: recordings, or intervals of `WHERE.uptimes`.
    channel : str
        In which the difference is largest.
    difference : float
        Mean over these bins, in the unit of the channel's tolerance.
    noise : float
        Its standard error, in the same unit.
    size : float
        What the real camera shows there beyond the plain simulation: mm or the channel's unit.

    """

    axis: str
    first: int
    last: int
    channel: str
    difference: float
    noise: float
    size: float


@dataclass(frozen=True)
class _Bins:
    # One channel along one covariate: (B,) of each bin.
    axis: str
    channel: str
    pixels: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    shown: np.ndarray

    @property
    def energies(self) -> np.ndarray:
        # Of a bin; noise may make it negative.
        return self.pixels * (np.square(self.mean) - self.variance)


def main_covariate(
    model: Model,
    difference: np.ndarray,
    shown: np.ndarray,
    exact: bool,
    named: Collection[type[Effect]] = (),
    tells: Mapping[str, float] = MappingProxyType({}),
) -> MainCovariate | None:
    """
    Find the covariate along which real and simulated depth differ most.

    Parameters
    ----------
    model : Model
        The recordings.
    difference : numpy.ndarray
        (R, SIZE) real minus simulated features, or the change by the effects if they explain it.
    shown : numpy.ndarray
        (R, SIZE) real minus simulated features without nuisances, from which a size in mm comes.
    exact : bool
        Whether the difference has no noise, as the change by effects.
    named : collection of type of Effect
        The effects that explain the difference.
    tells : mapping of str to float
        By axis, how much it tells about what these effects change at a pixel, see `told`. Empty
        where that is not known.

    Returns
    -------
    MainCovariate or None
        None where nothing differs by more than the tolerance.

    """
    # `scale2` is float32: where a feature has no noise, rounding may leave less than 0.
    noise = np.zeros_like(difference)
    if not exact:
        noise = np.maximum(model.scale2 - np.square(TOLERANCE), 0)
    expected = {axis for one in named for axis in _shows_along(one)}
    features = _Features(model, difference, shown, noise, expected)
    found = [
        bins
        for channel in CHANNEL_UNITS
        for axis in WHERE.main
        if (bins := features.along(channel, axis)) is not None
    ]
    powers = [_power(bins, expected) for bins in found]
    if max(powers, default=0.0) <= 0:
        return None
    best = found[int(np.argmax(powers))]
    if tells and best.axis != 'all' and not _singles_out(best, expected):
        if max(tells.values()) < WHERE.tells:
            images = features.of_whole_images()
            if images is not None:
                return _largest_stretch(images)
        elif best.axis not in expected:
            best = _most_telling(found, powers, expected, tells)
    found_there = _largest_stretch(best)
    whole = features.along(best.channel, 'all')
    if whole is None or not _is_whole(found_there, best):
        return found_there
    if _singles_out(best, expected):
        return _largest_stretch(best, halfway=True)
    return _largest_stretch(whole)


def _shows_along(kind: type[Effect]) -> tuple[str, ...]:
    if kind.covariate != 'time':
        return _SHOWS_ALONG[kind.covariate]
    if ageing([kind.name]):
        return ('uptime',)
    return ('speed', 'edge') if kind.needs_motion else ('speed', 'all')


def _is_whole(one: MainCovariate, bins: _Bins) -> bool:
    # Whether the stretch has all pixels, so that the covariate does not single out any.
    return bool(bins.pixels[one.first : one.last + 1].sum() >= bins.pixels.sum() > 0)


def _singles_out(bins: _Bins, expected: Collection[str]) -> bool:
    # Whether the formulas of the effects single out pixels along a covariate, and the difference
    # does as well: its energy is more than that of the mean of all bins.
    if 'all' in expected or bins.axis not in expected:
        return False
    pixels = bins.pixels.sum()
    mean = bins.pixels @ bins.mean / pixels
    variance = np.square(bins.pixels) @ bins.variance / pixels**2
    total = bins.energies.sum()
    return bool(total - pixels * (mean**2 - variance) > WHERE.varies * total)


def _power(bins: _Bins, expected: Collection[str]) -> float:
    return _factor(bins.axis, expected) * float(bins.energies.sum())


def _factor(axis: str, expected: Collection[str]) -> float:
    return WHERE.main[axis] * (1.0 if not expected or axis in expected else WHERE.unexpected)


def _most_telling(
    found: list[_Bins], powers: list[float], expected: Collection[str], tells: Mapping[str, float]
) -> _Bins:
    # Few pixels with large changes, as at edges, have most of the energy whatever the effect
    # depends on. So the covariate that tells most about a single pixel is taken.
    some = [i for i, power in enumerate(powers) if power > 0]
    best = max(
        some,
        key=lambda i: (_factor(found[i].axis, expected) * tells.get(found[i].axis, 0), powers[i]),
    )
    return found[best]


class _Features:
    # Differences by recording and bin, as multiples of the tolerance.
    def __init__(
        self,
        model: Model,
        difference: np.ndarray,
        shown: np.ndarray,
        noise: np.ndarray,
        expected: Collection[str],
    ) -> None:
        self._expected = expected
        self._good = model.good
        self._noise = np.where(model.good, noise, 0) / np.square(TOLERANCE)
        self._difference = np.where(model.good, difference, 0) / TOLERANCE
        self._shown = np.where(model.good, shown, 0)
        # Effects and brightness are linear in the fit. A fraction or a correlation is not, so it
        # is taken as measured.
        self._measured = np.where(model.good, model.gap, 0)
        self._counts = np.array([e.counts for e in model.evidence], float)
        sigma = np.nan_to_num([e.sigma for e in model.evidence], posinf=0.0)
        self._sigma = sigma
        self._usual_sigma = max(float(sigma[:, AXES['all'].start].mean()), 1e-9)
        self._uptimes = _intervals_of([e.uptime for e in model.evidence])

    def along(self, channel: str, axis: str) -> _Bins | None:
        if axis in ('recording', 'uptime'):
            return self._of_recordings(channel, axis)
        if axis == 'structure':
            one = AXES['all'].start
            return self._pooled(axis, channel, [_INDEX[channel, axis, 0]], slice(one, one + 1))
        places = range(AXES[axis].bins)
        index = [_INDEX[channel, axis, i] for i in places if (channel, axis, i) in _INDEX]
        if not index:
            return None
        start = AXES[axis].start
        return self._pooled(axis, channel, index, slice(start, start + AXES[axis].bins))

    def of_whole_images(self) -> _Bins | None:
        # What differs most among all that is measured without bins; None where nothing does.
        found = [self.along(channel, 'structure') for channel in STRUCTURE_UNITS]
        found += [self.along(channel, 'all') for channel in CHANNEL_UNITS]
        known = [bins for bins in found if bins is not None and bins.energies.sum() > 0]
        return max(known, key=lambda bins: float(bins.energies.sum()), default=None)

    def _of_recordings(self, channel: str, axis: str) -> _Bins | None:
        groups = np.arange(len(self._good)) if axis == 'recording' else self._uptimes
        # Warming up changes depth. Other channels differ between recordings for other reasons.
        if groups is None or (axis == 'uptime' and channel not in _IN_METRES):
            return None
        if (channel, 'all', 0) not in _INDEX:
            return None
        one = AXES['all'].start
        parts = [
            self._pooled(axis, channel, [_INDEX[channel, 'all', 0]], slice(one, one + 1), some)
            for some in (groups == g for g in range(groups.max() + 1))
        ]
        bins = _Bins(
            axis,
            channel,
            *(
                np.concatenate([getattr(p, name) for p in parts])
                for name in ('pixels', 'mean', 'variance', 'shown')
            ),
        )
        if axis == 'recording' or axis in self._expected or _drifts(bins):
            return bins
        return None

    def _pooled(
        self,
        axis: str,
        channel: str,
        index: list[int],
        bins: slice,
        some: np.ndarray | slice = slice(None),
    ) -> _Bins:
        # Means over recordings, weighted by pixels. Depth is compared in metres, because sigma_z
        # itself depends on the covariates.
        weight = self._counts[some, bins] * self._good[some][:, index]
        scale = np.ones_like(weight)
        shown = self._measured[some][:, index]
        if channel in _IN_METRES:
            scale = self._sigma[some, bins] / self._usual_sigma
            shown = 1000 * self._sigma[some, bins] * self._shown[some][:, index]
        pixels = weight.sum(axis=0)
        total = np.maximum(pixels, 1)
        return _Bins(
            axis,
            channel,
            pixels,
            (weight * scale * self._difference[some][:, index]).sum(axis=0) / total,
            (np.square(weight * scale) * self._noise[some][:, index]).sum(axis=0) / total**2,
            (weight * shown).sum(axis=0) / total,
        )


def _intervals_of(uptimes: list[float | None]) -> np.ndarray | None:
    # The interval of `WHERE.uptimes` of each recording; None where one has no uptime.
    known = [u for u in uptimes if u is not None]
    if len(known) < len(uptimes):
        return None
    return np.searchsorted(np.array(WHERE.uptimes), known)


def _drifts(bins: _Bins) -> bool:
    # Whether a difference rises or falls with uptime over enough intervals. Over two intervals,
    # any difference between recordings does.
    means = bins.mean[bins.pixels > 0]
    steps = np.diff(means)
    return len(means) >= WHERE.fewest_uptimes and bool((steps >= 0).all() or (steps <= 0).all())


def _largest_stretch(bins: _Bins, halfway: bool = False) -> MainCovariate:
    # The bins around the largest difference that have its sign and at least half of its size, or
    # are nearer to it than to the smallest. Bins without pixels do not end the stretch.
    energies = np.where(bins.pixels > 0, bins.energies, -np.inf)
    peak = int(np.argmax(energies))
    sizes = bins.mean * np.sign(bins.mean[peak])
    least = WHERE.stretch * sizes[peak]
    if halfway:
        smallest = sizes[bins.pixels > 0].min()
        least = smallest + WHERE.stretch * (sizes[peak] - smallest)
    alike = (sizes >= least) | (bins.pixels == 0)
    first = last = peak
    if bins.axis not in _CLASSES and bins.axis != 'edge':
        while first > 0 and alike[first - 1]:
            first -= 1
        while last + 1 < len(alike) and alike[last + 1]:
            last += 1
        seen = first + np.flatnonzero(bins.pixels[first : last + 1] > 0)
        first, last = int(seen[0]), int(seen[-1])
    some = np.zeros(len(alike), bool)
    some[first : last + 1] = True
    if bins.axis == 'edge':  # Sides and directions of edges are put together.
        some = alike
    weight = np.where(some, bins.pixels, 0) / max(float(bins.pixels[some].sum()), 1.0)
    tolerance = float(TOLERANCE[_INDEX[bins.channel, _feature_axis(bins.axis), 0]])
    return MainCovariate(
        bins.axis,
        first,
        last,
        bins.channel,
        tolerance * float(weight @ bins.mean),
        tolerance * float(np.sqrt(np.square(weight) @ bins.variance)),
        float(weight @ bins.shown),
    )


def _feature_axis(axis: str) -> str:
    return 'all' if axis in ('recording', 'uptime') else axis
