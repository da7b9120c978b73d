"""Phases of modulated light."""

from flexx2_sim_ros.formulas.fastmath import arctan2, cos_sin_turns
from flexx2_sim_ros.formulas.scalars import floor


def direction(turns: float) -> tuple[float, float]:
    """Return cosine and sine of any number of turns."""
    return cos_sin_turns(turns - floor(turns))


def angle_between(
    real: float, imaginary: float, first_real: float, first_imaginary: float
) -> float:
    """Return by which angle, radians, a complex number is ahead of the first; 0 if one is 0."""
    return arctan2(
        imaginary * first_real - real * first_imaginary,
        real * first_real + imaginary * first_imaginary,
    )
