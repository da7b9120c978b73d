"""Motion artefact: raw frames taken one after the other."""

from dataclasses import dataclass
import math
from typing import Any, ClassVar

from flexx2_sim_ros.effects.between import ALIKE_SHARE, ALIKE_SPEED
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.fastmath import arctan2, cos_sin_turns
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
from numba import njit
import numpy as np

_TAPS = 4
DARKEST = np.float32(1e-3)  # reflectivity that the light of raw frames is compared with
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)


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
        duration = self.strength * self.stretch * state.acquisition_seconds
        taps = _TAPS * len(state.shifts)
        # How far between the frame before (0) and this one (1), or after it, each was taken.
        moments = np.maximum(
            1.0 - duration / interval * (self.stamp_at - (np.arange(taps) + 0.5) / taps), 0.0
        )
        # When another surface comes into view nobody knows: at any moment between two frames.
        passing = state.uniforms(self.stream)
        for index, (k, shift) in enumerate(zip(state.wave_numbers, state.shifts, strict=True)):
            own = moments[index * _TAPS : (index + 1) * _TAPS].astype(np.float32)
            _demodulate(
                before[1],
                state.depth,
                brighter,
                passing,
                own,
                np.float32(k),
                np.float32(ALIKE_SHARE),
                np.float32(ALIKE_SPEED * interval),
                shift,
            )


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _demodulate(early, late, brighter, passing, moments, wave_number, alike, near, shift):
    # Four samples cos(phase - tap pi / 2), each at its moment, and the phase they give.
    turns = wave_number / _TWO_PI
    m0, m1, m2, m3 = moments
    for y in range(late.shape[0]):
        for x in range(late.shape[1]):
            here = late[y, x]
            start = early[y, x] - here
            same = abs(start) < max(alike * here, near)
            add = shift[y, x]
            change = passing[y, x]
            # Nearer is brighter; the same surface may have another colour there.
            light = brighter[y, x] * (_ONE if same else (here / early[y, x]) ** 2)
            c0, _ = _tap(here, start, same, change, light, m0, add, turns)
            _, s1 = _tap(here, start, same, change, light, m1, add, turns)
            c2, _ = _tap(here, start, same, change, light, m2, add, turns)
            _, s3 = _tap(here, start, same, change, light, m3, add, turns)
            real, imaginary = c0 + c2, s1 + s3
            cosine, sine = _tap(here, start, same, change, light, _ONE, add, turns)
            error = arctan2(imaginary * cosine - real * sine, real * cosine + imaginary * sine)
            shift[y, x] = add + error / wave_number if here > _ZERO and start == start else add


@njit(inline='always')
def _tap(here, start, same, change, light, moment, add, turns):
    # Cosine and sine of the phase at a moment, times the light: a surface moves evenly, another
    # surface or colour comes at once.
    passed = abs(_ONE - moment) <= change
    even = here + start * (_ONE - moment)
    phase = turns * ((even if same else here if passed else here + start) + add)
    cosine, sine = cos_sin_turns(phase - np.floor(phase))
    gain = _ONE if passed else light
    return gain * cosine, gain * sine
