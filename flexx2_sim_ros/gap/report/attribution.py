"""Which part of the gap each named effect takes off, as rows of a table."""

import re
from typing import Any

from flexx2_sim_ros.gap.features.confirm import NOISE
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.gap.report.words import sentences
import numpy as np

_MOSTLY = 0.8  # of what an effect takes off
_MOST_NAMES, _MOST_SENTENCES = 4, 3
HEADS = 'effect', 'probability', 'takes off: depth', 'lost pixels', 'noise'
_UNITS = {'mm': ' mm', 'invalid_percent': ' %', 'noise': ''}
_OTHERS = {'absorbed_by_poses': 'absorbed by poses', 'not_explained': 'not explained'}


def attribution(table: dict[str, Any]) -> list[tuple[str, ...]]:
    """
    Return a row for each named effect, the largest first, and those that make up the whole.

    Cells are below `HEADS`; there are none without effects. The last row is the sum of the others.
    `table` is that of `flexx2_sim_ros.gap.diagnose`.
    """
    if not table['effects']:
        return []
    gap = table['gap']
    rows = [
        (spaced(row['name']), percent(row['confidence']), *_taken(row['takes_off']))
        for row in table['effects']
    ]
    rows += [(_OTHERS[key], '', *_taken(part)) for key, part in _others(gap).items()]
    for key, text in (('null', 'two simulations'), ('before', 'together')):
        noise = sum(gap[unit][key] / tolerance for unit, tolerance in NOISE.items())
        values = gap['wasserstein_mm'][key], 100 * gap['invalid_rate'][key], noise
        shown = zip(values, _UNITS.values(), strict=True)
        rows.append((text, '', *(f'{_rounded(one)}{unit}' for one, unit in shown)))
    return rows


def lengths(table: dict[str, Any]) -> list[float]:
    """Return the length of a bar for each row of `attribution`: depth and lost pixels."""
    gap, of_effects = table['gap'], [row['takes_off'] for row in table['effects']]
    parts = [*of_effects, *_others(gap).values()]
    sizes = [part['distance']['mean'] if part else 0.0 for part in parts]
    return [*sizes, gap['distance']['null'], gap['distance']['before']]


def _others(gap: dict[str, Any]) -> dict[str, Any]:
    return {key: gap[key] for key in _OTHERS if any(one['mean'] for one in gap[key].values())}


def said(table: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the lines below the table, of at most three sentences, and the others."""
    lines = [*disagreeing(table), *wrong_mode(table), *shown_by_one(table), *sentences(table)]
    ends = np.cumsum([len(re.findall(r'[.?](?: |$)', line)) for line in lines])
    count = max(int((ends <= _MOST_SENTENCES).sum()), 1)
    return lines[:count], lines[count:]


def disagreeing(table: dict[str, Any]) -> list[str]:
    """Return a sentence on an effect that some recordings have and the others lack."""
    one = table['disagree']
    if one is None:
        return []
    return [
        f'The recordings disagree: {_some(one["has"])} show {spaced(one["name"])}; '
        f'{_some(one["lacks"])} do not. Was a setting, the mode or the camera changed? '
        'Diagnose them apart.'
    ]


def wrong_mode(table: dict[str, Any]) -> list[str]:
    """Return a sentence on a mode whose noise the recordings have, and not that of their own."""
    if not table.get('likelier_mode'):
        return []
    return [
        f'The noise of the recordings is that of {table["likelier_mode"]} rather than of '
        f'{table["settings"]["usecase"]}: is the mode told right?'
    ]


def _some(names: list[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + f' and {more} more' * (more > 0)


def shown_by_one(table: dict[str, Any]) -> list[str]:
    """Return a sentence for each effect of which one recording shows nearly all."""
    used = [row for row in table['recordings'] if row['used']]
    out = []
    for name in [row['name'] for row in table['effects']] if len(used) > 2 else []:
        here = np.array([max(row['takes_off_here'].get(name, 0.0), 0.0) for row in used])
        if here.sum() and here.max() >= _MOSTLY * here.sum():
            where = used[int(here.argmax())]['name']
            out.append(f'{spaced(name)} shows in {where} alone: record more scenes like it.')
    return out


def _taken(off: dict[str, Any] | None) -> list[str]:
    if off is None:
        return [''] * len(_UNITS)
    return [with_ends(off[key], unit) for key, unit in _UNITS.items()]


def with_ends(one: dict[str, Any], unit: str) -> str:
    """Return a mean with its interval as text."""
    shown = f'{_rounded(one["mean"])}{unit}'
    if one['interval'] is None:
        return shown
    low, high = map(_rounded, one['interval'])
    return shown if low == high else f'{shown} ({low} to {high})'


def _rounded(number: float) -> str:
    # Tenths are as much as intervals allow.
    return short(number if abs(number) >= 1 else round(number, 1) + 0.0)
