"""Randomise a simulation by what a diagnosis knows of its camera, and by what it does not know."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

from flexx2_sim_ros.atomic import checked_target
from flexx2_sim_ros.effects import (
    Distribution,
    Effect,
    loadable,
    parse_effects,
    Randomisation,
    registry,
    save_randomisation,
)
from flexx2_sim_ros.effects.registry import check_map_files, maps_of_draws
from flexx2_sim_ros.effects.time_offset import time_offset_of, TimeOffset
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.frames import Arrival
from flexx2_sim_ros.gap.data.given import given_effects
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
import numpy as np
from scipy import linalg, stats

_FEWEST = 3  # recordings for a jackknife
_UNDECIDED = 0.5  # probability that a camera has an effect that the diagnosis could not decide
_TWICE = 2.0  # times the typical value
_SAME = 1e-9
# Relative error that all recordings share and a jackknife cannot show, such as that of sigma_z.
# python -m bench.gap_randomise of aac5156 --recordings 5 --frames 8 --seeds 1400,...,1413:
# without it, 14 of 23 truths are within 90 % of the draws.
_SHARED = 0.1
_WIDE = 2 * 1.645  # standard deviations from the 5 % to the 95 % quantile of a normal distribution


@dataclass(frozen=True)
class Randomised:
    """
    Distributions, and how much narrower they are than those of the catalogue.

    `named` effects have fitted parameters, `undecided` ones the distributions of the catalogue.
    `narrower` is, by parameter, the standard deviation in the catalogue over the one here.
    """

    randomisation: Randomisation
    named: tuple[str, ...]
    undecided: tuple[str, ...]
    narrower: dict[str, float]


def randomise(diagnosis: str | Path, out: str | Path | None = None) -> Randomised:
    """
    Return distributions of the effects of a diagnosed camera.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    out : str or pathlib.Path, optional
        File to write.

    Raises
    ------
    InputError
        When the diagnosis cannot be read or has nothing to randomise.

    """
    if out is not None:
        checked_target(out)
        check_map_files(Path(out).parent, maps_of_draws(out))
    before = read_diagnosis(Path(diagnosis))
    # Numbers as they were fitted last; curves and maps have no distributions.
    named = tuple(one for one in before.typical_effects() if one.role != 'pose')
    held_out = _held_out(before, named)
    _check_form(named, held_out)
    given = parse_effects(before.known)
    delay = time_offset_of(given).delay_ns / 1e9
    named = _delayed(named, delay)
    undecided = _delayed(_undecided(before, {effect.name for effect in named}), delay)
    late = [] if before.arrival is None else [TimeOffset(latency=0.0)]
    if not (named or undecided or late):
        raise InputError('DIAGNOSIS: must have effects to randomise, got none')
    distributions, correlation = _fitted(named, held_out)
    prior = _priors(undecided, before.arrival, delay)
    chances = {effect.name: 1.0 for effect in (*given, *named)}
    chances |= {effect.name: _UNDECIDED for effect in undecided}
    if late or delay:
        chances[TimeOffset.name] = 1.0  # each camera is late
    by_name = {effect.name: effect for effect in (*late, *given, *named, *undecided)}
    randomisation = Randomisation(
        tuple(by_name[name] for name in loadable() if name in by_name),
        chances,
        (*distributions, *prior),
        linalg.block_diag(correlation, np.eye(len(prior))),
    )
    usual = [_catalogue_prior(registry()[one.effect], one.parameter) for one in distributions]
    both = zip(distributions, usual, strict=True)
    narrower = {one.name: wide.spread / one.spread for one, wide in both if wide is not None}
    fitted, drawn = (tuple(effect.name for effect in some) for some in (named, undecided))
    found = Randomised(randomisation, fitted, drawn, narrower)
    if out is not None:
        save_randomisation(out, randomisation, '\n'.join(comment(found)))
    return found


def _catalogue_prior(kind: type[Effect], parameter: str = 'strength') -> Distribution | None:
    # How a parameter of an effect is drawn if nothing is known of the camera: uniform from 0 to
    # twice its typical value, with either sign if it can have either (assumed). None for a
    # parameter whose typical value is 0.
    item = next(one for one in kind.parameters() if one.name == parameter)
    most = _TWICE * abs(item.default)
    if most == 0:
        return None
    return Distribution(
        kind.name, parameter, max(-most if item.low < 0 else 0.0, item.low), min(most, item.high)
    )


def comment(found: Randomised) -> list[str]:
    """Return what a file of distributions says of itself, one line each."""
    lines = ['Distributions of the effects of a diagnosed camera, by flexx2 gap randomise.']
    if found.named:
        lines.append(f'Fitted to the recordings: {", ".join(found.named)}.')
    if found.undecided:
        lines.append(
            f'Not decided by the recordings, drawn as in the catalogue: '
            f'{", ".join(found.undecided)}.'
        )
    lines.append('Effects that are not here are off.')
    if found.narrower:
        overall = math.exp(float(np.mean(np.log(list(found.narrower.values())))))
        lines.append(
            f'The parameters that were fitted vary {overall:.1f} times less than in the catalogue '
            '(geometric mean).'
        )
    return lines


def _undecided(before: Diagnosed, taken: set[str]) -> tuple[Effect, ...]:
    rows = before.table.get('not_decidable', [])
    names = {row.get('name') for row in rows if isinstance(row, dict)}
    settled = {*taken, *(effect.name for effect in given_effects(before.known))}
    return tuple(
        kind()
        for name, kind in registry().items()
        if name in names and name not in settled and kind.role != 'pose'
    )


def _delayed(effects: Sequence[Effect], delay: float) -> tuple[Effect, ...]:
    return tuple(
        replace(one, delay=delay / one.strength)
        if delay and isinstance(one, TimeOffset) and one.strength
        else one
        for one in effects
    )


def _priors(
    undecided: Sequence[Effect], arrival: Arrival | None, delay: float
) -> list[Distribution]:
    # Strength would scale the delay of images, too, which is known.
    free = {TimeOffset.name: 'latency'} if delay or arrival is not None else {}
    found = [_catalogue_prior(type(one), free.get(one.name, 'strength')) for one in undecided]
    out = [one for one in found if one is not None]
    if arrival is not None and arrival.high:
        # As late as the frames of the recordings were.
        spread = max((arrival.high - arrival.low) / _WIDE, _SHARED * arrival.median)
        out.append(Distribution(TimeOffset.name, 'delay', 0.0, 1.0, arrival.median, spread))
    return out


def _held_out(before: Diagnosed, named: Sequence[Effect]) -> list[dict[str, Effect]]:
    # The effects as fitted without each recording.
    wanted = {effect.name for effect in named}
    found = []
    for row in before.table['recordings']:
        own, forms = row.get('effects_without'), row.get('forms_without', {})
        if isinstance(own, dict) and isinstance(forms, dict):
            effects = {effect.name: effect for effect in parse_effects(own)}
            effects |= {one.name: one for one in parse_effects(forms) if not one.forms}
            if effects.keys() >= wanted:
                found.append(effects)
    return found


def _check_form(named: Sequence[Effect], held_out: Sequence[Mapping[str, Effect]]) -> None:
    # The fits that the jackknife needs have the form of the diagnosis, some with a number of
    # another formula.
    why = ''
    for effect in named:
        if effect.name not in registry():
            why = f'effects with a cause, got {effect.name}'
        elif not held_out:
            why = (
                'the effects as fitted without each recording, got none: use the folder of flexx2 '
                'gap diagnose, made with this version'
            )
        elif len(held_out) < _FEWEST:
            why = f'been made from at least {_FEWEST} recordings, got {len(held_out)}'
        elif any(one[effect.name].forms.keys() != effect.forms.keys() for one in held_out):
            why = (
                f'effects in the form of the diagnosis, got {effect.name} in another form without '
                'a recording: diagnose again'
            )
        if why:
            raise InputError(f'DIAGNOSIS: must have {why}')


def _fitted(
    named: Sequence[Effect], held_out: Sequence[Mapping[str, Effect]]
) -> tuple[list[Distribution], np.ndarray]:
    # Jackknife over recordings (Efron and Tibshirani 1993, chapter 11) of all parameters.
    items = [
        (effect, item)
        for effect in named
        for item in effect.parameters()
        if np.ptp([getattr(one[effect.name], item.name) for one in held_out]) > _SAME
    ]
    if not items:
        return [], np.eye(0)
    values = np.array(
        [[getattr(one[effect.name], item.name) for effect, item in items] for one in held_out]
    )
    count = len(values)
    deviation = values - values.mean(axis=0)
    covariance = (count - 1) / count * deviation.T @ deviation
    # As wide as Student's t at the quantiles of the diagnosis' intervals.
    wide = stats.t.ppf(THRESHOLDS.quantile, count - 1) / stats.norm.ppf(THRESHOLDS.quantile)
    sd = np.sqrt(np.diag(covariance))
    centre = np.array([getattr(effect, item.name) for effect, item in items])
    spread = np.hypot(wide * sd, _SHARED * centre)
    distributions = [
        Distribution(effect.name, item.name, item.low, item.high, float(middle), float(one))
        for (effect, item), middle, one in zip(items, centre, spread, strict=True)
    ]
    correlation = wide**2 * covariance / np.outer(spread, spread)
    np.fill_diagonal(correlation, 1.0)
    return distributions, correlation
