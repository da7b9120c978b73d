"""Stages that smooth and fill: functions of images (..., H, W) float32, NaN where invalid."""

from dataclasses import dataclass
from typing import Any, ClassVar

from flexx2_sim_ros.physics.compiled import inlined, loop
from flexx2_sim_ros.physics.nearest import nearest_pixels
from flexx2_sim_ros.processing.stage import option, Stage
import numpy as np

_NAN = np.float32(np.nan)
# Smaller changes end the iterations of `inpaint`, metres; a hundredth of the storage step.
_STILL = np.float32(1e-5)
# Of librealsense's persistency 0 to 8: a lost pixel keeps its value if so many of so many images
# before this one had it. Nothing is lost for ever with 8.
_PERSISTENCY = (9, 8), (8, 8), (2, 3), (2, 4), (2, 8), (1, 2), (1, 5), (1, 8), (0, 8)
# (9, 256) bool: whether it does, by the last 8 images as bits; the newest is the lowest bit.
_PERSISTS = np.array(
    [
        [(bits & ((1 << last) - 1)).bit_count() >= least for bits in range(256)]
        for least, last in _PERSISTENCY
    ]
)


@dataclass(frozen=True)
class Spatial(Stage):
    """
    Average along rows and columns, up and down, where neighbours are within ``delta``.

    The edge-preserving filter of librealsense (src/proc/spatial-filter.h) on depth in metres.
    Along rows, fewer than ``radius`` pixels of a hole are filled from each side; 0 fills none.
    With a ``step`` depth is a whole number of steps, rounded as there.
    """

    name: ClassVar[str] = 'spatial'
    alpha: float = option(0.5, 0.25, 1.0)  # this and what follows: librealsense's defaults
    delta: float = option(0.02, 0.0, 10.0)  # metres; 20 steps of 1 mm there
    iterations: int = option(2, 1, 5)
    radius: int = option(0, 0, 255)  # there 0, 2, 4, 8, 16 or 255
    step: float = option(0.0, 0.0, 0.1)  # metres; there 0.001, or disparities in floating point

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the averages."""
        out, delta, unit = _in_steps(images, self.delta, self.step)
        numbers = np.float32(self.alpha), delta, self.step > 0
        _smooth_lines(out.reshape(-1, *out.shape[-2:]), *numbers, self.iterations, self.radius)
        return out * unit


def _in_steps(
    images: np.ndarray, delta: float, step: float
) -> tuple[np.ndarray, np.float32, np.float32]:
    # Images, in whole steps if there are such, a distance in the same unit, and this unit.
    out = np.array(images, np.float32, order='C')
    if not step:
        return out, np.float32(delta), np.float32(1)
    return np.rint(out / np.float32(step)), np.float32(round(delta / step, 3)), np.float32(step)


@inlined
def _smooth_line(line, alpha, delta, whole, radius):  # type: ignore[no-untyped-def]
    before = line[0]
    filled = 0
    for i in range(1, line.size):
        here = line[i]
        if not np.isnan(before):
            if not np.isnan(here):
                filled = 0
                if abs(here - before) <= delta:
                    here = alpha * here + (np.float32(1) - alpha) * before
                    if whole:
                        here = np.floor(here + np.float32(0.5))
                    line[i] = here
            else:
                filled += 1
                if filled < radius:
                    here = before
                    line[i] = here
        before = here


@loop(error_model='numpy')
def _smooth_lines(images, alpha, delta, whole, iterations, radius):  # type: ignore[no-untyped-def]
    below = np.nextafter(delta, np.float32(0))  # Down, a difference of `delta` is an edge.
    for n in range(images.shape[0]):
        image = images[n]
        for _ in range(iterations):
            for y in range(image.shape[0]):
                _smooth_line(image[y, :-1], alpha, delta, whole, radius)  # as librealsense does
                _smooth_line(image[y, ::-1], alpha, delta, whole, radius)
            for x in range(image.shape[1]):
                _smooth_line(image[:, x], alpha, below, whole, 0)
                _smooth_line(image[::-1, x], alpha, below, whole, 0)


@dataclass(frozen=True)
class Smooth(Stage):
    """
    Average over time: ``alpha`` of the new image, where it is within ``delta`` of the old.

    The temporal filter of librealsense (src/proc/temporal-filter.h) on depth in metres, with its
    ``persistency``: when a lost pixel keeps its value. 0 is never, 8 always. With a ``step`` depth
    is a whole number of steps, rounded down as there.
    """

    name: ClassVar[str] = 'smooth'
    alpha: float = option(0.4, 0.0, 1.0)  # librealsense's default, as is
    delta: float = option(0.02, 0.0, 10.0)  # metres; librealsense's default of 20 steps of 1 mm
    persistency: int = option(0, 0, 8)  # librealsense's default is 3
    step: float = option(0.0, 0.0, 0.1)  # as that of `Spatial`

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the averages."""
        now, delta, unit = _in_steps(images, self.delta, self.step)
        last = memory.get('last', np.full_like(now, _NAN))
        before = memory.get('seen', np.zeros(now.shape, np.uint8))
        valid = np.isfinite(now)
        with np.errstate(invalid='ignore'):
            near = np.abs(now - last) < delta
        alpha = np.float32(self.alpha)
        mean = alpha * now + (1 - alpha) * last
        new = np.where(near, np.floor(mean) if self.step else mean, now)
        persists = _PERSISTS[self.persistency][before]
        memory['last'] = np.where(valid, new, last)
        memory['seen'] = np.where(near | ~valid, before << 1, 0).astype(np.uint8) | valid
        return np.where(valid | ~persists, new, last) * unit


