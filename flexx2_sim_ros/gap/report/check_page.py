"""Write the files of a check, whole or not at all, and its page."""

from collections.abc import Iterator
from html import escape
import json
from pathlib import Path
from typing import Any, NamedTuple

from flexx2_sim_ros.atomic import output_folder, whole_files
from flexx2_sim_ros.gap.report.style import definitions, STYLE
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.gap.report.words import difference, MEANINGS, MEASURES, on_recordings
from flexx2_sim_ros.html_drawing import bar
from flexx2_sim_ros.html_page import html_page

FILES = ('check.json', 'check.html')
_STYLE = (
    STYLE
    + """
.fails { background: #a8324a; } .holds { background: #2e7d4f; }
td + td, .recordings td { white-space: nowrap; }
.bar { width: 8rem; } .recordings .bar { width: 6rem; }
"""
)
_MEASURES = {'loss': ('loss per recording', '', 1.0), **MEASURES}
_OF_EACH = 'loss', 'wasserstein_mm', 'invalid_rate'  # shown for each recording


class CheckLine(NamedTuple):
    """
    One measure as text, for a table.

    Attributes
    ----------
    name, before, after, null, change, verdict : str
        Values with their 90 % intervals; ``null`` is the difference of two simulations.

    """

    name: str
    before: str
    after: str
    null: str
    change: str
    verdict: str


def write_check(folder: Path, table: dict[str, Any]) -> None:
    """
    Write ``check.json`` and ``check.html``.

    Parameters
    ----------
    folder : pathlib.Path
        Created if it does not exist; the two files in it are replaced.
    table : dict
        What `flexx2_sim_ros.gap.check` returns.

    """
    with whole_files(output_folder(folder)) as part:
        text = json.dumps(table, indent=2, allow_nan=False)
        (part / FILES[0]).write_text(text + '\n', encoding='utf-8')
        (part / FILES[1]).write_text(page(table), encoding='utf-8', errors='backslashreplace')


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
    out = [difference(table['measures']), *table['reasons']]
    if len(used) == 1:
        out.append('With one recording there are no intervals: the result is a single value.')
    elif not table['measures']['loss']['better'] and not table['reasons']:
        out.append(
            'The 90 % interval of the change of the loss contains zero: the recordings differ '
            'much. More recordings would make it narrower.'
        )
    if table['known']:
        out.append(f'Taken as given: {", ".join(map(spaced, table["known"]))}.')
    return out + on_recordings(rows)


def lines(table: dict[str, Any]) -> Iterator[CheckLine]:
    """Yield each measure as text, the loss first."""
    for key, (name, unit, factor) in _MEASURES.items():
        one = table['measures'][key]
        change = 'better' if one['better'] else 'worse' if one['worse'] else 'not significant'
        before, after, null, moved = (
            _text(one, part, unit, factor) for part in ('before', 'after', 'null', 'change')
        )
        yield CheckLine(name, before, after, null, moved, change)


def _text(one: dict[str, Any], part: str, unit: str, factor: float) -> str:
    def number(value: float) -> str:
        sign = '+' if part == 'change' and value >= 0 else ''
        return sign + short(value * factor, 3)

    text = f'{number(one[part])} {unit}'.strip()
    interval = one[f'{part}_interval']
    if interval is not None and part != 'null':
        low, high = map(number, interval)
        text += f' ({low} to {high})'
    return text


def page(table: dict[str, Any]) -> str:
    """Return the page as HTML, all text escaped."""
    rows = []
    for key, line in zip(_MEASURES, lines(table), strict=True):
        one = table['measures'][key]
        cells = ''.join(
            f'<td>{escape(text).replace(" (", "<br><small>(", 1)}</small></td>'
            if ' (' in text
            else f'<td>{escape(text)}</td>'
            for text in line
        )
        rows.append(f'<tr>{cells}<td>{bar(one["before"], one["after"], one["null"])}</td></tr>')
    used = [row for row in table['recordings'] if row['used']]
    count = f'{len(used)} recording{"s" * (len(used) != 1)}'
    tag, word = ('holds', 'holds') if table['holds'] else ('fails', 'does not hold')
    body = [
        f'<p><span class="tag {tag}">{word}</span> <small>on {count} that the diagnosis has '
        'not seen</small></p>',
        f'<h1>{escape(headline(table))}</h1>',
        ''.join(f'<p>{escape(line)}</p>' for line in sentences(table)),
        '<h2>The gap before and after the effects are simulated</h2><div class="scroll"><table>'
        '<tr><th>difference in</th><th><span class="key gray"></span>before</th>'
        '<th><span class="key blue"></span>after</th>'
        '<th><span class="key line"></span>two simulations</th><th>change</th><th>result</th>'
        f'<th></th></tr>{"".join(rows)}</table></div><p><small>How much recordings and simulation '
        'differ, mean over recordings with 90 % intervals: smaller is better. Two simulations: '
        'two runs of the simulator with other noise, as an exact simulation would differ, too. '
        'Each row of bars has its own scale. "Better" and "worse": the interval of the change '
        'does not contain zero, and the change is larger than the tolerance of the diagnosis.'
        '</small></p>',
        definitions(
            {
                'loss per recording': 'weighted sum of the differences in all that the '
                'diagnosis compares, in units of noise and tolerance',
                **MEANINGS,
            }
        ),
        _recordings(used),
        f'<p class="dim">Made by flexx2_sim_ros {escape(table["version"])} in '
        f'{table["seconds"]:.0f} s. docs/diagnosis.md says how each number is computed.</p>',
    ]
    return html_page('Check of a diagnosis', _STYLE, '\n'.join(body))


def _recordings(used: list[dict[str, Any]]) -> str:
    head = ''.join(
        f'<th>{escape(name)}{f", {unit}" if unit else ""}</th>'
        for name, unit, _ in (_MEASURES[key] for key in _OF_EACH)
    )
    rows = []
    for row in used:
        cells = ''.join(
            f'<td>{_span(row[key], _MEASURES[key][2])}{bar(*row[key])}</td>' for key in _OF_EACH
        )
        rows.append(f'<tr><td>{escape(row["name"])}</td>{cells}</tr>')
    return (
        '<h2>Each recording, before to after</h2><div class="scroll"><table class="recordings">'
        f'<tr><th>file</th>{head}</tr>{"".join(rows)}</table></div>'
    )


def _span(values: list[float], factor: float) -> str:
    return f'{short(values[0] * factor, 3)} to {short(values[1] * factor, 3)}'
