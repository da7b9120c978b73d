"""Units of what comes in, and the likely reason why no pixel of a depth image is in range."""

from collections.abc import Callable
from dataclasses import dataclass

from flexx2_sim_ros.recording.tidying import factor_of
import numpy as np

_MILLI = 1000.0
# Values outside these limits are likely metres read in the wrong byte order.
_SMALLEST, _LARGEST = 1e-6, 1e6
_SAMPLES = 64


class ReflectivityUnit:
    """
    Bring reflectivity in percent or bytes to 0 to 1, from the first image on that tells the unit.

    ``say`` is called once, with what it is taken for.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        """Take it as it is at first."""
        self._say = say
        self._factor = 1.0

    def of(self, image: np.ndarray) -> np.ndarray:
        """Return an image (H, W) of floats from 0 to 1."""
        if self._factor == 1.0:
            sample = image[:: max(1, len(image) // _SAMPLES)]
            self._factor, note = factor_of('reflectivity', sample, 'clean/reflectivity')
            if note:
                self._say(f'{note}; it is multiplied by {self._factor:.3g}, and must be 0 to 1')
        scaled = np.nan_to_num(image) * np.float32(self._factor)
        return np.clip(scaled, 0.0, 1.0)


@dataclass(frozen=True)
class NothingInRange:
    """
    The likely reason why an image has no pixel in range, as a text for users.

    ``kind`` identifies the reason; independent of values in the text. If ``wrong``, the input is
    likely wrong; otherwise nothing is in front of the camera.
    """

    kind: str
    text: str
    wrong: bool


def sees_something(depth: np.ndarray, nearest: float, farthest: float) -> bool:
    """
    Return whether a pixel of a coarse grid is in range; False is no proof, see `explain`.

    ``depth`` is (H, W) metres, with invalid values of any kind; the range is in metres.
    """
    rows, columns = (max(1, size // _SAMPLES) for size in depth.shape)
    sample = depth[::rows, ::columns]
    return bool(((sample >= nearest) & (sample <= farthest)).any())


def explain(
    depth: np.ndarray, encoding: str, nearest: float, farthest: float
) -> NothingInRange | None:
    """
    Return why no pixel is within the range, metres; None if one is.

    ``depth`` is (H, W) metres, as decoded, with invalid values of any kind; ``encoding`` is that
    of the message: ``32FC1``, ``64FC1`` or ``16UC1``.
    """
    if ((depth >= nearest) & (depth <= farthest)).any():
        return None
    seen = depth[np.isfinite(depth) & (depth > 0)]
    if not seen.size:
        return _no_depth(depth)
    low, middle, high = (float(value) for value in (seen.min(), np.median(seen), seen.max()))
    return _wrong_unit(low, middle, high, encoding, nearest, farthest) or _out_of_range(
        low, high, nearest, farthest
    )


def _no_depth(depth: np.ndarray) -> NothingInRange:
    negative = depth[np.isfinite(depth) & (depth < 0)]
    if negative.size:
        return NothingInRange(
            'negative',
            f'values of about {_number(float(np.median(negative)))}: depth '
            "must be positive, along the optical frame's +z",
            True,
        )
    if not depth.any():
        return NothingInRange(
            'zero',
            "every pixel is 0: the renderer's depth buffer may be empty, or nothing is in view",
            True,
        )
    if (depth == -np.inf).all():
        return NothingInRange(
            'too near', 'every pixel is -inf: something is nearer than the near plane', False
        )
    counts = {
        'NaN': np.isnan(depth),
        '+inf': depth == np.inf,
        '-inf': depth == -np.inf,
        '0': depth == 0,
    }
    found = ', '.join(f'{name} {mask.mean():.0%}' for name, mask in counts.items() if mask.any())
    return NothingInRange('nothing', f'no pixel has a return ({found}): nothing is in view', False)


def _wrong_unit(
    low: float, middle: float, high: float, encoding: str, nearest: float, farthest: float
) -> NothingInRange | None:
    if encoding == '16UC1':
        if nearest <= middle * _MILLI <= farthest:
            return NothingInRange(
                'metres',
                f'values of about {_number(middle * _MILLI)}: looks like '
                'metres; 16UC1 must be millimetres (REP 118)',
                True,
            )
        return None
    if high < _SMALLEST or middle > _LARGEST:
        return NothingInRange(
            'byte order',
            f'values of {_number(low)} to {_number(high)}: looks like '
            'the wrong byte order (is_bigendian)',
            True,
        )
    if nearest <= middle / _MILLI <= farthest:
        text = f'looks like millimetres; {encoding} must be metres (REP 118)'
        if low == high:
            text += '; or the far plane, with nothing in view'
        return NothingInRange('millimetres', f'values of about {_number(middle)}: {text}', True)
    if nearest <= middle * _MILLI <= farthest:
        return NothingInRange(
            'kilometres',
            f'values of about {_number(middle)}: looks like metres '
            f'divided by 1000; {encoding} must be metres (REP 118)',
            True,
        )
    return None


def _out_of_range(low: float, high: float, nearest: float, farthest: float) -> NothingInRange:
    if low == high > farthest:
        return NothingInRange(
            'far plane',
            f'every pixel is {_number(low)} m: nothing is in view before the far plane',
            False,
        )
    what = 'too far' if low > farthest else 'too near' if high < nearest else 'too near or too far'
    return NothingInRange(
        what, f'depths of {_number(low)} to {_number(high)} m: all of them {what}', True
    )


def _number(value: float) -> str:
    return f'{value:.0f}' if 100 <= abs(value) < _LARGEST else f'{value:.3g}'
