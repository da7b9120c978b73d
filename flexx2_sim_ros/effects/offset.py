"""Offset: a delay in the electronics."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import AS_SEARCHED, grid, Hypothesis, Searched, Term
from flexx2_sim_ros.effects.line_of_sight import add_along_ray, ranges
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.physics.frame_state import FrameState, Stage

# Metres that the diagnosis simulates. They are of the order of sigma_z of all shipped profiles:
# features are linear up to there. At 5 mm, 4 sigma_z of a Kinect v2, an offset could not be set
# off against a pose error, and was taken for one (test_shipped_profiles.py).
SIMULATED_BIAS = 0.002
_LARGEST = 0.2


def _as_large(found: tuple[float, ...]) -> tuple[Hypothesis, ...]:
    # Simulated where the search found it: features are not linear up to there.
    bias = max(-_LARGEST, min(found[0], _LARGEST))
    return (grid('bias', (bias,), -_LARGEST, _LARGEST, AS_SEARCHED),)


@dataclass(frozen=True)
class Offset(Effect):
    """A delay in the electronics."""

    name: ClassVar[str] = 'offset'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 13
    title: ClassVar[str] = 'delay in the electronics: the same bias everywhere'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'assumed; the paper set distances to 10 mm and leaves bias out'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        # One node: of a bias that poses can take over, what is left is small, and linear.
        Hypothesis('', (Term('bias', (SIMULATED_BIAS,), -0.1, 0.1, along_ray='bias'),)),
    )
    searched: ClassVar[Searched | None] = Searched(
        'constant', _as_large, lambda effect: (effect.strength * effect.bias,)
    )
    role: ClassVar[str] = 'bias'
    smooth: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'constant'
    compared: ClassVar[str] = 'bias'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', ''),)
    batched: ClassVar[tuple[str, ...] | None] = ('shift',)

    bias: float = parameter(0.005, -_LARGEST, _LARGEST, 'm', 'added to every depth')
    curve: Curve | None = curve_over(
        'range, m', 'm', -0.5, 0.5, 'added to the range along the ray, in place of bias'
    )

    def constants(self) -> dict[str, float]:
        """Return the shift of every pixel, metres; there is no other formula."""
        return {'bias': self.strength * self.bias}

    def apply(self, state: FrameState) -> None:
        """Add the bias."""
        if self.curve is not None:
            add_along_ray(state, self.strength, self.curve.at(ranges(state)))
            return
        state.add_shift(*self.rounded)
