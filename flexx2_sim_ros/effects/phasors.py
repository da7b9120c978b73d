"""Light as complex numbers, whose angle is its phase."""

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.formulas import fastmath
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_direction = compiled(fastmath.direction)
_shift_between = compiled(fastmath.shift_between)


@loop(error_model='numpy', fastmath=FAST)
def _directions(depth, shift, turns, out):
    # The phase of each pixel as a complex number of magnitude 1; 0 where there is no return.
    # `turns`: turns of phase per metre.
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            phase = turns * (depth[y, x] + shift[y, x])
            cosine, sine = _direction(phase if phase == phase else np.float32(0.0))
            out[y, x] = complex(cosine, sine) if depth[y, x] > 0 else complex(0.0, 0.0)


@loop(error_model='numpy', fastmath=FAST)
def turn(before, after, wave_number, shift):
    """Shift depth by what the phase has turned; all flat."""
    for i in range(before.size):
        now, was = after[i], before[i]
        shift[i] += _shift_between(now.real, now.imag, was.real, was.imag, wave_number)


def phases(state: FrameState, wave_number: float, shift: np.ndarray) -> np.ndarray:
    """Return (H, W) complex64 of magnitude 1: the phase of each pixel, 0 without a return."""
    out = np.empty(state.depth.shape, np.complex64)
    _directions(state.depth, shift, np.float32(wave_number / (2.0 * math.pi)), out)
    return out


def own_frequency() -> Any:
    """Declare the modulation frequency that an effect works at; see `waves`."""
    return optional_number(
        'MHz', 1.0, 500.0, 'modulation frequency along the ray, in place of the mode'
    )


def frequency_factor() -> Any:
    """Declare a factor on the mode's frequencies; see `waves`."""
    return optional_number('', 0.1, 10.0, "factor on the mode's frequencies, along the ray")


@dataclass(frozen=True)
class Wave:
    """
    The light at one modulation frequency, whose `number` is in radians of phase a metre.

    Attributes
    ----------
    weight : float
        Of its distance in the depth.
    shift : numpy.ndarray
        (H, W) float32 metres of depth, what was added so far at this frequency.
    shifts : list of numpy.ndarray
        Those of the state that a turn of the phase changes.
    ray : numpy.ndarray or None
        (H, W) length of the rays if the phase is that of the range; None if it is that of depth.

    """

    state: FrameState
    number: float
    weight: float
    shift: np.ndarray
    shifts: list[np.ndarray]
    ray: np.ndarray | None = None

    def directions(self) -> np.ndarray:
        """Return (H, W) complex64 of magnitude 1: the phase of each pixel, 0 without a return."""
        if self.ray is None:
            return phases(self.state, self.number, self.shift)
        out = np.empty(self.shift.shape, np.complex64)
        turns = np.float32(self.number / (2.0 * math.pi))
        _directions(self.state.depth * self.ray, self.shift * self.ray, turns, out)
        return out

    def turn(self, before: np.ndarray, after: np.ndarray, pixels: Any = slice(None)) -> None:
        """
        Shift depth by what the phase has turned between `before` and `after`, in place.

        They are (N,) complex64, the light of some `pixels` of the flat image.
        """
        turned = np.zeros(before.size, np.float32)
        turn(before, after, np.float32(self.number), turned)
        if self.ray is not None:
            turned /= self.ray.reshape(-1)[pixels]
        for shift in self.shifts:
            shift.reshape(-1)[pixels] += turned


def waves(state: FrameState, mhz: float | None, factor: float | None) -> Iterator[Wave]:
    """
    Yield the modulation frequencies that an effect on phases works at in a frame.

    ``mhz`` is one frequency, MHz, for a camera whose frequencies differ from its profile's,
    ``factor`` a factor on the mode's. The phase is then that of the range along the ray. With
    neither it is the mode's frequencies and the phase of depth, as in the kernels of
    `flexx2_sim_ros.batch`.
    """
    ray = None
    if mhz is not None or factor is not None:
        ray = ray_length(state.intrinsics.matrix, state.depth.shape).astype(np.float32)
    if mhz is not None:
        parts = zip(state.weights, state.shifts, strict=True)
        whole = np.sum([np.float32(weight) * shift for weight, shift in parts], axis=0)
        number = 4.0 * math.pi * 1e6 * mhz / SPEED_OF_LIGHT
        yield Wave(state, number, 1.0, whole, state.shifts, ray)
        return
    for number, weight, shift in zip(state.wave_numbers, state.weights, state.shifts, strict=True):
        yield Wave(state, number * (factor or 1.0), weight, shift, [shift], ray)
