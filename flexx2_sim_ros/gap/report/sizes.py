"""How large the gap is, as recorded and after a robot's own processing."""

from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.report.attribution import attribution, HEADS, with_ends
from flexx2_sim_ros.gap.report.text import short, spaced
from flexx2_sim_ros.gap.report.words import camera_effects, MEANINGS, MEASURES, SIZES
from flexx2_sim_ros.html_drawing import bar

_MATTERS = 1.0  # tolerances, of a distance; a definition


def sizes_section(table: dict[str, Any]) -> html.Html:
    """Return the section on the size of the gap of a diagnosis."""
    added, fitted = bool(camera_effects(table)), ''
    if added:
        data = 'the other recordings' if table['gap']['held_out'] else 'the same recording'
        fitted = f' The effects were fitted to {data}.'
    return html.folded(
        'How large the gap is in other measures',
        _sizes(table['gap'], added),
        html.note(f'{SIZES}{fitted}'),
        html.definitions('What the rows mean', MEANINGS),
    )


def processed_section(table: dict[str, Any]) -> html.Html:
    """Return the section on the gap after the processing of a robot's program."""
    own, title = table['processed'], 'After your own processing'
    if 'reason' in own:
        return html.folded(title, html.element('p', processed_in_short(table)))
    named = [row for row in table['effects'] if row['name'] in own['effects']]
    rows = [{**row, 'takes_off': own['effects'][row['name']]} for row in named]
    return html.folded(
        title,
        html.element('p', processed_in_short(table)),
        html.table(HEADS, attribution({'effects': rows, 'gap': own})) if rows else '',
        _sizes(own, bool(rows)),
        html.note(
            'As above, with recordings and simulations both processed, at the fitted poses. '
            'Errors / noise: in units of the noise before the processing.'
        ),
    )


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
    parts = []
    for key, unit, measure, factor in (
        ('mm', ' mm', 'wasserstein_mm', 1),
        ('invalid_percent', ' % of invalid pixels', 'invalid_rate', 100),
    ):
        if off[key]['mean'] > factor * own[measure]['tolerance']:
            parts.append(with_ends(off[key], unit))
    return ' and '.join(parts)


def _sizes(gap: dict[str, Any], added: bool) -> html.Html:
    heads = [
        'difference in',
        html.key('gray', 'as simulated'),
        html.key('line', 'two simulations'),
        '',
    ]
    if added:
        heads.insert(2, html.key('blue', 'with the effects'))
    rows = []
    for unit, (name, symbol, factor) in MEASURES.items():
        before, after, null = (gap[unit][k] * factor for k in ('before', 'after', 'null'))
        shown = [before, after, null] if added else [before, null]
        drawn = bar(before, after if added else None, null)
        rows.append([name, *(f'{short(one, 3)} {symbol}' for one in shown), drawn])
    return html.table(heads, rows, 'sizes')
