"""The features of a recording, from its sums over pixels and frames."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.features.pixel_patterns import grain_moments, LATTICE_RANGE, less_around
from flexx2_sim_ros.gap.features.row_sums import (
    ABS2,
    ERROR,
    EXPECT,
    HIGH,
    LOW,
    N1,
    N2,
    N_ERROR,
    N_NEIGHBOUR,
    NEIGHBOUR,
    SQUARE1,
    SQUARE2,
    TIME,
    TIME2,
    TREND,
    VALID,
)
from flexx2_sim_ros.gap.features.sums import Sums
import numpy as np

ENOUGH = FEATURES.enough
CHANNEL_UNITS = {
    'bias': 'sigma',
    'invalid': 'fraction',
    'high': 'fraction',
    'low': 'fraction',
    'log_variance': 'ln',
    'kurtosis': 'ln',
    'lag': 'correlation',
    'neighbour': 'correlation',
    'trend': 'sigma',
}
# Features of a whole recording, without bins.
STRUCTURE_UNITS = {
    **dict.fromkeys(('frame_common', 'row_common', 'column_common'), 'fraction of variance'),
    'row_invalid': 'fraction',
    **dict.fromkeys(('static_grain', 'static_rows', 'static_columns'), 'sigma^2'),
    'static_neighbour': 'correlation',
    'frame_spread': 'ln',
    **dict.fromkeys(('jump_between', 'jump_switches'), 'fraction'),
    **dict.fromkeys(FEATURES.lattice_steps, 'log10'),
    'repeat': 'correlation',
}
_FULL = ('bias', 'invalid', 'high', 'low', 'log_variance', 'kurtosis', 'lag', 'neighbour')
_BRIEF = {
    'beyond': ('invalid',),
    'fine_distance': ('bias', 'high', 'low'),
    'tile': ('bias', 'invalid'),
}


@dataclass(frozen=True)
class Feature:
    """One number: a channel in a bin of an axis."""

    channel: str
    axis: str
    place: int


def _layout() -> list[Feature]:
    out = []
    for axis in AXES.values():
        channels = _FULL if axis.full else _BRIEF[axis.name]
        if axis.name == 'all':
            channels = (*channels, 'trend')
        out += [Feature(channel, axis.name, i) for channel in channels for i in range(axis.bins)]
    return out + [Feature(name, 'structure', 0) for name in STRUCTURE_UNITS]


_SHORTEST = min(shortest for shortest, _ in FEATURES.lattice_steps.values())
_LONGEST = max(longest for _, longest in FEATURES.lattice_steps.values())
LAYOUT = _layout()
SIZE = len(LAYOUT)
_CHANNEL_NAMES = list(CHANNEL_UNITS)
_PICK = np.array(
    [
        (_CHANNEL_NAMES.index(f.channel), AXES[f.axis].start + f.place)
        for f in LAYOUT
        if f.axis != 'structure'
    ]
).T
TOLERANCE = np.array([FEATURES.tolerances[f.channel] for f in LAYOUT])


def noise_of(bins: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return log variance, lag and correlation of neighbours, (B,) each, of (B, WIDTH) sums.

    They are the channels of these names, also where there are too few samples.
    """
    s = bins.T
    with np.errstate(invalid='ignore', divide='ignore'):
        square = s[SQUARE2] / s[N2]
        lag = np.log(s[SQUARE1] / s[N1] / square)
        return np.log(square / 2), lag, s[NEIGHBOUR] / s[N_NEIGHBOUR] / square


def features(
    sums: Sums, lattice_base: np.ndarray | None = None, enough: int = ENOUGH
) -> tuple[np.ndarray, np.ndarray]:
    """
    Turn sums into features, (SIZE,), and their variance if pixels are independent, (SIZE,).

    Values are NaN where there are too few samples: a bin with fewer than `enough` is unknown. The
    lattice is compared with `lattice_base`, the spectrum of the depths of the base simulator.
    """
    s = sums.bins.T
    log_variance, lag, neighbour = noise_of(sums.bins)
    with np.errstate(invalid='ignore', divide='ignore'):
        valid = np.clip(s[VALID] / s[EXPECT], 0, 1)
        bias, high, low = (s[k] / s[N_ERROR] for k in (ERROR, HIGH, LOW))
        several, several2 = s[N_ERROR] >= enough, s[N2] >= enough
        square = s[SQUARE2] / s[N2]
        values = np.array(
            [
                bias,
                np.where(s[EXPECT] >= enough, 1 - valid, np.nan),
                high,
                low,
                log_variance,
                np.log(square) - 2 * np.log(s[ABS2] / s[N2]) - 0.4516,
                lag,
                neighbour,
                (s[TREND] - bias * s[TIME]) / (s[TIME2] - s[TIME] ** 2 / s[N_ERROR]),
            ]
        )
        n, m = s[N_ERROR], s[N2]
        variances = np.array(
            [
                1 / n,
                (valid * (1 - valid) + 1 / s[EXPECT]) / s[EXPECT],
                (high + 1 / n) / n,
                (low + 1 / n) / n,
                3 / m,
                1 / m,
                3 / m,
                1.5 / m,
                1 / s[TIME2],
            ]
        )
    values[[0, 2, 3, 8]] = np.where(several, values[[0, 2, 3, 8]], np.nan)
    values[4:8] = np.where(several2, values[4:8], np.nan)
    values[~np.isfinite(values)] = np.nan
    structure, structure_variance = _structure(sums, lattice_base)
    return (
        np.concatenate([values[_PICK[0], _PICK[1]], structure]),
        np.concatenate([variances[_PICK[0], _PICK[1]], structure_variance]),
    )


