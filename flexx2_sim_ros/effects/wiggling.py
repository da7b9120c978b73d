"""Wiggling: harmonics of the modulation."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Searched, Term
from flexx2_sim_ros.effects.line_of_sight import add_along_ray, ranges
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.tables import Curve, curve_over, optional_number
from flexx2_sim_ros.formulas.fastmath import direction
from flexx2_sim_ros.formulas.scalars import f32
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_TWO = f32(2.0)


def harmonics(
    turns: float,
    a1: float,
    b1: float,
    a2: float,
    b2: float,
    a3: float,
    b3: float,
    a4: float,
    b4: float,
) -> float:
    """
    Return the shift by four harmonics of the modulation at a phase in `turns`, metres.

    ``a1`` to ``a4`` are of the sine, ``b1`` to ``b4`` of the cosine of one to four times the
    phase, metres.
    """
    c1, s1 = direction(turns)
    c2 = c1 * c1 - s1 * s1
    s2 = _TWO * s1 * c1
    c3 = c2 * c1 - s2 * s1
    s3 = s2 * c1 + c2 * s1
    c4 = c2 * c2 - s2 * s2
    s4 = _TWO * s2 * c2
    return a1 * s1 + b1 * c1 + a2 * s2 + b2 * c2 + a3 * s3 + b3 * c3 + a4 * s4 + b4 * c4


def _second_period(mhz: float) -> float:
    # Of the second harmonic, metres; and the other way round.
    return SPEED_OF_LIGHT / (4e6 * mhz)


def _with_period(period: float, *names: str) -> Hypothesis:
    # Harmonics of the frequency whose second harmonic has this period, metres: unequal taps cause
    # the second one, four taps the fourth.
    fixed = {'a4': 0.0, 'mhz': _second_period(period)}
    terms = (
        Term(
            name,
            (0.004,),
            -0.05,
            0.05,
            fixed={key: value for key, value in fixed.items() if key != name},
        )
        for name in names
    )
    return Hypothesis(f'period {period:.3g} m', tuple(terms), fixed)


@dataclass(frozen=True)
class Wiggling(Effect):
    """Harmonics of the modulation."""

    name: ClassVar[str] = 'wiggling'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 10
    title: ClassVar[str] = 'harmonics of the modulation: a bias periodic in distance'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 18 mm RMS uncalibrated, 3 mm corrected; Lindner 2010. '
        'With four taps the fourth harmonic remains'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        Hypothesis(
            label,
            tuple(
                Term(
                    name,
                    (0.004,),
                    -0.05,
                    0.05,
                    fixed={} if name == 'a4' else {'a4': 0.0},
                    along_ray=name,
                )
                for name in names
            ),
            {'a4': 0.0},
        )
        for label, names in (
            ('fourth harmonic', ('a4', 'b4')),
            ('first harmonic', ('a1', 'b1')),
            ('two harmonics', ('a1', 'b1', 'a2', 'b2')),
            ('four harmonics', ('a1', 'b1', 'a2', 'b2', 'a3', 'b3', 'a4', 'b4')),
        )
    )
    searched: ClassVar[Searched | None] = Searched(
        'wave',
        lambda found: (_with_period(found[0], 'a2', 'b2', 'a4', 'b4'),),
        lambda effect: (_second_period(effect.mhz),) if effect.mhz else (),
    )
    smooth: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'periodic in distance'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'distance'),)
    picture: ClassVar[Picture] = Picture(usecase='Mode_5_30fps')
    batched: ClassVar[tuple[str, ...] | None] = ('harmonics',)

    a1: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, one period per c/2f')
    b1: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, one period per c/2f')
    a2: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, two periods per c/2f')
    b2: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, two periods per c/2f')
    a3: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, three periods per c/2f')
    b3: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, three periods per c/2f')
    a4: float = parameter(0.0042, -0.1, 0.1, 'm', 'sine, four periods per c/2f')
    b4: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, four periods per c/2f')

    curve: Curve | None = curve_over(
        'range, m', 'm', -0.2, 0.2, 'added to the range along the ray, in place of the harmonics'
    )

    mhz: float | None = optional_number(
        'MHz', 1.0, 500.0, 'modulation frequency along the ray, in place of the mode'
    )

    def constants(self) -> dict[str, float]:
        """Return the coefficients of the harmonics, metres."""
        names = ('a1', 'b1', 'a2', 'b2', 'a3', 'b3', 'a4', 'b4')
        return {name: self.strength * getattr(self, name) for name in names}

    def apply(self, state: FrameState) -> None:
        """Add the harmonics of what has been mixed so far, at every modulation frequency."""
        if self.curve is not None:
            add_along_ray(state, self.strength, self.curve.at(ranges(state)))
            return
        if self.mhz is not None:
            turns = np.float32(2e6 * self.mhz / SPEED_OF_LIGHT)
            length = ranges(state)
            shift = np.zeros_like(length)
            _add_harmonics(length, turns, *self.rounded, shift)
            add_along_ray(state, 1.0, shift)
            return
        for frequency, shift in zip(state.mode.modulation_hz, state.shifts, strict=True):
            turns = np.float32(2.0 * frequency / SPEED_OF_LIGHT)
            _add_harmonics(state.depth, turns, *self.rounded, shift)


_harmonics = compiled(harmonics)


@loop(error_model='numpy', fastmath=FAST)
def _add_harmonics(depth, turns, a1, b1, a2, b2, a3, b3, a4, b4, shift):
    # turns: of phase a metre of depth, or of range.
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            phase = turns * (depth[y, x] + shift[y, x])
            shift[y, x] += _harmonics(phase, a1, b1, a2, b2, a3, b3, a4, b4)
