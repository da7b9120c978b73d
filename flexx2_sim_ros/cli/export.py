"""`flexx2 export`: write a camera's noise as parameters of mappers and simulators."""

import argparse
import math
from pathlib import Path

from flexx2_sim_ros.atomic import (
    check_no_overwrite,
    checked_target,
    output_folder,
    write_text,
    write_texts,
)
from flexx2_sim_ros.cli.common import call, messages, progress_bar
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.effects import load_effects
from flexx2_sim_ros.errors import InputError, printable, shown_path
from flexx2_sim_ros.export import ExportTarget, MapperNoise, measure_noise, Parameters, TARGETS
from flexx2_sim_ros.export.mapper_noise import ANGLES
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import Profile
from rich import box
from rich.console import Console
from rich.table import Column, Table

_ALL = 'all'
_CELL = 0.05  # metres, the default of octomap_server and nvblox
_ANGLES = ', '.join(f'{angle:g}' for angle in ANGLES)
OPTIONS = f"""
Write the noise of a mode as parameters of a mapper or simulator: {', '.join(TARGETS)}. The
parameters are fitted by least squares over the range of the mode. The command prints the worst
deviation of each fit, and what the target cannot hold. Without TARGET it lists the targets.

target TARGET: what to write for; {_ALL}: a file for each, in a folder
--profile
--usecase USECASE: mode (default: that of flexx2 simulate)
--effects FILE: effects beyond the noise model, e.g. effects.yaml of a diagnosis; what they change
    on a white wall is measured by simulation
--distances NEAR FAR: distances to fit for, metres (default: the range of the mode); the fewer, the
    better a target of one number fits
--incidence DEG: incidence angle to fit for (default: all of {_ANGLES})
--cell METRES: edge length of the map's cells (default {_CELL:g})
--out PATH: file, or folder for all (default: by target)
--force

examples: flexx2 export elevation_mapping --usecase Mode_5_30fps, flexx2 export all --effects
diagnosis/effects.yaml --out exported/
"""
VALUES = {
    'target': {'nargs': '?', 'choices': (*TARGETS, _ALL)},
    'distances': number(0, 1000),
    'incidence': number(0, 80),
    'cell': {'type': number(0.001, 10), 'default': _CELL},
    'out': Path,
}


def run(arguments: argparse.Namespace) -> int:
    """Measure, write, and print what was fitted and what is lost."""
    console = Console(markup=False, highlight=False)
    if arguments.target is None:
        console.print(_targets())
        return 0
    chosen = list(TARGETS.values())
    if arguments.target != _ALL:
        chosen = [TARGETS[arguments.target]]
    profile = find_profile(arguments.profile)
    out = _target_path(arguments, chosen, profile)
    effects = load_effects(arguments.effects) if arguments.effects else ()
    angles = ANGLES if arguments.incidence is None else (arguments.incidence,)
    with progress_bar(messages()) as report:
        noise = call(
            measure_noise,
            arguments,
            profile=profile,
            usecase=arguments.usecase or profile.default_usecase,
            effects=effects,
            angles=angles,
            progress=lambda done: report('measuring walls', done),
        )
    made = {target: target.write(noise, arguments.cell) for target in chosen}
    texts = {target.file_of(profile): parameters.text for target, parameters in made.items()}
    if arguments.target == _ALL:
        write_texts(out, texts)
    else:
        write_text(out, *texts.values())
    console.print(_fits(made))
    _print_losses(console, made)
    console.print(f'\n{shown_path(out)}: {_about(noise)}')
    return 0


def _target_path(
    arguments: argparse.Namespace, chosen: list[ExportTarget], profile: Profile
) -> Path:
    # Where to write. What is there is left alone without --force.
    if arguments.target == _ALL:
        if arguments.out is None:
            raise InputError('--out: must be a folder for all targets, got none')
        out = output_folder(arguments.out)
        files = [out / target.file_of(profile) for target in chosen]
    else:
        out = checked_target(arguments.out or Path(chosen[0].file_of(profile)))
        files = [out]
    check_no_overwrite('--out', files, arguments.force)
    return out


def _table(title: str, first: str, *others: str) -> Table:
    columns = [Column(name, overflow='fold') for name in others]
    return Table(Column(first, no_wrap=True), *columns, box=box.SIMPLE, title=title)


def _targets() -> Table:
    table = _table('Targets', 'target', 'file', 'holds')
    for target in TARGETS.values():
        table.add_row(target.name, target.file, target.holds)
    return table


def _fits(made: dict[ExportTarget, Parameters]) -> Table:
    title = 'What is written, as a ratio to the camera where it is worst'
    table = _table(title, 'target', 'parameter', 'form', 'ratio', 'at')
    for target, parameters in made.items():
        for name, fit in parameters.fits:
            table.add_row(target.name, name, fit.form, f'{fit.worst:.2f}', f'{fit.at:.2f} m')
        if not parameters.fits:
            table.add_row(target.name, '-', '-', '-', '-')
    return table


def _print_losses(console: Console, made: dict[ExportTarget, Parameters]) -> None:
    # What all targets lose is said once.
    every = [
        sentence
        for sentence in next(iter(made.values())).lost
        if all(sentence in parameters.lost for parameters in made.values())
    ]
    if len(made) > 1:
        console.print('None of them can hold:', style='bold')
        for sentence in every:
            console.print(f'  {sentence}')
    for target, parameters in made.items():
        own = [s for s in parameters.lost if len(made) == 1 or s not in every]
        if own:
            console.print(f'{target.name} cannot hold:', style='bold')
        for sentence in own:
            console.print(f'  {sentence}')


def _about(noise: MapperNoise) -> str:
    near, far = noise.typical[[0, -1]]
    ends = ' to '.join('?' if math.isnan(s) else f'{1e3 * s:.1f} mm' for s in (near, far))
    effects = f', with {", ".join(noise.effects)}' if noise.effects else ''
    return printable(
        f'{noise.profile.model}, {noise.mode.name}{effects}: sigma_z {ends} at '
        f'{noise.distance[0]:.2f} to {noise.distance[-1]:.2f} m'
    )
