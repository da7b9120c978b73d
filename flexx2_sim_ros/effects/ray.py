"""Delays along the line of sight: what a diagnosis compares a camera with; not listed."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis
from flexx2_sim_ros.effects.wiggling import Wiggling
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT
import numpy as np


@dataclass(frozen=True)
class AlongRay(Wiggling):
    """
    Offset and harmonics of the distance along each pixel's ray, which is what phase measures.

    The catalogue's `offset` and `wiggling` are of depth, along the optical axis.
    """

    name: ClassVar[str] = 'along_ray'
    listed: ClassVar[bool] = False
    typical: ClassVar[bool] = False
    title: ClassVar[str] = 'offset and harmonics along the line of sight'
    source: ClassVar[str] = 'phase is measured along the ray'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = ()
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = ()
    batched: ClassVar[tuple[str, ...] | None] = None

    bias: float = parameter(0.0, -0.5, 0.5, 'm', 'added to the distance along the ray')
    a4: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, four periods per c/2f')

    def apply(self, state: FrameState) -> None:
        """Add them at every modulation frequency."""
        length = ray_length(state.intrinsics.matrix, state.depth.shape)
        for frequency, shift in zip(state.mode.modulation_hz, state.shifts, strict=True):
            step = np.float32(4.0 * math.pi * frequency / SPEED_OF_LIGHT)
            phase = step * (state.depth + shift) * length
            total = np.full_like(phase, self.bias)
            for k in (1, 2, 3, 4):
                a, b = getattr(self, f'a{k}'), getattr(self, f'b{k}')
                if a:
                    total += np.float32(a) * np.sin(np.float32(k) * phase)
                if b:
                    total += np.float32(b) * np.cos(np.float32(k) * phase)
            shift += np.float32(self.strength) * total / length


def ray_length(K: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:  # noqa: N803
    """Return (H, W) float32 how much longer each pixel's ray is than its depth, 1 or more."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    return np.sqrt(x * x + y * y + 1).astype(np.float32)
