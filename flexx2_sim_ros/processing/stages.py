"""The stages: functions of images (..., H, W) float32, NaN where invalid."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processing.filters import Fill, Smooth, Spatial
from flexx2_sim_ros.processing.stage import option, Stage
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

_LARGEST = 8192  # pixels on a side; assumed: more than any depth camera has
_NAN = np.float32(np.nan)
_EARLY = 0.01  # of a period, for stamps that are rounded; a definition


@dataclass(frozen=True)
class Crop(Stage):
    """Cut pixels off."""

    name: ClassVar[str] = 'crop'
    left: int = option(0, 0, _LARGEST)
    top: int = option(0, 0, _LARGEST)
    right: int = option(0, 0, _LARGEST)
    bottom: int = option(0, 0, _LARGEST)

    def lens(self, camera: Intrinsics) -> Intrinsics:
        """Return the lens with its principal point moved."""
        width = camera.width - self.left - self.right
        height = camera.height - self.top - self.bottom
        if width < 1 or height < 1:
            raise InputError(
                f'crop: must leave pixels of {camera.width} x {camera.height}, got none'
            )
        moved = camera.cx - self.left, camera.cy - self.top
        return replace(camera, width=width, height=height, cx=moved[0], cy=moved[1])

    def picked(self, images: np.ndarray) -> np.ndarray:
        """Return the pixels that stay."""
        height, width = images.shape[-2:]
        return images[..., self.top : height - self.bottom, self.left : width - self.right]

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the pixels that stay."""
        return self.picked(images)


@dataclass(frozen=True)
class Resize(Stage):
    """
    Change the size; pixel centres keep their directions.

    ``area`` and ``bilinear`` average valid pixels. The result is invalid where less than ``share``
    of the weight is valid.
    """

    name: ClassVar[str] = 'resize'
    width: int = option(64, 1, _LARGEST)
    height: int = option(64, 1, _LARGEST)
    method: str = option('nearest', choices=('nearest', 'area', 'bilinear'))
    share: float = option(0.5, 0.0, 1.0)  # assumed

    def lens(self, camera: Intrinsics) -> Intrinsics:
        """Return the lens with the same field of view."""
        return replace(camera.resized(self.width, self.height), distortion=camera.distortion)

    def picked(self, images: np.ndarray) -> np.ndarray:
        """Return the nearest pixels."""
        rows, columns = (
            np.minimum((np.arange(new) + 0.5) * old / new, old - 1).astype(int)
            for new, old in zip((self.height, self.width), images.shape[-2:], strict=True)
        )
        return images[..., rows[:, np.newaxis], columns]

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the images in the other size."""
        if self.method == 'nearest':
            return self.picked(images)
        down = _weights(self.method, images.shape[-2], self.height)
        across = _weights(self.method, images.shape[-1], self.width).T
        valid = np.isfinite(images)
        weight = down @ valid.astype(np.float32) @ across
        total = down @ np.where(valid, images, np.float32(0)) @ across
        # A weight of 1 is a sum with a rounding error.
        enough = (weight > 0) & (weight >= np.float32(self.share - 1e-5))
        return np.where(enough, total / np.where(enough, weight, np.float32(1)), _NAN)


@lru_cache(maxsize=16)
def _weights(method: str, old: int, new: int) -> np.ndarray:
    # (new, old), of each row the sum is 1.
    if method == 'area':
        edges = np.linspace(0, old, new + 1)
        pixels = np.arange(old)
        inside = np.minimum(edges[1:, np.newaxis], pixels + 1)
        inside = np.clip(inside - np.maximum(edges[:-1, np.newaxis], pixels), 0, None)
    else:
        place = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
        inside = np.clip(1 - np.abs(place[:, np.newaxis] - np.arange(old)), 0, None)
    return (inside / inside.sum(axis=1, keepdims=True)).astype(np.float32)


@dataclass(frozen=True)
class Decimate(Stage):
    """Take the median of the valid pixels of each block; what is left over is cut off."""

    name: ClassVar[str] = 'decimate'
    factor: int = option(2, 1, 16)

    def lens(self, camera: Intrinsics) -> Intrinsics:
        """Return the lens of the blocks."""
        width, height = camera.width // self.factor, camera.height // self.factor
        if not width or not height:
            raise InputError(f'decimate.factor: must be below the image size, got {self.factor}')
        whole = replace(camera, width=width * self.factor, height=height * self.factor)
        return replace(whole.resized(width, height), distortion=camera.distortion)

    def _blocks(self, images: np.ndarray) -> np.ndarray:
        # (factor^2, ..., h, w)
        height, width = (size // self.factor * self.factor for size in images.shape[-2:])
        steps = range(self.factor)
        cut = images[..., :height, :width]
        return np.stack(
            [cut[..., i :: self.factor, j :: self.factor] for i in steps for j in steps]
        )

    def picked(self, images: np.ndarray) -> np.ndarray:
        """Return a pixel beside the middle of each block."""
        return self._blocks(images)[(self.factor // 2) * (self.factor + 1)]

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the medians."""
        return _median(self._blocks(images))


