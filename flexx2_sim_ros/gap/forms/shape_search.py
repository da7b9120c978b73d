"""Fit an effect's own parameters by simulation, and leave one recording out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from flexx2_sim_ros.effects.shapes import Shape
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms.bias_fit import is_surely_less
import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

Numbers = dict[str, float]
Evaluate = Callable[[Sequence[Numbers]], np.ndarray]
_DIGITS = 4


@dataclass(frozen=True)
class SearchResult:
    """
    Parameters that were found.

    `together` are those with the smallest mean mismatch over all recordings, `without` the same
    without each recording in turn. `mismatch` is (R,) of each recording with the parameters that
    it had no part in.
    """

    shape: Shape
    together: Numbers
    without: tuple[Numbers, ...]
    mismatch: np.ndarray


def evaluations(shapes: Sequence[Shape], quick: bool = False) -> int:
    """Return about how often `search` calls ``evaluate``."""
    if quick:
        return (len(FORMS.quick) + 1) * len(shapes)
    return sum(1 + FORMS.fine * len(shape.free) for shape in shapes)


def search(
    shapes: Sequence[Shape], start: Mapping[str, float], evaluate: Evaluate, quick: bool = False
) -> SearchResult:
    """
    Fit shapes from simple to flexible; return the one that left-out recordings pay for.

    `start` has the effect's parameters as diagnosed. `evaluate` is from N sets of parameters to
    the (N, R) mismatch of each recording. With `quick` only places around the start are tried,
    with few calls of it.
    """
    chosen: SearchResult | None = None
    for shape in shapes:
        found = _fit(shape, {**start, **(chosen.together if chosen else {})}, evaluate, quick)
        if chosen is None or is_surely_less(found.mismatch, chosen.mismatch):
            chosen = found
    assert chosen is not None
    return chosen


def _fit(
    shape: Shape, start: Mapping[str, float], evaluate: Evaluate, quick: bool
) -> SearchResult:
    tried: list[Numbers] = []
    values: list[np.ndarray] = []

    def look(places: np.ndarray) -> np.ndarray:
        sets = [_numbers(shape, place) for place in places]
        several = evaluate(sets)
        tried.extend(sets)
        values.extend(several)
        return np.asarray(several.mean(axis=1))

    (_cross if quick else _descend)(look, _place(shape, start))
    found = np.array(values)
    # Which of all places suits the others best; the places themselves are the same for all.
    rest = found.sum(axis=1, keepdims=True) - found
    chosen = rest.argmin(axis=0)
    return SearchResult(
        shape,
        tried[int(found.sum(axis=1).argmin())],
        tuple(tried[i] for i in chosen),
        found[chosen, np.arange(len(chosen))],
    )


def _descend(look: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> None:
    # Coarse to fine: a few places all over the box, then downhill from the best of them.
    size = len(start)
    spread = qmc.Halton(size, scramble=False).random(FORMS.coarse * size + 1)[1:]
    coarse = np.concatenate([start[None], spread])
    best = coarse[np.argmin(look(coarse))]
    step = FORMS.simplex
    corners = [best + np.where(best > 0.5, -step, step) * unit for unit in np.eye(size)]
    minimize(
        lambda place: look(place[None])[0],
        best,
        method='Nelder-Mead',
        bounds=[(0.0, 1.0)] * size,
        options={
            'initial_simplex': np.array([best, *corners]),
            'maxfev': FORMS.fine * size,
            'xatol': FORMS.close,
            'fatol': 0.0,
        },
    )


def _cross(look: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> None:
    # Both neighbours along each axis, and on to the lowest point of the parabola through them.
    for step in FORMS.quick:
        arms = [sign * step * unit for unit in np.eye(len(start)) for sign in (-1, 1)]
        places = np.clip([start, *(start + arm for arm in arms)], 0.0, 1.0)
        values = look(places)
        start = np.array(
            [
                lowest(places[[2 * i + 1, 0, 2 * i + 2], i], values[[2 * i + 1, 0, 2 * i + 2]])
                for i in range(len(start))
            ]
        )
    look(start[None])


def lowest(places: np.ndarray, values: np.ndarray) -> float:
    """Return where a parabola through three places in order is lowest; two may be the same."""
    left, right = np.diff(places)
    if left > 0 and right > 0:
        before, after = np.diff(values) / (left, right)
        bend = (after - before) / (left + right)
        if bend > 0:
            vertex = (places[0] + places[1]) / 2 - before / (2 * bend)
            return float(np.clip(vertex, places[0], places[2]))
    return float(places[np.argmin(values)])


def _numbers(shape: Shape, place: np.ndarray) -> Numbers:
    # From the unit cube to parameters.
    out = {'strength': 1.0, **shape.fixed}
    for one, x in zip(shape.free, np.clip(place, 0.0, 1.0), strict=True):
        value = (
            one.low * (one.high / one.low) ** x if one.log else one.low + x * (one.high - one.low)
        )
        rounded = float(f'{value:.{_DIGITS}g}')
        out[one.name] = min(max(rounded, one.low), one.high)
    return out


def _place(shape: Shape, values: Mapping[str, float]) -> np.ndarray:
    # From parameters to the unit cube; the middle for what is not known.
    out = []
    for one in shape.free:
        value = values.get(one.name)
        if value is None:
            out.append(0.5)
            continue
        value = min(max(value, one.low), one.high)
        out.append(
            np.log(value / one.low) / np.log(one.high / one.low)
            if one.log
            else (value - one.low) / (one.high - one.low)
        )
    return np.array(out, float)
