"""Wiggling: harmonics of the modulation."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Term
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
import numpy as np


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
    smooth: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'periodic in distance'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'distance'),)
    picture: ClassVar[Picture] = Picture(usecase='Mode_5_30fps')
    batched: ClassVar[tuple[str, ...] | None] = ()

    a1: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, one period per c/2f')
    b1: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, one period per c/2f')
    a2: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, two periods per c/2f')
    b2: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, two periods per c/2f')
    a3: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, three periods per c/2f')
    b3: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, three periods per c/2f')
    a4: float = parameter(0.0042, -0.1, 0.1, 'm', 'sine, four periods per c/2f')
    b4: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, four periods per c/2f')

    def apply(self, state: FrameState) -> None:
        """Add the harmonics of what has been mixed so far, at every modulation frequency."""
        for frequency, shift in zip(state.mode.modulation_hz, state.shifts, strict=True):
            step = np.float32(2.0 * math.pi * 2.0 * frequency / SPEED_OF_LIGHT)
            phase = step * (state.depth + shift)
            for k in (1, 2, 3, 4):
                a, b = getattr(self, f'a{k}'), getattr(self, f'b{k}')
                if a:
                    shift += np.float32(self.strength * a) * np.sin(np.float32(k) * phase)
                if b:
                    shift += np.float32(self.strength * b) * np.cos(np.float32(k) * phase)
