"""The page of suggestions: the ranking, and images for each explanation."""

from collections.abc import Mapping, Sequence
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.planning.page import record_command, set_up, STYLE, truth_line
from flexx2_sim_ros.gap.planning.possible import PredictedView
from flexx2_sim_ros.gap.report.frames import quantile
from flexx2_sim_ros.gap.report.text import percent
from flexx2_sim_ros.html_drawing import picture
from flexx2_sim_ros.html_page import html_page
import numpy as np

_STYLE = (
    STYLE
    + """
.views { display: grid; grid-template-columns: repeat(auto-fill, minmax(7.8rem, 1fr));
  gap: .8rem; margin: .8rem 0; }
.views img { width: 100%; display: block; margin-bottom: .3rem; outline: 1px solid var(--line); }
td:not(:first-child):not(:last-child) { white-space: nowrap; }
.ranking { min-width: 44rem; }
"""
)
_MOST_ROWS = 20
_TOP = 0.98  # quantile of the changes at the end of the colour scale
_LOUD = 3.0  # end of the colour scale of the noise, in medians
_ALL_VALID = 0.999
_BASELINES = {'repeat': 'mean of repeats', 'random': 'mean of the plan'}
_FEW = 0.5  # expected fraction right from which on a suggestion is more likely right than not


def page(table: Mapping[str, Any], views: Sequence[PredictedView], lens: Intrinsics) -> str:
    """Return the suggestions of `suggest` as a page, all text escaped and all pictures inside."""
    body = [
        html.heading('What to record next', 1),
        html.paragraphs(
            ['The diagnosis leaves these explanations. A recording can tell them apart.']
        ),
        _explanations(table),
        html.paragraphs([suggested(table)]),
        html.heading('Ranking'),
        _ranking(table),
        *(_view(i, one, table['explanations'], lens) for i, one in enumerate(views)),
    ]
    return html_page('What to record next', _STYLE, '\n'.join(body))


def suggested(table: Mapping[str, Any]) -> str:
    """Return what to record next, how, and what to expect of it, in sentences."""
    one = table['suggestion']
    names = ' and '.join(f'{row["name"]} (truth: {row["truth"]})' for row in one['record'])
    each = 'twice each' if len(one['record']) > 1 else 'twice'
    expected = (
        f'It is expected to settle the question correctly in {percent(one["right"])} of cases and '
        f'wrongly in {percent(one["wrong"])}.'
    )
    if one['right'] < _FEW:
        expected += (
            ' So these recordings are not likely to be enough: a more accurate ground truth, more '
            'frames, or more set-ups of the ranking may be needed.'
        )
    return (
        f'Record {names} {each}, and set it up anew in between: an effect is only found if it '
        'also shows in recordings that were left out of its fit. Add the recordings to the '
        f'campaign and diagnose again. {expected}'
    )


def baselines(table: Mapping[str, Any]) -> list[tuple[str, Mapping[str, float]]]:
    """Return the baselines of the ranking: a description and the expected value of each."""
    return [
        (words, table['baselines'][k])
        for k, words in _BASELINES.items()
        if k in table['baselines']
    ]


def _explanations(table: Mapping[str, Any]) -> html.Html:
    rows = []
    for name, effects in table['explanations'].items():
        values = '; '.join(
            f'{effect}: ' + ', '.join(f'{k} {v:.3g}' for k, v in own.items() if _told(k, v))
            for effect, own in effects.items()
        )
        rows.append([name, percent(table['probabilities'][name]), values])
    return html.table(['explanation', 'probability', 'simulated with'], rows)


def _told(name: str, value: Any) -> bool:
    return isinstance(value, int | float) and value != 0 and (name, value) != ('strength', 1.0)


def _ranking(table: Mapping[str, Any]) -> html.Html:
    rows = [
        html.row(_cells(f'{row["name"]}, truth: {row["truth"]}', row))
        for row in table['ranking'][:_MOST_ROWS]
    ]
    rows += [html.row(_cells(words, one), 'dim') for words, one in baselines(table)]
    left = len(table['ranking']) - _MOST_ROWS
    more = f' {left} more are in next.json.' if left > 0 else ''
    heads = ('record twice', 'settles it correctly', 'wrongly', 'not')
    return html.join(
        html.table(heads, rows, 'ranking'),
        html.note(
            'The fractions are those of simulated diagnoses of all recordings together, if the '
            'explanations are as likely as above. They do not know of causes that are not in that '
            'table, and have been tested on few campaigns: see '
            f'docs/diagnose_your_flexx2.md.{more} Mean of repeats: of repeating a recording that '
            'was diagnosed. Mean of the plan: of a random recording of the plan.'
        ),
    )


def _cells(record: str, row: Mapping[str, Any]) -> list[str]:
    return [record, *(percent(row[key]) for key in ('right', 'wrong', 'undecided'))]


def _view(
    index: int, view: PredictedView, explanations: Mapping[str, Any], lens: Intrinsics
) -> html.Html:
    one = view.possible
    planned, title = one.planned, f'{index + 1}. {one.name}'
    words = [html.paragraphs([one.words])]
    if planned is not None:
        title += f': {planned.title}'
        words.append(html.shell([record_command(planned)]))
    return html.join(
        html.heading(title),
        set_up(planned, lens, *words, truth_line(one.kind.words)),
        _looks(view, explanations),
    )


def _looks(view: PredictedView, explanations: Mapping[str, Any]) -> html.Html:
    # Images of each explanation, with the same colours for all.
    none = next(i for i, effects in enumerate(explanations.values()) if not effects)
    changed = max(quantile(np.abs(error - view.error[none]), _TOP) for error in view.error)
    top, loud = max(changed, 1e-4), max(_LOUD * float(np.nanmedian(view.noise)), 1e-4)
    rows = [('mean error', view.error, top), ('noise', view.noise, loud)]
    valid = 'All pixels are valid with any of them.'
    if np.nanmin(view.valid) < _ALL_VALID:
        rows.append(('invalid pixels', view.valid - 1, 1.0))
        valid = 'Last row: invalid pixels (blue: never valid).'
    cells = [
        html.element(
            'figure',
            html.element('figcaption', name),
            *(
                html.element('img', alt=f'{what} with {name}', src=picture(images[i], limit))
                for what, images, limit in rows
            ),
        )
        for i, name in enumerate(explanations)
    ]
    return html.join(
        html.element('div', *cells, kind='views'),
        html.note(
            f'First row: mean error (red: too far, blue: too near; full colour at '
            f'{1000 * top:.1f} mm). Second row: noise from frame to frame (full colour at '
            f'{1000 * loud:.1f} mm). {valid} Gray: no depth, or no ground truth.'
        ),
    )
