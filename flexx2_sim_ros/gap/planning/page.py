"""The readable plan: a checklist in Markdown, and a page with drawings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
import math
import shlex
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.planning.drawing import as_data_url, drawing
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.scenes import Panel
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.truth.plane_file import plane_form

_NODE = '/pmd_royale_ros_camera_node'  # of the real driver (pmd-royale-ros)
_STYLE = """
td, th { padding: .2rem 1rem .2rem 0; text-align: left; vertical-align: top; }
th, small { color: var(--dim); }
.set { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.set img { width: 26rem; }
.set div { flex: 1; min-width: 18rem; }
.open { color: var(--red); }
pre { background: var(--faint); padding: .5rem .7rem; overflow-x: auto; }
pre code { background: none; padding: 0; }
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

    Attributes
    ----------
    plan : Plan
        The recordings.
    profile : Profile
        The camera.
    table : dict
        The result of `table.compute`.
    own : bool
        Whether the table was computed for this plan.
    named : str
        What ``--profile`` of other commands takes for this camera; empty: a Flexx2.

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
        f'<h1>{escape(plan.title)}</h1>',
        f'<p><small>{len(plan.recordings)} recordings, mode {escape(plan.usecase)}, '
        f'{escape(told.profile.model)}</small></p>',
        '<h2>You need</h2><ul>',
        *(f'<li>{_code(one)}</li>' for one in _PREPARE),
        f'</ul><p>{escape(_TILT)}</p>',
        f'<h2>Before you start</h2>{_shell(_before(told))}',
        *(_set_up(planned, told.profile) for planned in plan.recordings),
        f'<h2>Afterwards</h2>{_shell(_afterwards(told))}',
        f'<p>{_code(_UPTIME)}</p>',
        f'<h2>What this plan can find</h2><p>{_code(_table_words(told))}</p>',
        '<div class="scroll"><table><tr>',
        *(f'<th>{escape(one)}</th>' for one in header),
        '</tr>',
        *('<tr>' + ''.join(f'<td>{_mark(one)}</td>' for one in row) + '</tr>' for row in rows),
        f'</table></div><p><small>{escape(_kinds(told.table))}</small></p>',
    ]
    return html_page(plan.title, _STYLE, '\n'.join(body))


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


def _shell(lines: Sequence[str]) -> str:
    return f'<pre><code>{escape(chr(10).join(lines))}</code></pre>'


def _set_up(planned: PlannedRecording, profile: Profile) -> str:
    name = escape(planned.name)
    return (
        f'<h2><input type="checkbox" aria-label="{name} is recorded"> {name}: '
        f'{escape(planned.title)}</h2><div class="set"><figure><img alt="set-up of {name}" '
        f'src="{as_data_url(drawing(planned, profile.intrinsics))}"></figure><div>'
        f'<p>{escape(planned.set_up)}</p><pre><code>{escape(record_command(planned))}</code></pre>'
        f'<p><small>For</small> {escape(", ".join(planned.effects))}</p>'
        f'<p><small>Ground truth:</small> {escape(truth_words(planned))}</p></div></div>'
    )


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
    return f'<span class="open">{cell}</span>' if cell in ('open', '-') else escape(cell)


def _code(text: str) -> str:
    # Shows text between backquotes as code.
    parts = escape(text).split('`')
    return ''.join(f'<code>{one}</code>' if i % 2 else one for i, one in enumerate(parts))
