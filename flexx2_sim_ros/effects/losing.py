"""Lose pixels at random, by a logistic."""

import math

from flexx2_sim_ros.physics.frame_state import FrameState
import numpy as np


def lose(state: FrameState, logit: np.ndarray, strength: float, stream: int) -> np.ndarray:
    """
    Lose pixels, in ``state.measured``.

    Strength is how often the chance is taken: 1 - (1 - p)^strength, with p = 1 / (1 + e^-logit).

    Parameters
    ----------
    state : FrameState
        At the stage DROPOUT.
    logit : numpy.ndarray
        (H, W) float32.
    strength : float
        The effect's.
    stream : int
        The effect's random numbers.

    Returns
    -------
    numpy.ndarray
        (H, W) bool, which were lost.

    """
    with np.errstate(over='ignore'):
        survives = (np.float32(1) + np.exp(logit)) ** np.float32(-strength)
    lost: np.ndarray = state.uniforms(stream) > survives
    state.measured[lost] = np.nan
    return lost


def log_signal(state: FrameState, half: float) -> np.ndarray:
    """Return the logarithm of the light over that at which half are lost, (H, W) float32."""
    with np.errstate(divide='ignore'):
        return np.log(state.signal) - np.float32(math.log(half))