@dataclass(frozen=True)
class Fill(Stage):
    """
    Fill invalid pixels.

    ``nearest``: with the nearest valid pixel of the image. ``inpaint``: with a smooth surface,
    each pixel the mean of those beside it, after at most ``iterations``. ``temporal``: with the
    last valid value of the pixel, for up to ``seconds``.
    """

    name: ClassVar[str] = 'fill'
    method: str = option('nearest', choices=('nearest', 'inpaint', 'temporal'))
    seconds: float = option(0.5, 0.0, 60.0)  # assumed
    iterations: int = option(100, 1, 1000)  # assumed: enough for holes of 100 pixels

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return images with fewer holes."""
        valid = np.isfinite(images)
        if self.method == 'temporal':
            if 'last' not in memory:
                memory['last'] = np.full_like(images, _NAN)
                memory['seen'] = np.zeros(images.shape, np.int64)
            last, seen = memory['last'], memory['seen']
            last[valid], seen[valid] = images[valid], stamp
            return np.where(stamp - seen <= round(self.seconds * 1e9), last, _NAN)
        out = np.array(images, np.float32)
        for index in np.ndindex(images.shape[:-2]):
            known = valid[index]
            if known.any() and not known.all():
                nearest = nearest_pixels(known)
                out[index] = images[index][nearest]
                if self.method == 'inpaint':
                    _inpaint(out[index], known, nearest, self.iterations)
        return out


def _inpaint(
    image: np.ndarray, known: np.ndarray, nearest: tuple[np.ndarray, np.ndarray], iterations: int
) -> None:
    # In place, by successive over-relaxation (Young 1954) from the nearest pixels, with the
    # factor that is best for a square hole as wide as the widest.
    rows, columns = np.nonzero(~known)
    away = np.hypot(nearest[0][rows, columns] - rows, nearest[1][rows, columns] - columns)
    factor = 2 / (1 + np.sin(np.pi / (2 * away.max() + 1)))
    _relax(image, rows, columns, np.float32(factor), iterations, _STILL)


@loop(error_model='numpy')
def _relax(image, rows, columns, factor, iterations, still):  # type: ignore[no-untyped-def]
    height, width = image.shape
    for _ in range(iterations):
        largest = np.float32(0)
        for k in range(rows.size):
            y, x = rows[k], columns[k]
            total, count = np.float32(0), np.float32(0)
            if y > 0:
                total, count = total + image[y - 1, x], count + 1
            if y < height - 1:
                total, count = total + image[y + 1, x], count + 1
            if x > 0:
                total, count = total + image[y, x - 1], count + 1
            if x < width - 1:
                total, count = total + image[y, x + 1], count + 1
            change = factor * (total / count - image[y, x])
            image[y, x] += change
            largest = max(largest, abs(change))
        if largest < still:
            break