def _median(stack: np.ndarray) -> np.ndarray:
    # Of the valid values along the first axis; of an even number the lower one.
    ordered = np.sort(stack, axis=0)  # NaN last
    valid = np.isfinite(stack).sum(axis=0)
    return np.take_along_axis(ordered, np.maximum(valid - 1, 0)[np.newaxis] // 2, axis=0)[0]


@dataclass(frozen=True)
class Median(Stage):
    """Take the median of the valid pixels around each valid pixel; invalid ones stay invalid."""

    name: ClassVar[str] = 'median'
    size: int = option(3, 1, 7)

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return the medians."""
        before, after = self.size // 2, (self.size - 1) // 2
        edges = [(0, 0)] * (images.ndim - 2) + [(before, after)] * 2
        padded = np.pad(images, edges, constant_values=_NAN)
        height, width = images.shape[-2:]
        around = [
            padded[..., i : i + height, j : j + width]
            for i in range(self.size)
            for j in range(self.size)
        ]
        return np.where(np.isfinite(images), _median(np.stack(around)), _NAN)


@dataclass(frozen=True)
class Clip(Stage):
    """Limit depth to a range, or make what is beyond invalid."""

    name: ClassVar[str] = 'clip'
    low: float = option(0.0, 0.0, 1000.0)
    high: float = option(10.0, 0.0, 1000.0)
    beyond: str = option('limit', choices=('limit', 'invalid'))

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return depth within the range."""
        low, high = np.float32(self.low), np.float32(self.high)
        if self.beyond == 'limit':
            return np.clip(images, low, high)
        with np.errstate(invalid='ignore'):
            return np.where((images >= low) & (images <= high), images, _NAN)


@dataclass(frozen=True)
class Normalise(Stage):
    """Map ``low`` to 0 and ``high`` to 1, metres; invalid pixels become ``invalid``."""

    name: ClassVar[str] = 'normalise'
    in_metres: ClassVar[bool] = False
    low: float = option(0.0, 0.0, 1000.0)
    high: float = option(1.0, 0.0, 1000.0)
    invalid: float = option(0.0, -1000.0, 1000.0)

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        super().__post_init__()
        if not self.low < self.high:
            raise InputError(f'normalise.high: must be above {self.low:g}, got {self.high:g}')

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return numbers without NaN."""
        scaled = (images - np.float32(self.low)) / np.float32(self.high - self.low)
        return np.where(np.isfinite(scaled), scaled, np.float32(self.invalid))


@dataclass(frozen=True)
class Rate(Stage):
    """Leave moments out: one each ``1 / hz`` stays."""

    name: ClassVar[str] = 'rate'
    leaves_out: ClassVar[bool] = True
    hz: float = option(10.0, 0.01, 1000.0)

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray | None:
        """Return the images, or None when they are not due."""
        period = round(1e9 / self.hz)
        due = memory.setdefault('due', stamp)
        if stamp < due - _EARLY * period:
            return None
        late = max(stamp - due, 0)
        memory['due'] = due + (late // period + 1) * period
        return images


@dataclass(frozen=True)
class Delay(Stage):
    """Show the newest image that is at least this old; at the start the first one."""

    name: ClassVar[str] = 'delay'
    seconds: float = option(0.1, 0.0, 10.0)

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray:
        """Return an earlier image."""
        stamps = memory.setdefault('stamps', [])
        kept = memory.setdefault('images', [])
        if memory.pop('masked', False):  # of environments that begin anew, the image of now
            for one in kept:
                one[...] = np.where(np.isnan(one).all(axis=(-2, -1), keepdims=True), images, one)
        stamps.append(stamp)
        kept.append(images.copy())
        moment = stamp - round(self.seconds * 1e9)
        while len(stamps) > 1 and stamps[1] <= moment:
            del stamps[0], kept[0]
        return np.array(kept[0])


STAGES: tuple[type[Stage], ...] = (
    Crop, Resize, Decimate, Median, Spatial, Smooth, Fill, Clip, Normalise, Rate, Delay,
)  # fmt: skip
