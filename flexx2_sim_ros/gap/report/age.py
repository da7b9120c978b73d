"""The age of images: what the stamps hide, and how late the images arrive after them."""

from collections.abc import Sequence
from dataclasses import astuple, fields, replace
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.time_offset import time_offset_of, TimeOffset
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.calibration.data import READING
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.frames import Arrival
import numpy as np

_KEYS = tuple(field.name for field in fields(Arrival))


def age_table(effects: Sequence[Effect], used: Sequence[Found]) -> dict[str, Any]:
    """Return ``age`` of ``diagnosis.json``: seconds, as ``docs/diagnosis.md`` says."""
    rows = [astuple(one.arrival) for one in used if one.arrival is not None]
    delay = None
    if rows:
        middle = np.clip(np.median(rows, axis=0), 0, READING.longest_delay)
        delay = dict(zip(_KEYS, middle.tolist(), strict=True))
    return {'latency': time_offset_of(effects).latency_ns / 1e9, 'delay': delay}


def arrival_of(age: Any) -> Arrival | None:
    """
    Return the delay of an `age_table`; None where it is not known.

    Raises `InputError` when it is not what a diagnosis writes.
    """
    try:
        delay = None if age is None else age['delay']
        found = None if delay is None else Arrival(*(float(delay[key]) for key in _KEYS))
    except (LookupError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f'age: must have delay: {", ".join(_KEYS)}, got {shown(age)}') from error
    most = READING.longest_delay
    if found is not None and not 0 <= found.low <= found.median <= found.high <= most:
        raise InputError(f'age.delay: must rise from 0 to {most:g} s, got {shown(delay)}')
    return found


def with_delay(effects: Sequence[Effect], arrival: Arrival | None) -> list[Effect]:
    """Return effects with the delay of the images; a `TimeOffset` is appended if there is none."""
    if arrival is None:
        return list(effects)
    found = time_offset_of(effects)
    if not found.strength:
        return list(effects)
    late = replace(found, delay=min(arrival.median / found.strength, READING.longest_delay))
    out = [late if isinstance(effect, TimeOffset) else effect for effect in effects]
    return out if late in out else [*out, late]


def age_words(age: dict[str, Any]) -> list[str]:
    """Return sentences on the age of the images; none if it is not known."""
    late, delay = 1e3 * age['latency'], age['delay']
    if delay is None:
        return []
    median, low, high = (1e3 * delay[key] for key in _KEYS)
    out = [
        f'Images arrive {median:.0f} ms after their stamps ({low:.0f} to {high:.0f} ms in 90 % of '
        'the frames).'
    ]
    if late:
        side = 'later' if late > 0 else 'earlier'
        out.append(
            f'The stamps are {abs(late):.0f} ms {side} than the scene, '
            f'so a reader sees the scene as it was {median + late:.0f} ms ago.'
        )
    return out
