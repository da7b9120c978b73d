"""Effects of a scene or camera that moves: wrong stamps, raw frames taken one after the other."""

from dataclasses import dataclass
import math
from typing import Any, ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.fastmath import arctan2, cos_sin_turns
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST, STREAM_MOTION
from numba import njit
import numpy as np

_FRAMES_KEPT = 128
_TAPS = 4
# A surface that is nearer or farther by less than the first, as a share of its distance, or than
# the second would take it, m/s, is the same in two frames (design; twice a trotting Go1).
ALIKE_SHARE = 0.05
ALIKE_SPEED = 3.0
DARKEST = np.float32(1e-3)  # reflectivity that the light of raw frames is compared with
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)


def between(early: np.ndarray, late: np.ndarray, share: float, seconds: float) -> np.ndarray:
    """
    Return what is seen at a moment between two frames, or a little after.

    A surface moves evenly; where another one has come into view, the frame that is nearer in time
    shows what there is.

    Parameters
    ----------
    early, late : numpy.ndarray
        (H, W) float32 metres.
    share : float
        0 at the time of ``early``, 1 at that of ``late``.
    seconds : float
        Between the two.

    """
    with np.errstate(invalid='ignore', over='ignore'):
        change = late - early
        same = np.abs(change) < np.maximum(
            np.float32(ALIKE_SHARE) * late, np.float32(ALIKE_SPEED * seconds)
        )
        nearer = late if share >= 0.5 else early
        return np.where(same, early + np.float32(share) * change, nearer)


@dataclass(frozen=True)
class TimeOffset(Effect):
    """Stamps that are wrong."""

    name: ClassVar[str] = 'time_offset'
    stage: ClassVar[Stage] = Stage.GEOMETRY
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'wrong stamps: the image shows the scene as it was earlier'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = (
        'a VL53L5CX on a drone: 78 ms, 46.4 to 25.1 mm once modelled; a '
        'quarter of it here (design)'
    )
    keeps: ClassVar[bool] = True

    latency: float = parameter(0.020, -0.1, 0.3, 's', 'how old the scene is at the stamp')

    def apply(self, state: FrameState) -> None:
        """Show the scene of an earlier moment, from the clean frames seen so far."""
        kept: list[tuple[int, np.ndarray, np.ndarray]]
        kept = state.memory.kept.setdefault(self.name, [])
        if kept and kept[-1][1].shape != state.depth.shape:
            kept.clear()
        if kept and kept[-1][0] == state.stamp:
            kept.pop()
        kept.append((state.stamp, state.depth.copy(), state.reflectivity.copy()))
        moment = state.stamp - round(self.strength * self.latency * 1e9)
        while len(kept) > _FRAMES_KEPT or (len(kept) > 2 and kept[1][0] <= moment):
            del kept[0]
        if len(kept) < 2 or moment <= kept[0][0]:
            _, depth, state.reflectivity = kept[0]
            state.depth = depth.copy()
            return
        index = next((i for i in range(1, len(kept)) if kept[i][0] >= moment), len(kept) - 1)
        (start, early, _), (end, late, _) = kept[index - 1 : index + 1]
        share = (moment - start) / (end - start)
        state.depth = between(early, late, share, (end - start) * 1e-9)
        state.reflectivity = kept[index if share >= 0.5 else index - 1][2]


@dataclass(frozen=True)
class MotionArtefact(Effect):
    """Raw frames taken one after the other."""

    name: ClassVar[str] = 'motion_artefact'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 5
    title: ClassVar[str] = 'raw frames one after the other: a bias that grows with speed'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 44 mm RMS at 2 m/s and 125 ms; here 9 ms in Mode_9_30fps, 5 mm at 1 m/s'
    )
    keeps: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True

    stretch: float = parameter(1.0, 0.0, 20.0, '', 'factor on the time that the raw frames take')
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
        passing = state.uniforms(STREAM_MOTION)
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
def _demodulate(  # type: ignore[no-untyped-def]
    early, late, brighter, passing, moments, wave_number, alike, near, shift
):
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
def _tap(here, start, same, change, light, moment, add, turns):  # type: ignore[no-untyped-def]
    # Cosine and sine of the phase at a moment, times the light: a surface moves evenly, another
    # surface or colour comes at once.
    passed = abs(_ONE - moment) <= change
    even = here + start * (_ONE - moment)
    phase = turns * ((even if same else here if passed else here + start) + add)
    cosine, sine = cos_sin_turns(phase - np.floor(phase))
    gain = _ONE if passed else light
    return gain * cosine, gain * sine
