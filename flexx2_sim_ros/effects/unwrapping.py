"""Frequencies that see different mixtures of surfaces agree on one distance."""

from flexx2_sim_ros.effects.range_wrap import any_apart, wrong_jump
from flexx2_sim_ros.formulas.scalars import f32, nearest
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState
import numpy as np


def agreed_shift(
    shifts: np.ndarray,
    spans: np.ndarray,
    weights: np.ndarray,
    count: int,
    ambiguity: float,
    depth: float,
) -> float:
    """Return the shift on which frequencies agree after unwrapping, metres; see `wrong_jump`."""
    mean = f32(0.0)
    for f in range(count):
        mean += weights[f] * shifts[f]
    return mean + wrong_jump(shifts, spans, weights, count, ambiguity, depth + mean)


def rewrapped(shift: float, there: float, span: float) -> float:
    """Return a frequency's shift with those whole wraps that bring it nearest to another one."""
    return shift + nearest((there - shift) / span) * span


def agree(state: FrameState, pixels: np.ndarray, lengths: np.ndarray | float = 1.0) -> None:
    """
    Let the frequencies of some pixels agree on one distance, as a camera does that unwraps them.

    It may be far from all surfaces in the pixel. One frequency alone has nothing to agree with.
    The ``shifts`` of `state` are changed in place at the (N,) ``pixels`` of the flat image.
    ``lengths`` (N,) is the factor on depth that gives the distance whose phases are compared.
    """
    frequencies = state.mode.modulation_hz
    if len(frequencies) < 2 or not pixels.size:
        return
    shifts = np.stack([shift.reshape(-1)[pixels] * lengths for shift in state.shifts])
    apart = any_apart(frequencies, shifts)
    some, shifts = pixels[apart], shifts[:, apart].T.copy()
    scale = np.broadcast_to(np.asarray(lengths, np.float32), pixels.shape)[apart]
    spans, weights = (np.array(one, np.float32) for one in (state.spans, state.weights))
    there = state.depth.reshape(-1)[some] * scale
    _agree(shifts, there, spans, weights, np.float32(state.ambiguity))
    for f, shift in enumerate(state.shifts):
        shift.reshape(-1)[some] = shifts[:, f] / scale


_agreed_shift = compiled(agreed_shift)
_rewrapped = compiled(rewrapped)


@loop(error_model='numpy')
def _agree(shifts, depth, spans, weights, ambiguity):
    # shifts: (pixels, frequencies).
    for i in range(depth.size):
        there = _agreed_shift(shifts[i], spans, weights, spans.size, ambiguity, depth[i])
        for f in range(spans.size):
            shifts[i, f] = _rewrapped(shifts[i, f], there, spans[f])
