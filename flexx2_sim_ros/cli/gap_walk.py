"""`flexx2 gap walk`: how often a walking robot fails with a diagnosed camera."""

import argparse
from typing import Any

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import number, whole_number
from rich.console import Console
from rich.table import Column

OPTIONS = """
Let simulated robots walk over stairs, rubble and gaps with footholds chosen on the height grid
that their cameras see: with perfect depth, with the noise model, and with the diagnosed effects
added. Writes walk.json and the figure walk.png. Forces are not simulated; docs/robots.md says when
a walk fails. Needs pip install "flexx2_sim_ros[gap,mujoco]".

diagnosis DIAGNOSIS: folder that flexx2 gap diagnose has written
--out
--walks WALKS: walks for each terrain and step height (default %(default)s)
--steps METRES: step heights (default: 0.03, 0.06, ... 0.15)
--robot NAME: go1, go2 or a YAML file (default go1)
--json: print walk.json to standard output, and no table
--profile
--seed
--jobs

example: flexx2 gap walk diagnosis/ --out walk/
"""
VALUES = {
    'walks': {'type': whole_number(1, 100_000), 'default': 200},
    'steps': {'nargs': '+', 'type': number(0, 0.5)},
    'robot': 'go1',
}


def run(arguments: argparse.Namespace) -> int:
    """Walk with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.cli.batch import import_warp

    import_warp()
    from flexx2_sim_ros.gap.walk import walk

    common.call_and_print(walk, arguments, f'{arguments.out}: walk.json, walk.png', _show)
    return 0


def _show(table: dict[str, Any], console: Console) -> None:
    cameras = list(dict.fromkeys(row['camera'] for row in table['rows']))
    lines: dict[tuple[str, float], list[str]] = {}
    for row in table['rows']:
        low, high = row['interval']
        text = f'{100 * row["share"]:.0f} % ({100 * low:.0f} to {100 * high:.0f})'
        lines.setdefault((row['terrain'], row['step']), []).append(text)
    right = (Column(name, justify='right') for name in ('step', *cameras))
    rows = ([terrain, f'{100 * step:g} cm', *texts] for (terrain, step), texts in lines.items())
    title = f'walks that fail, of {table["settings"]["walks"]}, with 95 % interval'
    console.print(common.ruled_table(('terrain', *right), rows, title=title))
    if table['left_out']:
        names = ', '.join(table['left_out'])
        console.print(f'left out, as walks have no time since power-on: {names}')
