"""Statistics of every pixel over the frames of a recording, in one pass and bounded memory."""

from dataclasses import dataclass

from flexx2_sim_ros.physics.compiled import loop
import numpy as np

_FIELDS = (
    'count',
    'sum1',
    'sum2',
    'sum3',
    'sum4',
    'lag_count',
    'lag_sum',
    'right_count',
    'right_sum',
    'right_own',
    'right_other',
    'down_count',
    'down_sum',
    'down_own',
    'down_other',
)


@dataclass(frozen=True)
class Moments:
    """
    What the frames say of each pixel.

    Attributes
    ----------
    frames : int
        How many there were.
    count : numpy.ndarray
        (H, W) valid frames of each pixel.
    mean : numpy.ndarray
        (H, W) metres; NaN below one valid frame.
    variance : numpy.ndarray
        (H, W) unbiased, m^2; NaN below two.
    third, fourth : numpy.ndarray
        (H, W) central moments (sums over the count), m^3 and m^4.
    lag : numpy.ndarray
        (H, W) autocovariance from frame to frame, m^2, with its bias of -variance / count taken
        off; NaN where there are no pairs.
    right, down : numpy.ndarray
        (H, W) covariance with the next pixel in the row and in the column, m^2; NaN where there
        are no pairs.

    """

    frames: int
    count: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    lag: np.ndarray
    right: np.ndarray
    down: np.ndarray


class Accumulator:
    """
    Take frames in, give `Moments` out.

    ``reference`` is (H, W) metres, near the depth of each pixel (any surface will do): sums are
    taken of differences to it, which keeps them exact.
    """

    def __init__(self, reference: np.ndarray) -> None:
        """Start with no frame."""
        self._reference = np.ascontiguousarray(reference, np.float64)
        self._sums = np.zeros((reference.shape[0], len(_FIELDS), reference.shape[1]))
        self._last = np.full(reference.shape, np.nan)
        self._frames = 0

    def add(self, depth: np.ndarray) -> None:
        """Add (n, H, W) consecutive frames, metres, NaN where invalid."""
        _add(np.ascontiguousarray(depth, np.float32), self._reference, self._last, self._sums)
        self._frames += len(depth)

    def moments(self) -> Moments:
        """Return what the frames so far say."""
        s = {name: self._sums[:, index] for index, name in enumerate(_FIELDS)}
        count = s['count']
        with np.errstate(invalid='ignore', divide='ignore'):
            mean = np.where(count > 0, s['sum1'] / count, np.nan)
            second = s['sum2'] / count - mean**2
            third = s['sum3'] / count - 3 * mean * s['sum2'] / count + 2 * mean**3
            fourth = (
                s['sum4'] / count
                - 4 * mean * s['sum3'] / count
                + 6 * mean**2 * s['sum2'] / count
                - 3 * mean**4
            )
            variance = np.where(count > 1, second * count / (count - 1), np.nan)
            lag = s['lag_sum'] / s['lag_count'] - mean**2 + variance / count
            right, down = (
                _covariance(
                    s[f'{name}_count'], s[f'{name}_sum'], s[f'{name}_own'], s[f'{name}_other']
                )
                for name in ('right', 'down')
            )
        return Moments(
            self._frames,
            count.astype(np.int64),
            self._reference + mean,
            np.maximum(variance, 0.0),
            third,
            fourth,
            np.where(s['lag_count'] > 0, lag, np.nan),
            right,
            down,
        )


def _covariance(
    count: np.ndarray, product: np.ndarray, own: np.ndarray, other: np.ndarray
) -> np.ndarray:
    return np.where(count > 1, (product - own * other / count) / (count - 1), np.nan)


@loop(error_model='numpy')
def _add(depth, reference, last, sums):
    # Row by row, so that a row's sums stay in the fastest memory over all frames. `sums` is
    # (H, fields, W); an invalid pixel is nothing in every sum.
    frames, height, width = depth.shape
    error = np.zeros(width)
    valid = np.zeros(width)
    below = np.zeros(width)
    below_valid = np.zeros(width)
    before = np.zeros(width)
    before_valid = np.zeros(width)
    for y in range(height):
        row = sums[y]
        for x in range(width):
            seen = last[y, x] == last[y, x]
            before_valid[x] = 1.0 if seen else 0.0
            before[x] = last[y, x] if seen else 0.0
        for t in range(frames):
            for x in range(width):
                e = np.float64(depth[t, y, x]) - reference[y, x]
                seen = e == e
                valid[x] = 1.0 if seen else 0.0
                error[x] = e if seen else 0.0
            for x in range(width):
                e = error[x]
                e2 = e * e
                row[0, x] += valid[x]
                row[1, x] += e
                row[2, x] += e2
                row[3, x] += e2 * e
                row[4, x] += e2 * e2
                row[5, x] += valid[x] * before_valid[x]
                row[6, x] += e * before[x]
            for x in range(width - 1):
                row[7, x] += valid[x] * valid[x + 1]
                row[8, x] += error[x] * error[x + 1]
                row[9, x] += error[x] * valid[x + 1]
                row[10, x] += error[x + 1] * valid[x]
            if y + 1 < height:
                for x in range(width):
                    e = np.float64(depth[t, y + 1, x]) - reference[y + 1, x]
                    seen = e == e
                    below_valid[x] = 1.0 if seen else 0.0
                    below[x] = e if seen else 0.0
                for x in range(width):
                    row[11, x] += valid[x] * below_valid[x]
                    row[12, x] += error[x] * below[x]
                    row[13, x] += error[x] * below_valid[x]
                    row[14, x] += below[x] * valid[x]
            for x in range(width):
                before[x] = error[x]
                before_valid[x] = valid[x]
        for x in range(width):
            last[y, x] = before[x] if before_valid[x] > 0.0 else np.nan