def likeness(lag: np.ndarray | float) -> np.ndarray:
    """
    Return the channel ``lag`` as the correlation with the frame before.

    It is that of a recursive filter: the correlation over two frames is its square.
    """
    return np.clip(np.exp(-np.asarray(lag)) - 1, -1, 1)


def _structure(sums: Sums, lattice_base: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    out = dict.fromkeys(STRUCTURE_UNITS, np.nan)
    p = sums.pairs
    if p[1] > 0 and p[6] > 0:
        spread = p[6] / max(sums.bins[AXES['all'].start, N1], 1)
        for name, i in (('frame_common', 0), ('row_common', 2), ('column_common', 4)):
            out[name] = p[i] / max(p[i + 1], 1) / spread
    if sums.losses[1] > 0:
        excess = sums.losses[0] / (2 * sums.losses[1])
        out['row_invalid'] = np.sign(excess) * np.sqrt(abs(excess))
    if sums.spread[2] > 3:
        average = sums.spread[0] / sums.spread[2]
        out['frame_spread'] = np.sqrt(max(sums.spread[1] / sums.spread[2] - average**2, 0))
    valid, between, pairs, switches = sums.jumps
    if valid > ENOUGH:
        out['jump_between'] = between / valid
    if pairs > ENOUGH:
        out['jump_switches'] = switches / pairs
    number, square, rows, columns, product = grain_moments(static_grain(sums))
    if number > ENOUGH:
        out['static_grain'] = square / number
        out['static_rows'], out['static_columns'] = rows, columns
        # The only trace of a filter in the camera that single frames show.
        out['static_neighbour'] = product / max(out['static_grain'], 1e-9)
    if lattice_base is not None and sums.lattice is not None:
        spectrum = lattice_spectrum(sums)
        for name, (shortest, longest) in FEATURES.lattice_steps.items():
            out[name] = max(lattice_peak(spectrum, lattice_base, shortest, longest)[0], 0.0)
    values = np.array(list(out.values()))
    tolerances = np.array([FEATURES.tolerances[name] for name in STRUCTURE_UNITS])
    return values, (FEATURES.structure_noise * tolerances) ** 2


def static_grain(sums: Sums) -> np.ndarray:
    """Return (H, W) mean error of each pixel minus that of its neighbours, in sigma."""
    count = sums.mean[1]
    grain: np.ndarray = less_around(
        sums.mean[0], sums.sigma, count, max(0.5 * float(count.max(initial=0)), 1.0)
    )
    return grain


def lattice_spectrum(sums: Sums) -> np.ndarray:
    """Return (2, N) the power spectra of both histograms, by periods over their range."""
    assert sums.lattice is not None
    number = np.maximum(sums.lattice.sum(axis=1, keepdims=True), 1.0)
    return np.abs(np.fft.rfft(sums.lattice)) ** 2 / number**2


def lattice_peak(
    spectrum: np.ndarray, base: np.ndarray, shortest: float = _SHORTEST, longest: float = _LONGEST
) -> tuple[float, float]:
    """Return the largest log10 ratio of a spectrum to the base's, and its step in metres."""
    low, high = round(LATTICE_RANGE / longest), round(LATTICE_RANGE / shortest)
    noise = FEATURES.lattice_noise
    both = np.log10((spectrum[:, low:high] + noise) / (base[:, low:high] + noise))
    excess = both[int(np.argmax(both.max(axis=1)))]
    best = int(np.argmax(excess))
    # The longest step with about the same ratio; shorter steps are its harmonics.
    best = int(np.argmax(excess > FEATURES.lattice_harmonic * excess[best]))
    return float(excess[best]), LATTICE_RANGE / (low + best)
