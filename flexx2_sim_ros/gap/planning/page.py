"""The readable plan: a checklist in Markdown, and a page with drawings."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
import shlex
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.camera import Intrinsics, Profile
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.planning.drawing import drawing
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.scenes import Panel
from flexx2_sim_ros.html_drawing import png_url
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.truth.plane_file import plane_form

_NODE = '/pmd_royale_ros_camera_node'  # of the real driver (pmd-royale-ros)
STYLE = """
.set { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.set img { width: 26rem; }
.set div { flex: 1; min-width: 17rem; }
"""
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


@dataclass(frozen=True)
class Checklist:
    """
    The content of the checklist and of the page.

    `table` is the result of `table.compute`, `own` whether it was computed for this plan. `named`
    is what ``--profile`` of other commands takes for this camera; empty: a Flexx2.
    """

    plan: Plan
    profile: Profile
    table: Mapping[str, Any]
    own: bool
    named: str = ''


def record_command(planned: PlannedRecording) -> str:
    """Return the command that records."""
    return f'flexx2 record recordings/{planned.name} --seconds {planned.seconds:g}'


def truth_words(planned: PlannedRecording) -> str:
    """Return which ground truth suits a recording, and what to measure for it, as text."""
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
    seen = {}
    for planned in plan.recordings:
        if not planned.scene.moving:
            panels = map(_plane, planned.scene.panels)
            seen[planned.name] = {
                f'plane {number}': words for number, words in enumerate(panels, 1)
            }
    return plane_form(seen)


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
            f'    {record_command(planned)}',
            '',
            f'- For: {", ".join(planned.effects)}',
            f'- Ground truth: {truth_words(planned)}',
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
        *(_set_up(planned, told.profile) for planned in plan.recordings),
        html.heading('Afterwards'),
        html.shell(_afterwards(told)),
        html.paragraphs([html.code(_UPTIME)]),
        html.heading('What this plan can find'),
        html.paragraphs([html.code(_table_words(told))]),
        html.table(header, [[_mark(one) for one in row] for row in rows]),
        html.note(_kinds(told.table)),
    ]
    return html_page(plan.title, STYLE, '\n'.join(body))


_UPTIME = (
    'A bag does not say when the camera was switched on. `flexx2 gap truth` counts the time from '
    'the earliest recording: begin with the cold start, and leave the camera on until the end. '
    'With --uptime (seconds from power-on to the first frame) the size of a drift is that at '
    'power-on.'
)


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


def _set_up(planned: PlannedRecording, profile: Profile) -> html.Html:
    name, box = planned.name, {'type': 'checkbox', 'aria-label': f'{planned.name} is recorded'}
    title = html.element('h2', html.element('input', **box), f' {name}: {planned.title}')
    return html.join(
        title,
        set_up(
            planned,
            profile.intrinsics,
            html.paragraphs([planned.set_up]),
            html.shell([record_command(planned)]),
            html.element('p', html.element('small', 'For'), f' {", ".join(planned.effects)}'),
            truth_line(truth_words(planned)),
        ),
    )


def set_up(planned: PlannedRecording | None, lens: Intrinsics, *words: str) -> html.Html:
    """Return words beside the drawing of a set-up, if there is one, for the style `STYLE`."""
    drawn = ''
    if planned is not None:
        url = png_url(drawing(planned, lens))
        drawn = html.element(
            'figure', html.element('img', alt=f'set-up of {planned.name}', src=url)
        )
    return html.element('div', drawn, html.element('div', *words), kind='set')


def truth_line(words: str) -> html.Html:
    """Return which ground truth suits a recording, as a line of its set-up."""
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
        cells = [_cell(found[kind]) if kind in found else '' for kind in kinds]
        rows.append([effect, *cells, _typical(effect)])
    return ['effect', *kinds, 'strength 1'], rows


def _cell(found: Mapping[str, Any]) -> str:
    if found['open']:
        return 'open'
    return '-' if found['smallest'] is None else f'{found["smallest"]:g}'


def _typical(effect: str) -> str:
    # The parameters of the effect at strength 1.
    kind = registry().get(effect)
    if kind is None:
        return ''
    values = [p for p in kind.parameters() if p.name not in ('strength', 'uptime') and p.default]
    return ', '.join(f'{p.name} {p.default:g} {p.unit}'.strip() for p in values)


def _kinds(table: Mapping[str, Any]) -> str:
    return '; '.join(f'{name}: {words}' for name, words in table['kinds'].items()) + '.'


def _mark(cell: str) -> str:
    return html.element('span', cell, kind='bad') if cell in ('open', '-') else cell
