"""What a recording shows, as numbers: sums over pixels, and the features made of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.constants import FEATURES
from flexx2_sim_ros.gap.data.axes import AXES, BINS
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
from flexx2_sim_ros.gap.features.pixel_patterns import (
    count_depths,
    grain_moments,
    LATTICE_BIN,
    LATTICE_RANGE,
    less_around,
)
from flexx2_sim_ros.gap.features.row_sums import (
    ABS2,
    ERROR,
    EXPECT,
    FrameSums,
    FrameTimes,
    gather_rows,
    HIGH,
    LOW,
    N1,
    N2,
    N_NEIGHBOUR,
    NEIGHBOUR,
    PixelSums,
    SQUARE1,
    SQUARE2,
    Surfaces,
    TIME,
    TIME2,
    TREND,
    VALID,
    WIDTH,
)
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
# Structure of a whole recording, in no bin of a covariate.
STRUCTURE_UNITS = {
    **dict.fromkeys(('frame_common', 'row_common', 'column_common'), 'fraction of variance'),
    'row_invalid': 'fraction',
    **dict.fromkeys(('static_grain', 'static_rows', 'static_columns'), 'sigma^2'),
    'static_neighbour': 'correlation',
    'frame_spread': 'ln',
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
        (2, N) histograms of depth and of distance along the ray: steps of a phase are steps of
        the latter.

    """

    bins: np.ndarray
    pairs: np.ndarray
    losses: np.ndarray
    spread: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    lattice: np.ndarray | None


def accumulate(
    depth: np.ndarray,
    scenes: Sequence[PixelCovariates],
    fresh: np.ndarray,
    warm: int,
    lattice: bool = True,
    thin: bool = False,
) -> Sums:
    """
    Sum a recording's frames up.

    Parameters
    ----------
    depth : numpy.ndarray
        (T, H, W) float32 metres, NaN where invalid.
    scenes : sequence of PixelCovariates
        One, or one a frame.
    fresh : numpy.ndarray
        (T,) bool, frames that do not follow the one before.
    warm : int
        How many frames after a fresh one are left out (a camera's filters settle).
    lattice : bool
        Whether to count how often which depth occurs.
    thin : bool
        Whether to look at every other row only.

    """
    frames = _frame_times(fresh, warm)
    frame_sums, pixel_sums = _sum_frames(depth, scenes, frames, thin)
    return Sums(
        pixel_sums.bins,
        _pairs(frame_sums, frames),
        _lost_rows(frame_sums, frames),
        _frame_spread(frame_sums, frames),
        pixel_sums.mean,
        pixel_sums.sigma,
        _depth_histogram(depth, scenes, frames) if lattice else None,
    )


def _frame_times(fresh: np.ndarray, warm: int) -> FrameTimes:
    count, start = len(fresh), fresh.copy()
    start[:1] = True
    use, age = np.zeros(count, np.bool_), 0
    for t in range(count):
        age = 1 if start[t] else age + 1
        use[t] = age > warm
    times = ((np.arange(count) - (count - 1) / 2) / max(count - 1, 1)).astype(np.float32)
    return FrameTimes(start, use, times)


def _sum_frames(
    depth: np.ndarray, scenes: Sequence[PixelCovariates], frames: FrameTimes, thin: bool
) -> tuple[FrameSums, PixelSums]:
    count, height, width = depth.shape
    frame_sums = FrameSums(
        rows=np.zeros((count, 2, height), np.float32),
        columns=np.zeros((count, 2, width), np.float32),
        squares=np.zeros(count),
        invalid=np.zeros((count, height)),
    )
    pixel_sums = PixelSums(
        bins=np.zeros((BINS, WIDTH)),
        mean=np.zeros((2, height, width), np.float32),
        sigma=np.zeros((height, width), np.float32),
        errors=np.empty((3, height, width), np.float32),
    )
    still = len(scenes) == 1
    # A still scene is summed at once, with all its frames.
    for part in [slice(None)] if still else [slice(t, t + 1) for t in range(count)]:
        scene = scenes[0] if still else scenes[part.start]
        gather_rows(
            depth[part],
            Surfaces(scene.clean, scene.sigma, scene.inside, scene.first, scene.runs),
            FrameTimes(*(one[part] for one in frames)),
            FrameSums(*(one[part] for one in frame_sums)),
            pixel_sums,
            not still,
            2 if thin else 1,
        )
    return frame_sums, pixel_sums


def _depth_histogram(
    depth: np.ndarray, scenes: Sequence[PixelCovariates], frames: FrameTimes
) -> np.ndarray:
    histogram = np.zeros((2, int(LATTICE_RANGE / LATTICE_BIN)))
    for t in np.flatnonzero(frames.use).tolist():
        scene = scenes[0 if len(scenes) == 1 else t]
        count_depths(depth[t], scene.inside, scene.ray, histogram)
    return histogram


