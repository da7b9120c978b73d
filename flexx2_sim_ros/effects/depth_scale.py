"""Depth scale: a wrong clock or calibration."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import AS_SEARCHED, grid, Hypothesis, Searched
from flexx2_sim_ros.physics.frame_state import FrameState, Stage

_LARGEST = 0.2


def _as_large(found: tuple[float, ...]) -> tuple[Hypothesis, ...]:
    # Simulated where the search found it: features are not linear up to there.
    return (grid('fraction', found[:1], -_LARGEST, _LARGEST, AS_SEARCHED),)


@dataclass(frozen=True)
class DepthScale(Effect):
    """A wrong clock or calibration."""

    name: ClassVar[str] = 'depth_scale'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 15
    title: ClassVar[str] = 'wrong clock or calibration: a bias in proportion to distance'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'edges')
    source: ClassVar[str] = (
        'six pico flexx (astrobee, isaac of NASA): 1 to 12 % too long; Astra 1.1 %. '
        'Not known for the Flexx2: the size is assumed'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('fraction', (0.002, 0.02), -_LARGEST, _LARGEST),
    )
    searched: ClassVar[Searched | None] = Searched(
        'stretch', _as_large, lambda effect: (effect.strength * effect.fraction,)
    )
    smooth: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'line over distance'
    compared: ClassVar[str] = 'fraction'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'distance'),)
    batched: ClassVar[tuple[str, ...] | None] = ('shift',)

    fraction: float = parameter(
        0.02, -_LARGEST, _LARGEST, '', 'of each depth, by which it is too long'
    )

    def constants(self) -> dict[str, float]:
        """Return the fraction; there is no other formula."""
        return {'fraction': self.strength * self.fraction}

    def apply(self, state: FrameState) -> None:
        """Add the fraction of each depth."""
        (fraction,) = self.rounded
        state.add_shift(fraction * state.depth)
