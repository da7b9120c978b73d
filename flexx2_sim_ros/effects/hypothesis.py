"""What a diagnosis simulates of an effect, as plain data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class StandIn:
    """
    Another effect's simulation, which shows what a term changes.

    Attributes
    ----------
    effect, name : str
        The other effect and its parameter.
    value : float
        The parameter's value in that simulation; the rest is in proportion.
    decay : float or None
        Time constant, seconds, with which it decays after power-on; None: it does not.

    """

    effect: str
    name: str
    value: float
    decay: float | None = None


@dataclass(frozen=True)
class Term:
    """
    One parameter, `name`, of an effect that a diagnosis fits.

    Attributes
    ----------
    values : tuple of float
        Values that are simulated. Between them and ``neutral`` the diagnosis interpolates,
        beyond them it extrapolates.
    low, high : float
        Bounds of the fit.
    neutral : float
        Value that changes nothing.
    fixed : mapping
        Other parameters in these simulations.
    few : bool
        Whether a few frames show it. If not, all frames of a recording are simulated.
    stand_in : StandIn or None
        What is simulated instead.
    along_ray : str
        The parameter of the effect `AlongRay` that does the same along the line of sight; empty
        if there is none.

    """

    name: str
    values: tuple[float, ...]
    low: float
    high: float
    neutral: float = 0.0
    fixed: Mapping[str, float] = field(default_factory=dict)
    few: bool = True
    stand_in: StandIn | None = None
    along_ray: str = ''


@dataclass(frozen=True)
class Hypothesis:
    """
    One variant of an effect that may explain a gap.

    Attributes
    ----------
    label : str
        Which variant, for people; empty if there is one.
    terms : tuple of Term
        What is fitted.
    fixed : mapping
        The effect's other parameters.

    """

    label: str
    terms: tuple[Term, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Searched:
    """
    An internal of an effect that is found from the recordings before anything is simulated.

    Attributes
    ----------
    internal : str
        Which search finds it: a key of `flexx2_sim_ros.gap.features.search.SEARCHES`.
    variants : callable
        From what the search returns to the variants that are simulated, besides the effect's
        ``hypotheses``. Without a finding there are none.
    of : callable or None
        From an effect to what the search would return for a camera that has it, empty for the
        usual one. None if the fit of poses need not know it.

    """

    internal: str
    variants: Callable[[tuple[float, ...]], tuple[Hypothesis, ...]]
    of: Callable[[Any], tuple[float, ...]] | None = None


AS_SEARCHED = 'as searched'  # a variant that is a bias of the size that a search found


def grid(
    name: str,
    values: tuple[float, ...],
    low: float,
    high: float,
    label: str = '',
    *,
    neutral: float = 0.0,
    few: bool = True,
    **fixed: float,
) -> Hypothesis:
    """Return a hypothesis of one parameter; see `Term`. ``fixed`` are the others."""
    return Hypothesis(label, (Term(name, values, low, high, neutral, fixed, few),), fixed)
