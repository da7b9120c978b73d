"""Lose pixels at random, by a logistic, and what a diagnosis simulates of that."""

from flexx2_sim_ros.effects.hypothesis import Hypothesis, Term
from flexx2_sim_ros.formulas.fastmath import exp, power
from flexx2_sim_ros.formulas.scalars import f32
from flexx2_sim_ros.physics.frame_state import FrameState
import numpy as np

_ONE = f32(1.0)


def survival(logit: float, strength: float) -> float:
    """
    Return the chance, 0..1, that a pixel stays valid: (1 - p)^strength.

    p = 1 / (1 + e^-logit) is the chance to be lost.
    """
    return power(_ONE + exp(logit), -strength)


def kept_by(lost: np.ndarray, strength: float) -> np.ndarray:
    """Return the chance to stay valid, float32, where ``lost`` is that to be lost: (1 - p)^s."""
    return np.asarray((1 - lost) ** np.float32(strength), np.float32)


def lose(state: FrameState, survives: np.ndarray, stream: int) -> np.ndarray:
    """
    Lose pixels in ``state.measured``, at the stage DROPOUT; return which, (H, W) bool.

    ``survives`` is (H, W) float32, the chance of each pixel to stay valid; ``stream`` are the
    effect's random numbers.
    """
    lost: np.ndarray = state.uniforms(stream) > survives
    state.measured[lost] = np.nan
    return lost


def lost_by(label: str, **threshold: float) -> Hypothesis:
    """Return a variant of a threshold beyond which pixels are lost; its strength is fitted."""
    return Hypothesis(label, (Term('strength', (0.4, 1.6), 0.0, 4.0, fixed=threshold),), threshold)


def lost_beyond(*amplitudes: float) -> tuple[Hypothesis, ...]:
    """Return a variant for each amplitude at which half of the pixels are lost."""
    return tuple(lost_by(f'half {half:g}', half=half) for half in amplitudes)


def lost_as_found(found: tuple[float, ...]) -> tuple[Hypothesis, ...]:
    """Return the variant with the amplitude and the slope that a search has found."""
    half, slope = found
    return (lost_by(f'half {half:.2g}, slope {slope:g}', half=half, slope=slope),)


def glare_as_found(found: tuple[float, ...]) -> tuple[Hypothesis, ...]:
    """Return the variant with the amplitude, slope, gloss and lobe that a search has found."""
    half, slope, gloss, lobe = found
    label = f'half {half:.2g}, slope {slope:g}, gloss {gloss:g}, lobe {lobe:g}'
    return (lost_by(label, half=half, slope=slope, gloss=gloss, lobe_deg=lobe),)