def _pairs(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (7,) see `Sums`; (sum^2 - sum of squares) is twice the sum of products of pairs.
    (row, row_number), (column, column_number) = (
        image.astype(float).transpose(1, 0, 2) for image in (sums.rows, sums.columns)
    )
    number, squares = row_number.sum(axis=1), sums.squares
    some = frames.use & (number > 1)
    return np.array(
        [
            f[some].sum()
            for f in (
                row.sum(axis=1) ** 2 - squares,
                number**2 - number,
                (row**2).sum(axis=1) - squares,
                (row_number**2).sum(axis=1) - number,
                (column**2).sum(axis=1) - squares,
                (column_number**2).sum(axis=1) - number,
                squares,
            )
        ]
    )


def _lost_rows(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (2,) see `Sums`: independent pixels change as often as they are invalid.
    use, (_, height), width = frames.use, sums.invalid.shape, sums.columns.shape[2]
    after = np.flatnonzero(use[1:] & use[:-1] & ~frames.start[1:]) + 1
    invalid, before = sums.invalid[after], sums.invalid[after - 1]
    excess = ((invalid - before) ** 2 - invalid - before).sum()
    return np.array([excess, float(width**2 * height * len(after))])


def _frame_spread(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (3,) see `Sums`.
    number = sums.rows[:, 1].astype(float).sum(axis=1)
    some = frames.use & (number > 1)
    value = np.log(np.maximum(sums.squares[some] / number[some], 1e-9))
    return np.array([value.sum(), (value**2).sum(), len(value)])


def features(
    sums: Sums, lattice_base: np.ndarray | None = None, enough: int = ENOUGH
) -> tuple[np.ndarray, np.ndarray]:
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
        values = np.array(
            [
                bias,
                np.where(s[EXPECT] >= enough, 1 - share, np.nan),
                high,
                low,
                np.log(square / 2),
                np.log(square) - 2 * np.log(s[ABS2] / s[N2]) - 0.4516,
                np.log(s[SQUARE1] / s[N1] / square),
                s[NEIGHBOUR] / s[N_NEIGHBOUR] / square,
                (s[TREND] - bias * s[TIME]) / (s[TIME2] - s[TIME] ** 2 / s[VALID]),
            ]
        )
        n, m = s[VALID], s[N2]
        variances = np.array(
            [
                1 / n,
                (share * (1 - share) + 1 / s[EXPECT]) / s[EXPECT],
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
    Return the channel ``lag`` as people read it: the correlation with the frame before.

    That of a recursive filter, whose correlation with the frame before that is its square.
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
    number, square, rows, columns, product = grain_moments(static_grain(sums))
    if number > ENOUGH:
        out['static_grain'] = square / number
        out['static_rows'], out['static_columns'] = rows, columns
        # All that single frames say of a filter in the camera.
        out['static_neighbour'] = product / max(out['static_grain'], 1e-9)
    if lattice_base is not None and sums.lattice is not None:
        spectrum = lattice_spectrum(sums)
        for name, (shortest, longest) in FEATURES.lattice_steps.items():
            out[name] = max(lattice_peak(spectrum, lattice_base, shortest, longest)[0], 0.0)
    values = np.array(list(out.values()))
    tolerances = np.array([FEATURES.tolerances[name] for name in STRUCTURE_UNITS])
    return values, (FEATURES.structure_noise * tolerances) ** 2


def static_grain(sums: Sums) -> np.ndarray:
    """Return the mean error of each pixel less that of those around it, in sigma; (H, W)."""
    count = sums.mean[1]
    grain: np.ndarray = less_around(
        sums.mean[0], sums.sigma, count, max(0.5 * float(count.max(initial=0)), 1.0)
    )
    return grain


def lattice_spectrum(sums: Sums) -> np.ndarray:
    """Return (2, N) squared shares of depths in step with 0, 1, 2, ... periods over the range."""
    assert sums.lattice is not None
    number = np.maximum(sums.lattice.sum(axis=1, keepdims=True), 1.0)
    return np.abs(np.fft.rfft(sums.lattice)) ** 2 / number**2


def lattice_peak(
    spectrum: np.ndarray, base: np.ndarray, shortest: float = _SHORTEST, longest: float = _LONGEST
) -> tuple[float, float]:
    """Return how much (log) depth is more in step than the base's, and with which step, metres."""
    low, high = round(LATTICE_RANGE / longest), round(LATTICE_RANGE / shortest)
    noise = FEATURES.lattice_noise
    both = np.log10((spectrum[:, low:high] + noise) / (base[:, low:high] + noise))
    excess = both[int(np.argmax(both.max(axis=1)))]
    best = int(np.argmax(excess))
    # The longest step of those that do about as well: its fractions are its harmonics.
    best = int(np.argmax(excess > FEATURES.lattice_harmonic * excess[best]))
    return float(excess[best]), LATTICE_RANGE / (low + best)
