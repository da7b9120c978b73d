"""Which part of the gap each named effect takes off, as rows of a table."""

from typing import Any

from flexx2_sim_ros.gap.features.confirm import NOISE
from flexx2_sim_ros.gap.report.text import percent, short, spaced
import numpy as np

_MOSTLY = 0.8  # of what an effect takes off
_MOST_NAMES = 4
_LITTLE_MM, _LITTLE_DEG = 0.5, 0.03  # ASSUMED: no effect that matters hides in less
_PARTS = slice(0, 3), slice(3, 6)  # of a pose: metres, degrees
HEADS = 'effect', 'probability', 'takes off: depth', 'lost pixels', 'noise'
_UNITS = {'mm': ' mm', 'invalid_percent': ' %', 'noise': ''}
REST = 'not explained'


def attribution(table: dict[str, Any]) -> list[tuple[str, ...]]:
    """
    Return a row for each named effect, the largest first, and one for what is left of the gap.

    Cells are below `HEADS`; there are none without effects. `table` is that of
    `flexx2_sim_ros.gap.diagnose`.
    """
    if not table['effects']:
        return []
    gap = table['gap']
    left = {
        unit: max(gap[unit]['after'] - gap[unit]['null'], 0.0)
        for unit in ('wasserstein_mm', 'invalid_rate', *NOISE)
    }
    noise = sum(left[unit] / tolerance for unit, tolerance in NOISE.items())
    rest = zip((left['wasserstein_mm'], 100 * left['invalid_rate'], noise), _UNITS, strict=True)
    rows = [
        (spaced(row['name']), percent(row['confidence']), *_taken(row['takes_off']))
        for row in table['effects']
    ]
    return [*rows, (REST, '', *(f'{_rounded(one)}{_UNITS[key]}' for one, key in rest))]


def poses_hide(table: dict[str, Any]) -> str:
    """Return how far the poses were corrected, which may hide an effect; empty if hardly."""
    poses = np.array([row['pose'] for row in table['recordings'] if row['used']])
    if not poses.size:
        return ''
    metres, degrees = (np.sqrt((poses[:, part] ** 2).sum(axis=1).mean()) for part in _PARTS)
    if 1000 * metres < _LITTLE_MM and degrees < _LITTLE_DEG:
        return ''
    return (
        f'The given poses were corrected by {short(1000 * metres)} mm and {short(degrees)} deg '
        '(root mean square), which may hide effects as large.'
    )


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
    return short(round(number, 1) + 0.0)
