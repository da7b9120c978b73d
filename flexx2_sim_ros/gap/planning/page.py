"""The plan as a checklist in Markdown and as a page with drawings, and the page of suggestions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import shlex
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.camera import Intrinsics, Profile
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.planning.drawing import drawing
from flexx2_sim_ros.gap.planning.next_recording import PredictedView
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.scenes import Panel
from flexx2_sim_ros.gap.report.frames import quantile
from flexx2_sim_ros.gap.report.text import percent, short
from flexx2_sim_ros.html_drawing import picture, png_url
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.truth.plane_file import plane_form
import numpy as np

_NODE = '/pmd_royale_ros_camera_node'  # of the real driver (pmd-royale-ros)
_STYLE = """
.set { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.set img { width: 26rem; }
.set div { flex: 1; min-width: 17rem; }
.views { display: grid; grid-template-columns: repeat(auto-fill, minmax(7.8rem, 1fr));
  gap: .8rem; margin: .8rem 0; }
.views img { width: 100%; display: block; margin-bottom: .3rem; outline: 1px solid var(--line); }
.ranking { min-width: 44rem; } .ranking td + td { white-space: nowrap; }
"""
_MOST_ROWS = 20
_TOP = 0.98  # quantile of the changes at the end of the colour scale
_LOUD = 3.0  # end of the colour scale of the noise, in medians
_ALL_VALID = 0.999
_BASELINES = {'repeat': 'mean of repeats', 'random': 'mean of the plan'}
_FEW = 0.5  # expected fraction right from which on a suggestion is more likely right than not
_PREPARE = (
    'A room with two bright, matt walls that meet in a corner, and about 4 m of free space. '
    'Daylight kept out.',
    'The camera on a tripod, switched off for half an hour.',
    'A flat white board of about 0.7 x 0.7 m, or a printed target on a board '
    '(`flexx2 gap target --out target.pdf`, print at 100 %).',
    'A black and a gray card of about 0.5 x 0.5 m, and a black one of 1 x 1 m; something shiny '
    'and white; a matt box of about 0.8 m.',
    'A scan of the room (phone or laser scanner, `.ply`), or a tape measure (better: a laser '
    'distance meter) and a set square: `planes.yaml` is the form. For a scan, put board, cards '
    'and box in their places first, and move only the camera afterwards: what the scan does not '
    'show becomes unknown.',
)
_TILT = (
    'Without a scan, measure the distance of each plane: in a wall seen straight on, a bias of '
    'the camera and a wrong distance look the same. Tilted views tell a bias from other errors '
    'that depend on distance.'
)
_UPTIME = (
    'A bag does not say when the camera was switched on. `flexx2 gap truth` counts the time from '
    'the earliest recording: begin with the cold start, and leave the camera on until the end. '
    'With --uptime (seconds from power-on to the first frame) the size of a drift is that at '
    'power-on.'
)


@dataclass(frozen=True)
class Checklist:
    """
    The content of the checklist and of the page.

    `table` is from `power.compute`, for this plan if `own`. `named` is what ``--profile`` takes
    for this camera; empty for a Flexx2.
    """

    plan: Plan
    profile: Profile
    table: Mapping[str, Any]
    own: bool
    named: str = ''


def _record_command(planned: PlannedRecording) -> str:
    return f'flexx2 record recordings/{planned.name} --seconds {planned.seconds:g}'


def _truth_words(planned: PlannedRecording) -> str:
    # Which ground truth suits a recording, and what to measure for it.
    if planned.scene.turn_rate:
        return 'a scan of the room (the camera moves, so planes cannot be used)'
    if planned.scene.moving:
        return (
            'a scan of the room, in which whatever moves is unknown; motion capture gives the rest'
        )
    planes = ', '.join(dict.fromkeys(_plane(panel) for panel in planned.scene.panels))
    return f'a scan of the room, or planes with a tape and a set square: {planes}'


def _plane(panel: Panel) -> str:
    tilt = math.degrees(math.atan2(panel.across[2], panel.across[0]))
    turned = 'straight on' if abs(tilt) < 0.5 else f'tilted by {abs(tilt):.0f} degrees'
    return f'{panel.centre[2]:g} m {turned}'


def form(plan: Plan) -> str:
    """Return ``planes.yaml`` for the recordings in which nothing moves, to be filled in."""
    return plane_form(
        {
            one.name: {f'plane {k}': _plane(panel) for k, panel in enumerate(one.scene.panels, 1)}
            for one in plan.recordings
            if not one.scene.moving
        }
    )


def markdown(told: Checklist) -> str:
    """Return the checklist."""
    plan = told.plan
    lines = [f'# {plan.title}', '', f'{len(plan.recordings)} recordings, mode {plan.usecase}.', '']
    lines += ['## You need', '', *(f'- {one}' for one in _PREPARE), '', _TILT, '']
    lines += ['## Before you start', '', '```bash', *_before(told), '```', '']
    for planned in plan.recordings:
        lines += [
            f'## [ ] {planned.name}: {planned.title}',
            '',
            planned.set_up,
            '',
            f'    {_record_command(planned)}',
            '',
            f'- For: {", ".join(planned.effects)}',
            f'- Ground truth: {_truth_words(planned)}',
            '',
        ]
    lines += ['## Afterwards', '', '```bash', *_afterwards(told), '```', '']
    lines += [_UPTIME, '', '## What this plan can find', '', _table_words(told), '']
    header, rows = _cells(told.table)
    lines += [f'| {" | ".join(header)} |', '|---' * len(header) + '|']
    lines += [f'| {" | ".join(row)} |' for row in rows]
    return '\n'.join([*lines, '', _kinds(told.table), ''])


def page(told: Checklist) -> str:
    """Return the checklist as a page with drawings, all text escaped and all pictures inside."""
    plan = told.plan
    header, rows = _cells(told.table)
    body = [
        html.heading(plan.title, 1),
        html.note(f'{len(plan.recordings)} recordings, mode {plan.usecase}, {told.profile.model}'),
        html.heading('You need'),
        html.bullets(map(html.code, _PREPARE)),
        html.paragraphs([_TILT]),
        html.heading('Before you start'),
        html.shell(_before(told)),
        *(_to_record(planned, told.profile.intrinsics) for planned in plan.recordings),
        html.heading('Afterwards'),
        html.shell(_afterwards(told)),
        html.paragraphs([html.code(_UPTIME)]),
        html.heading('What this plan can find'),
        html.paragraphs([html.code(_table_words(told))]),
        html.table(header, [[_mark(one) for one in row] for row in rows]),
        html.note(_kinds(told.table)),
    ]
    return html_page(plan.title, _STYLE, '\n'.join(body))


def _before(told: Checklist) -> list[str]:
    # How another camera's driver chooses its mode is not known here.
    mode = [] if told.named else [f'ros2 param set {_NODE} usecase {told.plan.usecase}']
    return [*mode, 'mkdir recordings']


def _afterwards(told: Checklist) -> list[str]:
    camera = f' --profile {shlex.quote(told.named)}' if told.named else ''
    return [
        f'flexx2 gap start recordings/ --scan room.ply --out gap/{camera}',
        '# or, with what you measured in planes.yaml:',
        f'flexx2 gap start recordings/ --planes planes.yaml --out gap/{camera}',
    ]


def _to_record(planned: PlannedRecording, lens: Intrinsics) -> html.Html:
    name, box = planned.name, {'type': 'checkbox', 'aria-label': f'{planned.name} is recorded'}
    return html.join(
        html.element('h2', html.element('input', **box), f' {name}: {planned.title}'),
        _set_up(
            planned,
            lens,
            html.paragraphs([planned.set_up]),
            html.shell([_record_command(planned)]),
            html.element('p', html.element('small', 'For'), f' {", ".join(planned.effects)}'),
            _truth_line(_truth_words(planned)),
        ),
    )


def _set_up(planned: PlannedRecording | None, lens: Intrinsics, *words: str) -> html.Html:
    # Words beside the drawing of a set-up, if there is one.
    drawn = ''
    if planned is not None:
        url = png_url(drawing(planned, lens))
        drawn = html.element(
            'figure', html.element('img', alt=f'set-up of {planned.name}', src=url)
        )
    return html.element('div', drawn, html.element('div', *words), kind='set')


def _truth_line(words: str) -> html.Html:
    return html.element('p', html.element('small', 'Ground truth:'), f' {words}')


def _table_words(told: Checklist) -> str:
    table = told.table
    whose = (
        'Computed for this plan'
        if told.own
        else 'Computed for the Flexx2 and the plan of this package; `--compute` computes it for '
        'yours'
    )
    simulation = table['simulation']
    return (
        'The smallest of the strengths '
        f'{", ".join(f"{one:g}" for one in table["strengths"])} from which on the effect is named '
        'first in at least 90 % of the draws, if it is the only one, and no undecided effect '
        'explains the gap about as well. Strength 1 is typical. "-": not even at the largest. '
        '"open": this ground truth leaves it undecided. '
        f'{whose}, by `{table["command"]}` on {table["date"]}: {table["draws"]} draws, '
        f'{simulation["frames"]} frames, image of {simulation["scale"]:g} times the size.'
    )


def _cells(table: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    kinds = list(table['kinds'])
    rows = []
    for effect, found in table['effects'].items():
        rows.append([effect, *(_cell(found[kind]) for kind in kinds), _typical(effect)])
    return ['effect', *kinds, 'strength 1'], rows


def _cell(found: Mapping[str, Any]) -> str:
    if found['open']:
        return 'open'
    return '-' if found['smallest'] is None else f'{found["smallest"]:g}'


def _typical(effect: str) -> str:
    # The parameters of the effect at strength 1.
    parameters = registry()[effect].parameters()
    values = [p for p in parameters if p.name not in ('strength', 'uptime') and p.default]
    return ', '.join(f'{p.name} {p.default:g} {p.unit}'.strip() for p in values)


def _kinds(table: Mapping[str, Any]) -> str:
    return '; '.join(f'{name}: {words}' for name, words in table['kinds'].items()) + '.'


def _mark(cell: str) -> str:
    kind = {'open': 'dim', '-': 'bad'}.get(cell)  # Unknown is gray.
    return html.element('span', cell, kind=kind) if kind else cell


def suggestions(table: Mapping[str, Any], views: Sequence[PredictedView], lens: Intrinsics) -> str:
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
            f'{effect}: ' + ', '.join(f'{k} {short(v, 3)}' for k, v in own.items() if _told(k, v))
            for effect, own in effects.items()
        )
        rows.append([name, percent(table['probabilities'][name]), values])
    return html.table(['explanation', 'probability', 'simulated with'], rows)


def _told(name: str, value: Any) -> bool:
    return isinstance(value, int | float) and value != 0 and (name, value) != ('strength', 1.0)


def _ranking(table: Mapping[str, Any]) -> html.Html:
    rows = [
        html.row(_fractions(f'{row["name"]}, truth: {row["truth"]}', row))
        for row in table['ranking'][:_MOST_ROWS]
    ]
    rows += [html.row(_fractions(words, one), 'dim') for words, one in baselines(table)]
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


def _fractions(record: str, row: Mapping[str, Any]) -> list[str]:
    return [record, *(percent(row[key]) for key in ('right', 'wrong', 'undecided'))]


def _view(
    index: int, view: PredictedView, explanations: Mapping[str, Any], lens: Intrinsics
) -> html.Html:
    one = view.possible
    planned, title = one.planned, f'{index + 1}. {one.name}'
    words = [html.paragraphs([one.words])]
    if planned is not None:
        title += f': {planned.title}'
        words.append(html.shell([_record_command(planned)]))
    return html.join(
        html.heading(title),
        _set_up(planned, lens, *words, _truth_line(one.kind.words)),
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
