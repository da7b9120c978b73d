"""Motion artefact: raw frames taken one after the other."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.moving import find_motion, TAPS
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Scale
from flexx2_sim_ros.effects.unwrapping import agree
from flexx2_sim_ros.formulas.fastmath import direction, shift_between
from flexx2_sim_ros.formulas.scalars import f32, most, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_ZERO = f32(0.0)
_ONE = f32(1.0)
_TWO_PI = f32(2.0 * math.pi)


def tap_at(
    here: float,
    start: float,
    gain: float,
    other: float,
    other_light: float,
    when: float,
    moment: float,
    add: float,
    turns: float,
) -> tuple[float, float]:
    """
    Return cosine and sine of the phase at a moment, times the light.

    A surface moves and changes its colour evenly; another one comes into view at once.
    """
    late = moment - _ONE
    beyond = (when - _ONE) * (moment - when) > _ZERO
    seen = where(beyond, other, here - start * late)
    cosine, sine = direction(turns * (seen + add))
    # Long after the frame, light that falls evenly would be below 0.
    own_light = most(_ONE - (gain - _ONE) * late, _ZERO)
    light = where(beyond, other_light, own_light)
    return light * cosine, light * sine


def motion_shift(
    here: float,
    start: float,
    gain: float,
    other: float,
    other_light: float,
    when: float,
    m0: float,
    m1: float,
    m2: float,
    m3: float,
    wave_number: float,
    add: float,
) -> float:
    """
    Return the shift of a frequency whose four taps are taken one after the other, metres.

    The taps are cos(phase - k pi / 2); they give the phase.

    Parameters
    ----------
    here : float
        Depth, metres.
    start : float
        What was to be added to it in the frame before, metres.
    gain : float
        The light of the same surface in the frame before over that in this frame.
    other : float
        Depth of the surface that was in view before or comes into view, metres.
    other_light : float
        Its light, over that of the surface in this frame.
    when : float
        When they change places: before this frame below 1, after it above; 1 is never.
    m0, m1, m2, m3 : float
        When the taps are taken, see `tap_moment`.
    wave_number : float
        Radians of phase a metre.
    add : float
        The pixel's shift so far, metres.

    """
    turns = wave_number / _TWO_PI
    c0, _0 = tap_at(here, start, gain, other, other_light, when, m0, add, turns)
    _1, s1 = tap_at(here, start, gain, other, other_light, when, m1, add, turns)
    c2, _2 = tap_at(here, start, gain, other, other_light, when, m2, add, turns)
    _3, s3 = tap_at(here, start, gain, other, other_light, when, m3, add, turns)
    cosine, sine = direction(turns * (here + add))  # What a tap at this frame's time sees.
    return shift_between(c0 + c2, s1 + s3, cosine, sine, wave_number)


_motion_shift = compiled(motion_shift)


@dataclass(frozen=True)
class MotionArtefact(Effect):
    """
    Raw frames taken one after the other.

    A surface that moves away or comes nearer gets a bias. Where an edge passes, raw frames see
    both of its sides: edges are found in the frame before, and go on at the same speed. If the
    frequencies see different sides, they agree on a distance that may be far from both.
    """

    name: ClassVar[str] = 'motion_artefact'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 5
    title: ClassVar[str] = (
        'raw frames taken one after the other: bias that grows with speed, errors at moving edges'
    )
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 44 mm RMS at 2 m/s and 125 ms; here 9 ms in Mode_9_30fps: 5 mm at 1 m/s'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        # What the driver stamps: the last raw frame, or the first.
        grid('stretch', (0.5, 1.0, 2.0), 0.0, 3.0, f'stamp at {stamp:g}', stamp_at=stamp)
        for stamp in (1.0, 0.0)
    )
    scale: ClassVar[Scale | None] = Scale(
        'duration of the raw frames, and the stamp',
        'stretch',
        3.0,
        ({'stamp_at': 1.0}, {'stamp_at': 0.0}),
    )
    needs_motion: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'edges')
    family: ClassVar[str] = 'sequence of raw frames'
    picture: ClassVar[Picture] = Picture('moving')
    stream: ClassVar[int] = 10
    batched: ClassVar[tuple[str, ...] | None] = ('motion', 'taps')

    stretch: float = parameter(1.0, 0.0, 20.0, '', 'factor on the duration of the raw frames')
    stamp_at: float = parameter(
        1.0, 0.0, 1.0, '', 'when in that time the stamp is: 0 at its beginning, 1 at its end'
    )

    def constants(self) -> dict[str, float]:
        """Return the factor on the raw frames' duration, and when in it the stamp is."""
        return {'stretch': self.strength * self.stretch, 'stamp_at': self.stamp_at}

    def apply(self, state: FrameState) -> None:
        """Take each frequency's four taps at their own moments, and unwrap what comes out."""
        stretch, stamp_at = self.constants().values()
        found = find_motion(state, state.depth, self, stretch, stamp_at)
        if found is None:
            return
        moments, motion = found
        for index, (k, shift) in enumerate(zip(state.wave_numbers, state.shifts, strict=True)):
            own = moments[index * TAPS : (index + 1) * TAPS]
            _demodulate(state.depth, motion, own, np.float32(k), shift)
        # Frequencies that saw different surfaces.
        agree(state, np.flatnonzero(motion[-1] != _ONE))


@loop(error_model='numpy', fastmath=FAST)
def _demodulate(late, motion, moments, wave_number, shift):
    m0, m1, m2, m3 = moments
    for y in range(late.shape[0]):
        for x in range(late.shape[1]):
            here, add = late[y, x], shift[y, x]
            start, gain = motion[0, y, x], motion[1, y, x]
            other, light, when = motion[2, y, x], motion[3, y, x], motion[4, y, x]
            more = _motion_shift(
                here, start, gain, other, light, when, m0, m1, m2, m3, wave_number, add
            )
            shift[y, x] = add + more if here > _ZERO else add
