"""How large the gap is, which part each effect takes off, and what is left after processing."""

import re
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.features.physical import in_tolerances, NOISE
from flexx2_sim_ros.gap.report import words
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.html_drawing import bar
import numpy as np

_MATTERS = 1.0  # tolerances, of a distance; a definition
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
        noise = in_tolerances({unit: gap[unit][key] for unit in NOISE}, NOISE)
        values = gap['wasserstein_mm'][key], 100 * gap['invalid_rate'][key], noise
        shown = zip(values, _UNITS.values(), strict=True)
        rows.append((text, '', *(f'{_rounded(one)}{unit}' for one, unit in shown)))
    if not any(words.is_measured(unit, gap[unit]) for unit in NOISE):
        rows = [(*row[:-1], row[-1] and '-') for row in rows]
    return rows


def lengths(table: dict[str, Any]) -> list[float]:
    """Return the length of a bar for each row of `attribution`: depth and lost pixels."""
    gap, of_effects = table['gap'], [row['takes_off'] for row in table['effects']]
    parts = [*of_effects, *_others(gap).values()]
    sizes = [part['distance']['mean'] if part else 0.0 for part in parts]
    return [*sizes, gap['distance']['null'], gap['distance']['before']]


def _others(gap: dict[str, Any]) -> dict[str, Any]:
    return {key: gap[key] for key in _OTHERS if any(one['mean'] for one in gap[key].values())}


def _taken(off: dict[str, Any] | None) -> list[str]:
    return ['' if off is None else _with_ends(off[key], unit) for key, unit in _UNITS.items()]


def _with_ends(one: dict[str, Any], unit: str) -> str:
    # A mean with its interval.
    low, high = map(_rounded, one['interval'] or (0, 0))
    ends = '' if low == high else f' ({low} to {high})'
    return f'{_rounded(one["mean"])}{unit}{ends}'


def _rounded(number: float) -> str:
    # Tenths are as much as intervals allow.
    return short(number if abs(number) >= 1 else round(number, 1) + 0.0)


def said(table: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the lines below the table, of at most three sentences, and the others."""
    out = []
    if (one := table['disagree']) is not None:
        out.append(
            f'The recordings disagree: {_some(one["has"])} show {spaced(one["name"])}; '
            f'{_some(one["lacks"])} do not. Was a setting, the mode or the camera changed? '
            'Diagnose them apart.'
        )
    if table.get('likelier_mode'):
        out.append(
            f'The noise of the recordings is that of {table["likelier_mode"]} rather than of '
            f'{table["settings"]["usecase"]}: is the mode told right?'
        )
    out += [*shown_by_one(table), *words.sentences(table)]
    ends = np.cumsum([len(re.findall(r'[.?](?: |$)', line)) for line in out])
    count = max(int((ends <= _MOST_SENTENCES).sum()), 1)
    return out[:count], out[count:]


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


def sizes_section(table: dict[str, Any]) -> html.Html:
    """Return the section on the size of the gap of a diagnosis."""
    added, fitted = bool(words.camera_effects(table)), ''
    if added:
        data = 'the other recordings' if table['gap']['held_out'] else 'the same recording'
        fitted = f' The effects were fitted to {data}.'
    return html.folded(
        'How large the gap is in other measures',
        _sizes(table['gap'], added),
        html.note(f'{words.SIZES}{fitted}'),
        html.definitions('What the rows mean', words.MEANINGS),
    )


def _sizes(gap: dict[str, Any], added: bool) -> html.Html:
    keys = ['before', *(['after'] if added else []), 'null']
    heads = {
        'before': html.key('gray', 'as simulated'),
        'after': html.key('blue', 'with the effects'),
        'null': html.key('line', 'two simulations'),
    }
    rows = []
    for unit, (name, symbol, factor) in words.MEASURES.items():
        size = {key: gap[unit][key] * factor for key in heads}
        if not words.is_measured(unit, gap[unit]):
            rows.append([name, *('-' for _ in keys), ''])
            continue
        drawn = bar(size['before'], size['after'] if added else None, size['null'])
        rows.append([name, *(f'{short(size[key], 3)} {symbol}' for key in keys), drawn])
    return html.table(['difference in', *(heads[key] for key in keys), ''], rows, 'sizes')


def processed_section(table: dict[str, Any]) -> html.Html:
    """Return the section on the gap after the processing of a robot's program."""
    own, measured = table['processed'], []
    if 'reason' not in own:
        named = [row for row in table['effects'] if row['name'] in own['effects']]
        rows = [{**row, 'takes_off': own['effects'][row['name']]} for row in named]
        measured = [
            html.table(HEADS, attribution({'effects': rows, 'gap': own})) if rows else '',
            _sizes(own, bool(rows)),
            html.note(
                'As above, with recordings and simulations both processed, at the fitted poses. '
                'Errors / noise: in units of the noise before the processing.'
            ),
        ]
    said = html.element('p', processed_in_short(table))
    return html.folded('After your own processing', said, *measured)


def processed_in_short(table: dict[str, Any]) -> str:
    """Return how far real and simulated depth are apart after processing, and why: a line."""
    own = table['processed']
    if 'reason' in own:
        return f'After your processing: not measured: {own["reason"]}.'
    behind = own['not_measured']
    until = f', before {behind[0]}' if behind else ''
    where = f'After your processing ({", ".join(own["stages"]) or "nothing"}{until})'
    before, after, null = (_apart(own, key) for key in ('before', 'after', 'null'))
    apart = f'real and simulated depth differ by {before}'
    if own['distance']['before'] - own['distance']['null'] < _MATTERS:
        return f'{where}, no gap above the tolerance is left: {apart}, two simulations by {null}.'
    causes = [
        f'{spaced(name)}, which takes off {text}'
        for name, off in own['effects'].items()
        if (text := _matters(off, own))
    ]
    why = f'because of {"; and ".join(causes)}' if causes else 'and no named effect explains it'
    also = f'With the effects they differ by {after}, two' if own['effects'] else 'Two'
    return f'{where}, {apart}, {why}. {also} simulations by {null}.'


def _apart(own: dict[str, Any], key: str) -> str:
    invalid = own['invalid_rate']
    text = f'{short(own["wasserstein_mm"][key])} mm'
    if max(invalid['before'], invalid['after']) > invalid['tolerance']:
        text += f' and {short(100 * invalid[key])} % of invalid pixels'
    return text


def _matters(off: dict[str, Any], own: dict[str, Any]) -> str:
    # What an effect takes off, with its interval, as far as it matters; empty if nothing.
    return ' and '.join(
        _with_ends(off[key], unit)
        for key, unit, measure, factor in (
            ('mm', ' mm', 'wasserstein_mm', 1),
            ('invalid_percent', ' % of invalid pixels', 'invalid_rate', 100),
        )
        if off[key]['mean'] > factor * own[measure]['tolerance']
    )
