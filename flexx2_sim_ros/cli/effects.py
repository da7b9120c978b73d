"""`flexx2 effects`: list the effects, write presets, draw an effect."""

import argparse
from pathlib import Path

from flexx2_sim_ros.atomic import checked_target, write_texts
from flexx2_sim_ros.cli.common import plain_table
from flexx2_sim_ros.cli.options import Step
from flexx2_sim_ros.effects import Effect, load_effects, registry
from flexx2_sim_ros.effects.presets import bounds, markdown, preset_files
from flexx2_sim_ros.errors import InputError, shown, shown_path
from rich.console import Console
from rich.markup import escape
from rich.table import Table

OPTIONS = """
List the effects of a real camera that the noise model leaves out, in the order in which they act
on the light: parameters, typical values, ranges and units. flexx2 simulate --effects or the
parameters of the camera node switch them on.

/ --sources: list the source of each effect instead of its parameters
/ --markdown: print the page docs/effects.md
/ --write-presets DIR: write a YAML file for each effect, and typical.yaml

examples: flexx2 effects --sources, flexx2 effects show multipath
"""
VALUES = {'write_presets': Path}
_SHOW = """
Write a picture: a fixed scene with the effect, what the effect changes in it, and this change as a
curve against the quantity that it depends on.

name NAME: an effect, see flexx2 effects
--out PNG: picture to write (default: NAME.png)
--effects FILE: draw the effect as a file has it (default: at its typical strength)

example: flexx2 effects show multipath --out multipath.png
"""


def run(arguments: argparse.Namespace) -> int:
    """Print a table, or write presets."""
    if arguments.write_presets is not None:
        files = preset_files()
        write_texts(arguments.write_presets, files)
        print(f'{arguments.write_presets}: {len(files)} files')
    elif arguments.markdown:
        print(markdown(), end='')
    else:
        Console().print(_sources() if arguments.sources else _parameters())
        Console().print(
            'In the order of light. Each has a strength, too: 0 is off, 1 typical, 4 the most.\n'
            'See also: flexx2 effects --sources, flexx2 effects show NAME',
            style='dim',
            highlight=False,
        )
    return 0


def _table(*columns: str) -> Table:
    numbers = {'typical', 'range'}
    return plain_table(
        *columns, text={*columns} - numbers, whole={'effect', 'parameter', *numbers}
    )


def _parameters() -> Table:
    table = _table('effect', 'stage', 'parameter', 'typical', 'range', 'unit')
    for kind in registry().values():
        first = True
        for item in kind.parameters():
            if item.name != 'strength':
                head = (kind.name, kind.stage.name.lower()) if first else ('', '')
                values = f'{item.default:g}', bounds(item), escape(item.unit)
                table.add_row(*head, item.name, *values)
                first = False
        if first:
            table.add_row(kind.name, kind.stage.name.lower())
    return table


def _sources() -> Table:
    table = _table('effect', 'what it is, and where it is from')
    for kind in registry().values():
        table.add_row(kind.name, f'{escape(kind.title)}\n[dim]{escape(kind.source)}[/dim]')
    return table


def run_show(arguments: argparse.Namespace) -> int:
    """Write the picture of one effect, and print its parameters."""
    known = registry()
    if arguments.name not in known:
        raise InputError(f'NAME: must be one of {", ".join(known)}, got {shown(arguments.name)}')
    from flexx2_sim_ros.cli.effects_picture import draw

    effect = _effect_of(arguments.effects, arguments.name)
    kind = type(effect)
    path = arguments.out or Path(f'{kind.name}.png')
    checked_target(path)
    draw(path, effect)
    console = Console(markup=False)
    console.print(f'{kind.name}: {kind.title}', highlight=False)
    console.print(kind.source, style='dim', highlight=False)
    table = _table('parameter', 'typical', 'range', 'unit', '')
    for item in kind.parameters():
        table.add_row(item.name, f'{item.default:g}', bounds(item), item.unit, item.text)
    console.print(table)
    console.print(f'{path}: written', highlight=False)
    return 0


def _effect_of(file: str | None, name: str) -> Effect:
    # The effect with the parameters of a file, or at its typical strength.
    if file is None:
        return registry()[name]()
    for effect in load_effects(file):
        if effect.name == name:
            return effect
    raise InputError(f'--effects: {shown_path(file)}: must have {name}, got no such effect')


STEPS = {'show': Step('draw what an effect does', _SHOW, run_show, {'out': Path})}
