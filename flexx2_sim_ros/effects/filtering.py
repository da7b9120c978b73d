"""What the camera does to depth before it sends it: filters and storage."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
from numba import njit
import numpy as np

RESET_SIGMAS = np.float32(6.0)


@dataclass(frozen=True)
class SpatialFilter(Effect):
    """A bilateral filter in the camera."""

    name: ClassVar[str] = 'spatial_filter'
    stage: ClassVar[Stage] = Stage.FILTER
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'bilateral filter in the camera: less noise, neighbours alike'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'neighbours')
    source: ClassVar[str] = 'Kinect v2: correlation of neighbours 0.6 to 0.7'

    mix: float = parameter(0.9, 0.0, 1.0, '', 'share of the 3 x 3 mean, at strength 1')
    gate: float = parameter(4.0, 0.5, 20.0, '', 'neighbours within this many sigma_z take part')

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with those neighbours that are alike."""
        out = np.empty_like(state.measured)
        _gated_mean(
            state.measured,
            state.sigma,
            np.float32(self.gate),
            np.float32(min(self.strength * self.mix, 1.0)),
            out,
        )
        state.measured = out


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _gated_mean(depth, sigma, gate, mix, out):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            here = depth[y, x]
            limit = gate * sigma[y, x]
            total = np.float32(0.0)
            count = np.float32(0.0)
            for yy in range(max(y - 1, 0), min(y + 2, height)):
                for xx in range(max(x - 1, 0), min(x + 2, width)):
                    difference = depth[yy, xx] - here
                    if abs(difference) <= limit:  # never true of NaN
                        total += difference
                        count += np.float32(1.0)
            out[y, x] = here + mix * total / count if count > 0 else here


@dataclass(frozen=True)
class TemporalFilter(Effect):
    """A recursive filter in the camera."""

    name: ClassVar[str] = 'temporal_filter'
    stage: ClassVar[Stage] = Stage.FILTER
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'recursive filter in the camera: less noise, frames alike'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'frames')
    source: ClassVar[str] = "vendors' adaptive temporal filters; reset at 6 sigma; share is design"
    keeps: ClassVar[bool] = True

    share: float = parameter(0.4, 0.0, 0.98, '', 'of the frame before, at strength 1')

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with the frame before, unless it has changed too much."""
        share = np.float32(min(self.strength * self.share, 0.98))
        before = state.memory.kept.get(self.name)
        if before is not None and before.shape == state.measured.shape:
            change = before - state.measured
            with np.errstate(invalid='ignore'):
                alike = np.abs(change) < RESET_SIGMAS * state.sigma
            state.measured = np.where(alike, state.measured + share * change, state.measured)
        state.memory.kept[self.name] = state.measured.copy()


@dataclass(frozen=True)
class Quantisation(Effect):
    """Storage in whole steps."""

    name: ClassVar[str] = 'quantisation'
    stage: ClassVar[Stage] = Stage.STORAGE
    title: ClassVar[str] = 'storage or fixed-point phase: depth in whole steps'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    source: ClassVar[str] = 'drivers that store millimetres; step is design'

    step: float = parameter(0.004, 1e-5, 0.2, 'm', 'between stored depths, at strength 1')

    def apply(self, state: FrameState) -> None:
        """Round to whole steps."""
        step = np.float32(self.strength * self.step)
        state.measured = np.rint(state.measured / step) * step
