"""Light as complex numbers, whose angle is its phase."""

import math

from flexx2_sim_ros.formulas import phases as formulas
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_direction = compiled(formulas.direction)
_shift_between = compiled(formulas.shift_between)


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
