"""The page of a check, and its sentences and table for the terminal."""

from collections.abc import Iterator
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.report import words
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.html_drawing import bar
from flexx2_sim_ros.html_page import html_page

HEADS = 'difference in', 'before', 'after', 'two simulations', 'change', 'result'
_STYLE = """
td + td, .recordings td { white-space: nowrap; }
.bar { width: 8rem; } .recordings .bar { width: 6rem; }
"""
_MEASURES = {'loss': ('loss per recording', '', 1.0), **words.MEASURES}
_LOSS = (
    'weighted sum of the differences in all that the diagnosis compares, in units of noise and '
    'tolerance'
)
_OF_EACH = 'loss', 'wasserstein_mm', 'invalid_rate'  # shown for each recording


def headline(table: dict[str, Any]) -> str:
    """Return the result in one sentence."""
    names = ' and '.join(spaced(name) for name in table['effects'])
    loss = table['measures']['loss']
    if table['holds']:
        remove = 'removes' if len(table['effects']) == 1 else 'remove'
        part = percent(loss['shrink'])
        return f'The diagnosis holds: {names} {remove} {part} of the gap, measured by the loss.'
    return f'The diagnosis ({names}) does not hold on these recordings.'


def sentences(table: dict[str, Any]) -> list[str]:
    """Return what is left, why a diagnosis does not hold, and notes, one line each."""
    rows = table['recordings']
    used = [row for row in rows if row['used']]
    out = [words.difference(table['measures']), *table['reasons']]
    if len(used) == 1:
        out.append('With one recording there are no intervals: the result is a single value.')
    elif not table['measures']['loss']['better'] and not table['reasons']:
        out.append(
            'The 90 % interval of the change of the loss contains zero: the recordings differ '
            'much. More recordings would make it narrower.'
        )
    if table['known']:
        out.append(f'Taken as given: {", ".join(map(spaced, table["known"]))}.')
    return out + words.on_recordings(rows)


def lines(table: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield each measure as text below `HEADS`, the loss first; a value has its 90 % interval."""
    for key, (name, unit, factor) in _MEASURES.items():
        one = table['measures'][key]
        change = 'better' if one['better'] else 'worse' if one['worse'] else 'not significant'
        parts = ('before', 'after', 'null', 'change')
        if not words.is_measured(key, one):
            yield name, *('-' for _ in parts), 'not measured'
            continue
        yield name, *(_text(one, part, unit, factor) for part in parts), change


def _text(one: dict[str, Any], part: str, unit: str, factor: float) -> str:
    ends = None if part == 'null' else one[f'{part}_interval']
    size, *interval = (
        ('+' if part == 'change' and value >= 0 else '') + short(value * factor, 3)
        for value in (one[part], *(ends or ()))
    )
    text = f'{size} {unit}'.strip()
    return f'{text} ({" to ".join(interval)})' if interval else text


def page(table: dict[str, Any]) -> str:
    """Return the page as HTML, all text escaped."""
    used = [row for row in table['recordings'] if row['used']]
    count = f'{len(used)} recording{"s" * (len(used) != 1)}'
    verdict = ('holds', 'good') if table['holds'] else ('does not hold', 'bad')
    seen = html.element('small', f'on {count} that the diagnosis has not seen')
    body = [
        html.element('p', html.tag(*verdict), ' ', seen),
        html.heading(headline(table), 1),
        html.paragraphs(sentences(table)),
        _measures(table),
        html.definitions('What the rows mean', {_MEASURES['loss'][0]: _LOSS, **words.MEANINGS}),
        _recordings(used),
        html.made_by(table, 'docs/diagnosis.md'),
    ]
    return html_page('Check of a diagnosis', _STYLE, '\n'.join(body))


def _measures(table: dict[str, Any]) -> html.Html:
    rows = []
    for name, line in zip(_MEASURES, lines(table), strict=True):
        one = table['measures'][name]
        rows.append([*map(_cell, line), bar(one['before'], one['after'], one['null'])])
    colours = zip(('gray', 'blue', 'line'), HEADS[1:4], strict=True)
    heads = [HEADS[0], *(html.key(*one) for one in colours), *HEADS[4:], '']
    return html.join(
        html.heading('The gap before and after the effects are simulated'),
        html.table(heads, rows),
        html.note(
            f'{words.SIZES} Intervals: 90 %. "Better" and "worse": that of the change does not '
            'contain zero, and the change is larger than the tolerance of the diagnosis.'
        ),
    )


def _cell(text: str) -> html.Html:
    # A value above its interval.
    value, *interval = text.split(' (', 1)
    below = (
        part for one in interval for part in (html.element('br'), html.element('small', f'({one}'))
    )
    return html.join(value, *below)


def _recordings(used: list[dict[str, Any]]) -> html.Html:
    shown = [_MEASURES[name] for name in _OF_EACH]
    heads = ['file', *(f'{name}, {unit}' if unit else name for name, unit, _ in shown)]
    rows = []
    for row in used:
        cells = []
        for name, (_, _, factor) in zip(_OF_EACH, shown, strict=True):
            before, after = (short(value * factor, 3) for value in row[name][:2])
            cells.append(html.join(f'{before} to {after}', bar(*row[name])))
        rows.append([row['name'], *cells])
    title = html.heading('Each recording, before to after')
    return html.join(title, html.table(heads, rows, 'recordings'))
