"""Warm-up drift: temperature after power-on."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, StandIn, Term
from flexx2_sim_ros.effects.line_of_sight import add_along_ray
from flexx2_sim_ros.effects.offset import Offset, SIMULATED_BIAS
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.fastmath import exp
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


def drift(seconds: float, bias: float, tau: float, uptime: float) -> float:
    """Return the shift, metres, this long after the first frame."""
    return bias * exp(-(uptime + seconds) / tau)


@dataclass(frozen=True)
class WarmUpDrift(Effect):
    """Temperature after power-on."""

    name: ClassVar[str] = 'warm_up_drift'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 14
    title: ClassVar[str] = 'temperature: a common bias that decays after power-on'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Toelgyessy 2021: 40 to 50 min on an Azure Kinect; Basler blaze: +-5 mm after 20 min'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        # In a recording it is an offset, and the smaller the longer the camera has been on.
        Hypothesis(
            f'{tau:g} s',
            (
                Term(
                    'bias',
                    (0.010,),
                    -0.1,
                    0.1,
                    stand_in=StandIn(Offset.name, 'bias', SIMULATED_BIAS, decay=tau),
                    along_ray='bias',
                ),
            ),
            {'tau': tau},
        )
        for tau in (300.0, 900.0, 2700.0)
    )
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'uptime')
    family: ClassVar[str] = 'function of time'
    compared: ClassVar[str] = 'bias'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'uptime'),)
    picture: ClassVar[Picture] = Picture('warming_up', 'first', seconds=3600.0)
    batched: ClassVar[tuple[str, ...] | None] = ('shift',)

    bias: float = parameter(0.010, -0.2, 0.2, 'm', 'bias at power-on')
    tau: float = parameter(900.0, 1.0, 36000.0, 's', 'time constant')
    uptime: float = parameter(0.0, 0.0, 1e6, 's', 'time since power-on at the first frame')

    curve: Curve | None = curve_over(
        'time since power-on, s',
        'm',
        -0.5,
        0.5,
        'added to the range along the ray, in place of bias and tau',
    )

    def constants(self) -> dict[str, float]:
        """Return the shift at power-on, metres, the time constant and the time before."""
        return {'bias': self.strength * self.bias, 'tau': self.tau, 'uptime': self.uptime}

    def apply(self, state: FrameState) -> None:
        """Add the bias of this moment."""
        seconds = np.float32((state.stamp - state.memory.first_stamp) * 1e-9)
        if self.curve is not None:
            add_along_ray(state, self.strength, self.curve.at(seconds + self.uptime))
            return
        state.add_shift(on_images(drift)(seconds, *self.rounded))
