"""Motion artefact: raw frames taken one after the other."""

from dataclasses import dataclass
import math
from typing import Any, ClassVar

from flexx2_sim_ros.effects.between import alike
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.phases import direction, shift_between
from flexx2_sim_ros.formulas.scalars import f32, most, size, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

TAPS = 4
DARKEST = f32(1e-3)  # reflectivity that the light of raw frames is compared with
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)
_TWO_PI = f32(2.0 * math.pi)


def tap_moment(tap: float, taps: float, acquisition: float, stamp_at: float) -> float:
    """
    Return when a raw frame is taken: 0 at the frame before, 1 at this one; never before 0.

    Parameters
    ----------
    tap, taps : float
        Which raw frame out of how many.
    acquisition : float
        The time that all of them take, over the time between two frames.
    stamp_at : float
        When in that time the stamp is, 0..1.

    """
    return most(_ONE - acquisition * (stamp_at - (tap + _HALF) / taps), _ZERO)


def tap_at(
    here: float,
    start: float,
    same: bool,
    change: float,
    light: float,
    moment: float,
    add: float,
    turns: float,
) -> tuple[float, float]:
    """
    Return cosine and sine of the phase at a moment, times the light.

    A surface moves evenly, another surface or colour comes at once.
    """
    passed = size(_ONE - moment) <= change
    even = here + start * (_ONE - moment)
    seen = where(same, even, where(passed, here, here + start))
    cosine, sine = direction(turns * (seen + add))
    gain = where(passed, _ONE, light)
    return gain * cosine, gain * sine


def motion_shift(
    here: float,
    start: float,
    brighter: float,
    change: float,
    seconds: float,
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
    brighter : float
        Reflectivity in the frame before over the one in this frame.
    change : float
        How long before this frame another surface comes into view; 1 is the frame before.
    seconds : float
        Between the frames.
    m0, m1, m2, m3 : float
        When the taps are taken, see `tap_moment`.
    wave_number : float
        Radians of phase a metre.
    add : float
        The pixel's shift so far, metres.

    """
    same = alike(start, here, seconds)
    # Nearer is brighter; the same surface may have another colour there.
    further = here / (here + start)
    light = brighter * where(same, _ONE, further * further)
    turns = wave_number / _TWO_PI
    c0, _0 = tap_at(here, start, same, change, light, m0, add, turns)
    _1, s1 = tap_at(here, start, same, change, light, m1, add, turns)
    c2, _2 = tap_at(here, start, same, change, light, m2, add, turns)
    _3, s3 = tap_at(here, start, same, change, light, m3, add, turns)
    cosine, sine = tap_at(here, start, same, change, light, _ONE, add, turns)
    return shift_between(c0 + c2, s1 + s3, cosine, sine, wave_number)


_motion_shift = compiled(motion_shift)


@dataclass(frozen=True)
class MotionArtefact(Effect):
    """Raw frames taken one after the other."""

    name: ClassVar[str] = 'motion_artefact'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 5
    title: ClassVar[str] = 'raw frames taken one after the other: a bias that grows with speed'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 44 mm RMS at 2 m/s and 125 ms; here 9 ms in Mode_9_30fps: 5 mm at 1 m/s'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        # What the driver stamps: the last raw frame, or the first.
        grid('stretch', (1.0, 2.0), 0.0, 3.0, f'stamp at {stamp:g}', stamp_at=stamp)
        for stamp in (1.0, 0.0)
    )
    needs_motion: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'edges')
    family: ClassVar[str] = 'sequence of raw frames'
    picture: ClassVar[Picture] = Picture('moving')
    stream: ClassVar[int] = 10
    batched: ClassVar[tuple[str, ...] | None] = ('surfaces',)

    stretch: float = parameter(1.0, 0.0, 20.0, '', 'factor on the duration of the raw frames')
    stamp_at: float = parameter(
        1.0,
        0.0,
        1.0,
        '',
        'when in that time the stamp is: 0 before the first raw frame, 1 after the last',
    )

    def constants(self) -> dict[str, float]:
        """Return the factor on the raw frames' duration, and when in it the stamp is."""
        return {'stretch': self.strength * self.stretch, 'stamp_at': self.stamp_at}

    def apply(self, state: FrameState) -> None:
        """Take each frequency's four taps at their own moments."""
        before: Any = state.memory.kept.get(self.name)
        shown = state.depth.shape
        rho = np.maximum(state.reflectivity, DARKEST)
        state.memory.kept[self.name] = (state.stamp, state.depth.copy(), rho)
        if (
            before is None
            or before[0] >= state.stamp
            or before[1].shape != shown
            or (
                np.array_equal(before[1], state.depth, equal_nan=True)
                and np.array_equal(before[2], rho)
            )
        ):
            return
        brighter = np.ascontiguousarray(np.broadcast_to(before[2] / rho, shown))
        interval = (state.stamp - before[0]) * 1e-9
        duration = self.constants()['stretch'] * state.acquisition_seconds
        taps = TAPS * len(state.shifts)
        moments = on_images(tap_moment)(np.arange(taps), taps, duration / interval, self.stamp_at)
        # Another surface comes into view at an unknown moment between two frames: a random one.
        passing = state.uniforms(self.stream)
        for index, (k, shift) in enumerate(zip(state.wave_numbers, state.shifts, strict=True)):
            own = moments[index * TAPS : (index + 1) * TAPS].astype(np.float32)
            _demodulate(
                before[1],
                state.depth,
                brighter,
                passing,
                own,
                np.float32(k),
                np.float32(interval),
                shift,
            )


@loop(error_model='numpy', fastmath=FAST)
def _demodulate(early, late, brighter, passing, moments, wave_number, seconds, shift):
    m0, m1, m2, m3 = moments
    for y in range(late.shape[0]):
        for x in range(late.shape[1]):
            here = late[y, x]
            start = early[y, x] - here
            add = shift[y, x]
            more = _motion_shift(
                here,
                start,
                brighter[y, x],
                passing[y, x],
                seconds,
                m0,
                m1,
                m2,
                m3,
                wave_number,
                add,
            )
            shift[y, x] = add + more if here > _ZERO and start == start else add
