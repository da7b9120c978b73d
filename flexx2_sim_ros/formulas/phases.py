"""Phases of modulated light."""

from flexx2_sim_ros.formulas.fastmath import arctan2, cos_sin_turns
from flexx2_sim_ros.formulas.scalars import floor


def direction(turns: float) -> tuple[float, float]:
    """Return cosine and sine of any number of turns."""
    return cos_sin_turns(turns - floor(turns))


def shift_between(
    real: float, imaginary: float, first_real: float, first_imaginary: float, wave_number: float
) -> float:
    """
    Return the distance, metres, by which the phase of light is ahead of that of the first light.

    Both are complex numbers; 0 is returned if one of them is 0. ``wave_number`` is in radians of
    phase a metre.
    """
    ahead = arctan2(
        imaginary * first_real - real * first_imaginary,
        real * first_real + imaginary * first_imaginary,
    )
    return ahead / wave_number
