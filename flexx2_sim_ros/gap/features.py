"""What a recording shows, as numbers: sums over pixels, and the features made of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.covariates import AXES, BINS, Scene
from numba import njit
import numpy as np

CLIP = np.float32(6.0)
_CLIP2 = np.float32(8.5)  # differences of two
ENOUGH = 150  # samples without which a bin says nothing
_LATTICE_BIN = 1e-4  # metres
_LATTICE_RANGE = 7.5
# Steps in which depth may come, metres: a lattice shows at its own step and those of which it is
# a multiple.
_LATTICE_STEPS = {'lattice_coarse': (0.006, 0.02), 'lattice_medium': (0.003, 0.006),
                  'lattice_small': (0.0015, 0.003), 'lattice_fine': (0.0006, 0.0015)}
WIDTH = 16
(EXPECT, VALID, ERROR, HIGH, LOW, N2, ABS2, SQUARE2, N1, SQUARE1, NEIGHBOUR, N_NEIGHBOUR, TREND,
 TIME2, TIME, INVERSE) = range(16)

# Channel -> (what a difference must exceed to matter, unit).
CHANNELS = {'bias': (0.10, 'sigma'), 'invalid': (0.008, ''), 'high': (0.004, ''),
            'low': (0.004, ''), 'log_variance': (0.10, ''), 'kurtosis': (0.05, ''),
            'lag': (0.04, ''), 'neighbour': (0.04, ''), 'trend': (0.15, 'sigma')}
STRUCTURES = {'frame_common': 0.01, 'row_common': 0.01, 'column_common': 0.01,
              'row_invalid': 0.004, 'static_grain': 0.015, 'static_rows': 0.004,
              'static_columns': 0.004, 'static_neighbour': 0.04, 'frame_spread': 0.04,
              **dict.fromkeys(_LATTICE_STEPS, 0.5), 'repeat': 0.08}
_FULL = ('bias', 'invalid', 'high', 'low', 'log_variance', 'kurtosis', 'lag', 'neighbour')
_BRIEF = {'beyond': ('invalid',), 'fine_distance': ('bias', 'high', 'low'),
          'tile': ('bias', 'invalid')}


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
    return out + [Feature(name, 'structure', 0) for name in STRUCTURES]


LAYOUT = _layout()
SIZE = len(LAYOUT)
_CHANNEL_NAMES = list(CHANNELS)
_PICK = np.array([(_CHANNEL_NAMES.index(f.channel), AXES[f.axis].start + f.place)
                  for f in LAYOUT if f.axis != 'structure']).T
TOLERANCE = np.array([CHANNELS[f.channel][0] if f.axis != 'structure' else STRUCTURES[f.channel]
                      for f in LAYOUT])


@dataclass
class Sums:
    """
    Sums over a recording's pixels and frames; those of two parts of it can be added.

    Attributes
    ----------
    bins : numpy.ndarray
        (BINS, 16) float64.
    pairs : numpy.ndarray
        (7,) float64: of differences between frames, sums over frames, rows and columns of
        (sum^2 - sum of squares) and of pairs; and the sum of squares.
    losses : numpy.ndarray
        (2,) float64: excess of the change of invalid pixels a row, and pairs.
    spread : numpy.ndarray
        (3,) float64: sum, sum of squares and count of each frame's log mean squared difference.
    mean : numpy.ndarray
        (2, H, W) float32: per pixel the sum of errors (metres), and count.
    sigma : numpy.ndarray
        (H, W) float32, sum of sigma_z where ``mean`` counts.
    lattice : numpy.ndarray or None
        Histogram of depth.

    """

    bins: np.ndarray
    pairs: np.ndarray
    losses: np.ndarray
    spread: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    lattice: np.ndarray | None


def accumulate(depth: np.ndarray, scenes: Sequence[Scene], fresh: np.ndarray,
               warm: int, lattice: bool = True, thin: bool = False) -> Sums:
    """
    Sum a recording's frames up.

    Parameters
    ----------
    depth : numpy.ndarray
        (T, H, W) float32 metres, NaN where invalid.
    scenes : sequence of Scene
        One, or one a frame.
    fresh : numpy.ndarray
        (T,) bool, frames that do not follow the one before.
    warm : int
        How many frames after a fresh one are left out (a camera's filters settle).
    lattice : bool
        Whether to count how often which depth occurs.
    thin : bool
        Whether to look at every other row only.

    Returns
    -------
    Sums

    """
    count, height, width = depth.shape
    bins = np.zeros((BINS, WIDTH))
    part = np.zeros((BINS, WIDTH), np.float32)
    mean = np.zeros((2, height, width), np.float32)
    sigma = np.zeros((height, width), np.float32)
    pairs, losses, spread = np.zeros(7), np.zeros(2), np.zeros(3)
    errors = np.full((3, height, width), np.nan, np.float32)
    rows, columns = np.zeros((2, height), np.float32), np.zeros((2, width), np.float32)
    invalid = np.zeros(height, np.float32)
    size = int(_LATTICE_RANGE / _LATTICE_BIN)
    histogram = np.zeros(size) if lattice else None
    before: np.ndarray | None = None
    still = len(scenes) == 1
    pixels = np.zeros((height, width, WIDTH) if still else (1, 1, WIDTH), np.float32)
    age = 0
    for t in range(count):
        if fresh[t] or t == 0:
            errors[:] = np.nan
            before = None
            age = 0
        age += 1
        scene = scenes[t] if len(scenes) > 1 else scenes[0]
        part[:] = 0
        rows[:], columns[:] = 0, 0
        errors[2], errors[1] = errors[1], errors[0].copy()
        time = np.float32((t - (count - 1) / 2) / max(count - 1, 1))
        use = age > warm
        _gather(depth[t], scene.clean, scene.sigma, scene.bins, errors, time, part, rows, columns,
                invalid, mean, sigma, use, still, pixels, 2 if thin else 1)
        if not use:
            continue
        if not still:
            bins += part
        total, number = float(rows[0].sum()), float(rows[1].sum())
        if number > 1:
            squares = float(part[AXES['all'].start, SQUARE1])  # always summed
            pairs += (total ** 2 - squares, number ** 2 - number,
                      float((rows[0].astype(float) ** 2).sum()) - squares,
                      float((rows[1].astype(float) ** 2).sum()) - number,
                      float((columns[0].astype(float) ** 2).sum()) - squares,
                      float((columns[1].astype(float) ** 2).sum()) - number, squares)
            value = np.log(max(squares / number, 1e-9))
            spread += (value, value ** 2, 1)
        if before is not None:
            change = invalid - before
            losses += (float((change ** 2 - invalid - before).sum()), float(width ** 2 * height))
        before = invalid.copy()
        if histogram is not None:
            seen = depth[t][scene.inside]
            seen = seen[(seen > 0) & (seen < _LATTICE_RANGE)]
            histogram += np.bincount((seen / np.float32(_LATTICE_BIN) + np.float32(0.5))
                                     .astype(np.int32), minlength=size)[:size]
    if still:
        part[:] = 0
        _sort(pixels, scenes[0].bins, part)
        bins += part
    return Sums(bins, pairs, losses, spread, mean, sigma, histogram)


@njit(cache=True, error_model='numpy', nogil=True)
def _gather(depth, clean, sigma, bins, errors, time, out, rows, columns,  # type: ignore
            invalid, mean, sigmas, use, still, pixels, step):
    height, width = depth.shape
    axes = bins.shape[2]
    v = np.zeros(16, np.float32)
    zero = np.float32(0)
    one = np.float32(1)
    for y in range(0, height, step):
        d_left = np.float32(np.nan)
        lost = zero
        for x in range(width):
            z, c = depth[y, x], clean[y, x]
            e = (z - c) / sigma[y, x]
            valid = z == z
            inner = bins[y, x, 0] >= 0
            e = min(max(e, -_CLIP2), _CLIP2) if e == e else e
            errors[0, y, x] = e
            if not use:
                continue
            v[:] = zero
            v[0] = one
            d = np.float32(np.nan)
            if inner and not valid:
                lost += one
            if valid:
                v[1] = one
            if e == e:
                v[2] = min(max(e, -CLIP), CLIP)
                v[3] = one if e > CLIP else zero
                v[4] = one if e < -CLIP else zero
                v[12] = v[2] * time
                v[13] = time * time
                v[14] = time
                v[15] = one / sigma[y, x]
                if inner and abs(e) < CLIP:
                    mean[0, y, x] += z - c
                    mean[1, y, x] += one
                    sigmas[y, x] += sigma[y, x]
                d1 = e - errors[1, y, x]
                if d1 == d1:
                    d1 = min(max(d1, -_CLIP2), _CLIP2)
                    v[8] = one
                    v[9] = d1 * d1
                    if inner:
                        rows[0, y] += d1
                        rows[1, y] += one
                        columns[0, x] += d1
                        columns[1, x] += one
                d = e - errors[2, y, x]
                if d == d:
                    d = min(max(d, -_CLIP2), _CLIP2)
                    v[5] = one
                    v[6] = abs(d)
                    v[7] = d * d
                    if inner and d_left == d_left:
                        v[10] = d * d_left
                        v[11] = one
            d_left = d if inner else np.float32(np.nan)
            if still:
                if inner:
                    out[0, 9] += v[9]
                for k in range(16):
                    pixels[y, x, k] += v[k]
            else:
                for a in range(axes):
                    i = bins[y, x, a]
                    if i >= 0:
                        for k in range(16):
                            out[i, k] += v[k]
        invalid[y] = lost


@njit(cache=True, nogil=True)
def _sort(pixels, bins, out):  # type: ignore[no-untyped-def]
    for y in range(bins.shape[0]):
        for x in range(bins.shape[1]):
            for a in range(bins.shape[2]):
                i = bins[y, x, a]
                if i >= 0:
                    for k in range(16):
                        out[i, k] += pixels[y, x, k]


def features(sums: Sums, lattice_base: np.ndarray | None = None,
             enough: int = ENOUGH) -> tuple[np.ndarray, np.ndarray]:
    """
    Turn sums into features.

    Parameters
    ----------
    sums : Sums
        Of a recording.
    lattice_base : numpy.ndarray, optional
        Spectrum of the depths of the base simulator, to compare the lattice with.
    enough : int
        Samples without which a bin says nothing.

    Returns
    -------
    tuple of numpy.ndarray
        (SIZE,) values, NaN where there is too little to say, and the variance that independent
        pixels would give them.

    """
    s = sums.bins.T
    with np.errstate(invalid='ignore', divide='ignore'):
        share = np.clip(s[VALID] / s[EXPECT], 0, 1)
        bias, high, low = (s[k] / s[VALID] for k in (ERROR, HIGH, LOW))
        several, several2 = s[VALID] >= enough, s[N2] >= enough
        square = s[SQUARE2] / s[N2]
        values = np.array([
            bias, np.where(s[EXPECT] >= enough, 1 - share, np.nan), high, low,
            np.log(square / 2), np.log(square) - 2 * np.log(s[ABS2] / s[N2]) - 0.4516,
            np.log(s[SQUARE1] / s[N1] / square), s[NEIGHBOUR] / s[N_NEIGHBOUR] / square,
            (s[TREND] - bias * s[TIME]) / (s[TIME2] - s[TIME] ** 2 / s[VALID])])
        n, m = s[VALID], s[N2]
        variances = np.array([
            1 / n, (share * (1 - share) + 1 / s[EXPECT]) / s[EXPECT], (high + 1 / n) / n,
            (low + 1 / n) / n, 3 / m, 1 / m, 3 / m, 1.5 / m, 1 / s[TIME2]])
    values[[0, 2, 3, 8]] = np.where(several, values[[0, 2, 3, 8]], np.nan)
    values[4:8] = np.where(several2, values[4:8], np.nan)
    values[~np.isfinite(values)] = np.nan
    structure, structure_variance = _structure(sums, lattice_base)
    return (np.concatenate([values[_PICK[0], _PICK[1]], structure]),
            np.concatenate([variances[_PICK[0], _PICK[1]], structure_variance]))


def _structure(sums: Sums, lattice_base: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    out = dict.fromkeys(STRUCTURES, np.nan)
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
        out['frame_spread'] = np.sqrt(max(sums.spread[1] / sums.spread[2] - average ** 2, 0))
    grain = static_grain(sums)
    good = np.isfinite(grain)
    if good.sum() > ENOUGH:
        out['static_grain'] = float(np.mean(np.clip(grain[good], -3, 3) ** 2))
        for name, axis in (('static_rows', 1), ('static_columns', 0)):
            number = good.sum(axis=axis)
            line = np.where(good, np.clip(grain, -3, 3), 0).sum(axis=axis)
            square = np.where(good, np.clip(grain, -3, 3) ** 2, 0).sum(axis=axis)
            out[name] = float((line ** 2 - square).sum() / max((number ** 2 - number).sum(), 1))
        # All that single frames say of a filter in the camera.
        product = np.clip(grain[:, 1:], -3, 3) * np.clip(grain[:, :-1], -3, 3)
        out['static_neighbour'] = float(np.nanmean(product) / max(out['static_grain'], 1e-9))
    if lattice_base is not None and sums.lattice is not None:
        spectrum = lattice_spectrum(sums)
        for name, (shortest, longest) in _LATTICE_STEPS.items():
            out[name] = max(lattice_peak(spectrum, lattice_base, shortest, longest)[0], 0.0)
    values = np.array(list(out.values()))
    return values, (0.3 * np.array(list(STRUCTURES.values()))) ** 2


def static_grain(sums: Sums) -> np.ndarray:
    """Return the mean error of each pixel less that of those around it, in sigma; (H, W)."""
    with np.errstate(invalid='ignore', divide='ignore'):
        count = sums.mean[1]
        good = count >= max(0.5 * float(count.max(initial=0)), 1)
        value = np.where(good, sums.mean[0] / sums.sigma, np.float32(0))
        around, number = box(np.where(good, value, 0), 2), box(good.astype(np.float32), 2)
        return np.where(good & (number > 12), value - around / number, np.float32(np.nan))


def box(image: np.ndarray, reach: int) -> np.ndarray:
    """Sum over (2 reach + 1)^2 pixels; zeros outside."""
    padded = np.pad(image.astype(np.float64), reach)
    total = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    size = 2 * reach + 1
    return (total[size:, size:] - total[:-size, size:] - total[size:, :-size]
            + total[:-size, :-size])


def lattice_spectrum(sums: Sums) -> np.ndarray:
    """Return the squared share of depths in step with 0, 1, 2, ... periods over the range."""
    assert sums.lattice is not None
    number = max(float(sums.lattice.sum()), 1.0)
    return np.abs(np.fft.rfft(sums.lattice)) ** 2 / number ** 2


def lattice_peak(spectrum: np.ndarray, base: np.ndarray, shortest: float = 0.0006,
                 longest: float = 0.02) -> tuple[float, float]:
    """Return how much (log) depth is more in step than the base's, and with which step, metres."""
    low, high = round(_LATTICE_RANGE / longest), round(_LATTICE_RANGE / shortest)
    excess = np.log10((spectrum[low:high] + 3e-4) / (base[low:high] + 3e-4))
    best = int(np.argmax(excess))
    # The longest step of those that do about as well: its fractions are its harmonics.
    best = int(np.argmax(excess > 0.8 * excess[best]))
    return float(excess[best]), _LATTICE_RANGE / (low + best)
