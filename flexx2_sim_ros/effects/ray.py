"""Delays along the line of sight: what a diagnosis compares a camera with; not listed."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Searched
from flexx2_sim_ros.effects.tables import Table
from flexx2_sim_ros.effects.wiggling import harmonics, Wiggling
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.philox import FAST
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
    searched: ClassVar[Searched | None] = None
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = ()
    batched: ClassVar[tuple[str, ...] | None] = None

    bias: float = parameter(0.0, -0.5, 0.5, 'm', 'added to the distance along the ray')
    a4: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, four periods per c/2f')

    @classmethod
    def tables(cls) -> dict[str, Table]:
        """Return none: a diagnosis compares with numbers alone."""
        return {}

    def constants(self) -> dict[str, float]:
        """Return the offset and the coefficients of the harmonics, metres."""
        return {'bias': self.strength * self.bias, **super().constants()}

    def apply(self, state: FrameState) -> None:
        """Add them at every modulation frequency."""
        length = ray_length(state.intrinsics.matrix, state.depth.shape)
        for frequency, shift in zip(state.mode.modulation_hz, state.shifts, strict=True):
            turns = np.float32(2.0 * frequency / SPEED_OF_LIGHT)
            _add_along_ray(state.depth, length, turns, *self.rounded, shift)


_harmonics = compiled(harmonics)


@loop(error_model='numpy', fastmath=FAST)
def _add_along_ray(depth, length, turns, bias, a1, b1, a2, b2, a3, b3, a4, b4, shift):
    # turns: of phase a metre along the ray.
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            phase = turns * (depth[y, x] + shift[y, x]) * length[y, x]
            added = bias + _harmonics(phase, a1, b1, a2, b2, a3, b3, a4, b4)
            shift[y, x] += added / length[y, x]
