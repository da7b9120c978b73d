"""The page of suggestions: the ranking, and images for each explanation."""

from collections.abc import Mapping
from html import escape
from typing import Any

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.planning.drawing import as_data_url, drawing
from flexx2_sim_ros.gap.planning.looks import PredictedView
from flexx2_sim_ros.gap.planning.next_recording import Suggestions
from flexx2_sim_ros.gap.planning.page import record_command
from flexx2_sim_ros.gap.report.text import percent
from flexx2_sim_ros.html_drawing import picture
from flexx2_sim_ros.html_page import html_page
import numpy as np

_STYLE = """
td, th { padding: .2rem 1rem .2rem 0; text-align: left; vertical-align: top; }
th, small { color: var(--dim); }
.set { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.set img { width: 26rem; }
.set div { flex: 1; min-width: 16rem; }
.views { display: grid; grid-template-columns: repeat(auto-fill, minmax(7.8rem, 1fr));
  gap: .8rem; margin: .8rem 0; }
.views img { width: 100%; display: block; margin-bottom: .3rem; outline: 1px solid var(--line); }
td:not(:first-child):not(:last-child) { white-space: nowrap; }
.ranking { min-width: 44rem; }
.baseline td { color: var(--dim); }
pre { background: var(--faint); padding: .5rem .7rem; overflow-x: auto; }
pre code { background: none; padding: 0; }
"""
_MOST_ROWS = 20
_TOP = 98.0  # percentile of the changes at the end of the colour scale
_LOUD = 3.0  # end of the colour scale of the noise, in medians
_ALL_VALID = 0.999
_BASELINES = {'repeat': 'mean of repeats', 'random': 'mean of the plan'}
_FEW = 0.5  # expected fraction right from which on a suggestion is more likely right than not


def page(found: Suggestions, lens: Intrinsics) -> str:
    """
    Return the suggestions as a page, all text escaped and all pictures inside.

    Parameters
    ----------
    found : Suggestions
        The result of `suggest`.
    lens : Intrinsics
        The intrinsics of the camera.

    """
    table = found.table
    body = [
        '<h1>What to record next</h1>',
        '<p>The diagnosis leaves these explanations. A recording can tell them apart.</p>',
        _explanations(table),
        f'<p>{escape(suggested(table))}</p><h2>Ranking</h2>',
        _ranking(table),
        *(_view(i, one, table['explanations'], lens) for i, one in enumerate(found.views)),
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


def _explanations(table: Mapping[str, Any]) -> str:
    rows = []
    for name, effects in table['explanations'].items():
        values = '; '.join(
            f'{effect}: ' + ', '.join(f'{k} {v:.3g}' for k, v in own.items() if _told(k, v))
            for effect, own in effects.items()
        )
        rows.append(
            f'<tr><td>{escape(name)}</td><td>{percent(table["probabilities"][name])}</td>'
            f'<td>{escape(values)}</td></tr>'
        )
    return (
        '<div class="scroll"><table><tr><th>explanation</th><th>probability</th>'
        f'<th>simulated with</th></tr>{"".join(rows)}</table></div>'
    )


def _told(name: str, value: Any) -> bool:
    return isinstance(value, int | float) and value != 0 and (name, value) != ('strength', 1.0)


def _ranking(table: Mapping[str, Any]) -> str:
    rows = [
        (f'{row["name"]}, truth: {row["truth"]}', row, ' against '.join(row['best_told_apart']))
        for row in table['ranking'][:_MOST_ROWS]
    ]
    cells = [_row(*row) for row in rows]
    cells += [_row(words, one, '', 'baseline') for words, one in baselines(table)]
    left = len(table['ranking']) - _MOST_ROWS
    more = f' {left} more are in next.json.' if left > 0 else ''
    return (
        '<div class="scroll"><table class="ranking"><tr><th>record twice</th>'
        '<th>settles it correctly</th><th>wrongly</th><th>not</th><th>information, bit</th>'
        '<th>tells apart best</th></tr>'
        f'{"".join(cells)}</table></div><p><small>The fractions are those of simulated '
        'diagnoses of all recordings together, if the explanations are as likely as above. They '
        'do not know of causes that are not in that table, and have been tested on few '
        'campaigns: see docs/diagnose_your_flexx2.md. One recording tells so many bits; '
        f'{table["most_bits"]:.2f} bit would decide between all explanations.{more} Mean of '
        'repeats: of repeating a recording that was diagnosed. Mean of the plan: of a random '
        'recording of the plan.</small></p>'
    )


def _row(record: str, row: Mapping[str, Any], apart: str, kind: str = '') -> str:
    shares = ''.join(f'<td>{percent(row[key])}</td>' for key in ('right', 'wrong', 'undecided'))
    return (
        f'<tr class="{kind}"><td>{escape(record)}</td>{shares}<td>{row["bits"]:.2f}</td>'
        f'<td>{escape(apart)}</td></tr>'
    )


def _view(
    index: int, view: PredictedView, explanations: Mapping[str, Any], lens: Intrinsics
) -> str:
    one = view.possible
    planned, title = one.planned, f'{index + 1}. {one.name}'
    set_up = command = ''
    if planned is not None:
        title += f': {planned.title}'
        set_up = (
            f'<figure><img alt="set-up of {escape(one.name)}" '
            f'src="{as_data_url(drawing(planned, lens))}"></figure>'
        )
        command = f'<pre><code>{escape(record_command(planned))}</code></pre>'
    return (
        f'<h2>{escape(title)}</h2><div class="set">{set_up}<div><p>{escape(one.words)}</p>'
        f'{command}<p><small>Ground truth:</small> {escape(one.kind.words)}</p></div></div>'
        + _looks(view, explanations)
    )


def _looks(view: PredictedView, explanations: Mapping[str, Any]) -> str:
    # Images of each explanation, with the same colours for all.
    none = next(i for i, effects in enumerate(explanations.values()) if not effects)
    changed = max(_percentile(np.abs(error - view.error[none])) for error in view.error)
    top, loud = max(changed, 1e-4), max(_LOUD * float(np.nanmedian(view.noise)), 1e-4)
    rows = [('mean error', view.error, top), ('noise', view.noise, loud)]
    valid = 'All pixels are valid with any of them.'
    if np.nanmin(view.valid) < _ALL_VALID:
        rows.append(('invalid pixels', view.valid - 1, 1.0))
        valid = 'Last row: invalid pixels (blue: never valid).'
    cells = [
        f'<figure><figcaption>{escape(name)}</figcaption>'
        + ''.join(
            f'<img alt="{what} with {escape(name)}" src="{picture(images[i], limit)}">'
            for what, images, limit in rows
        )
        + '</figure>'
        for i, name in enumerate(explanations)
    ]
    return (
        f'<div class="views">{"".join(cells)}</div><p><small>First row: mean error (red: too far, '
        f'blue: too near; full colour at {1000 * top:.1f} mm). Second row: noise from frame to '
        f'frame (full colour at {1000 * loud:.1f} mm). {valid} Gray: no depth, or no ground '
        'truth.</small></p>'
    )


def _percentile(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, _TOP)) if len(finite) else 0.0
