"""`flexx2 gap walk`: how often a walking robot fails with a diagnosed camera."""

import argparse
from typing import Any

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.argument_types import number, whole_number
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.description = (
        'Let simulated robots walk over stairs, rubble and gaps with footholds chosen '
        'on the height grid that their cameras see: with perfect depth, with the noise model, and '
        'with the diagnosed effects added. Writes walk.json and the figure walk.png. Forces are '
        'not simulated; docs/robots.md says when a walk fails. Needs pip install '
        '"flexx2_sim_ros[gap,mujoco]".'
    )
    parser.epilog = 'example: flexx2 gap walk diagnosis/ --out walk/'
    parser.add_argument(
        'diagnosis', metavar='DIAGNOSIS', help='folder that flexx2 gap diagnose has written'
    )
    common.add_out(parser)
    parser.add_argument(
        '--walks',
        type=whole_number(1, 100_000),
        default=200,
        help='walks for each terrain and step height (default %(default)s)',
    )
    parser.add_argument(
        '--steps',
        nargs='+',
        type=number(0, 0.5),
        metavar='METRES',
        help='step heights (default: 0.03, 0.06, ... 0.15)',
    )
    parser.add_argument(
        '--robot', default='go1', metavar='NAME', help='go1, go2 or a YAML file (default go1)'
    )
    common.add_json(parser, 'walk.json')
    common.add_simulation(parser)


def run(arguments: argparse.Namespace) -> int:
    """Walk with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.cli.batch import import_warp

    import_warp()
    from flexx2_sim_ros.gap.walk import walk

    console = common.messages()
    with common.progress_bar(console) as progress:
        table = walk(
            arguments.diagnosis,
            robot=arguments.robot,
            walks=arguments.walks,
            **({} if arguments.steps is None else {'steps': arguments.steps}),
            **common.simulation(arguments),
            out=arguments.out,
            progress=progress,
        )
    if arguments.json:
        common.print_json(table)
    else:
        console.print(_table(table))
        if table['left_out']:
            names = ', '.join(table['left_out'])
            console.print(f'left out, as walks have no time since power-on: {names}')
        console.print(f'{arguments.out}: walk.json, walk.png ({table["seconds"]:.0f} s)')
    return 0


def _table(table: dict[str, Any]) -> Table:
    cameras = list(dict.fromkeys(row['camera'] for row in table['rows']))
    shown = Table(
        'terrain',
        Column('step', justify='right'),
        *(Column(name, justify='right') for name in cameras),
        title=f'walks that fail, of {table["settings"]["walks"]}, with 95 % interval',
        box=SIMPLE_HEAD,
    )
    lines: dict[tuple[str, float], list[str]] = {}
    for row in table['rows']:
        low, high = row['interval']
        text = f'{100 * row["share"]:.0f} % ({100 * low:.0f} to {100 * high:.0f})'
        lines.setdefault((row['terrain'], row['step']), []).append(text)
    for (terrain, step), texts in lines.items():
        shown.add_row(terrain, f'{100 * step:g} cm', *texts)
    return shown
