"""`flexx2 modes`: the camera's modes as a table."""

import argparse
import math
from typing import Any

from flexx2_sim_ros.profiles.modes import flexx2
from rich import box
from rich.console import Console
from rich.table import Table

_TEXT = ('mode', 'noise of', 'measured in', 'source')
_WHOLE = ('mode', 'noise of', 'range [m]', 'MHz', 'measured in')


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'modes',
        help="list the camera's modes",
        epilog='example: flexx2 modes',
        description='List the modes: rate, range, modulation, raw frames, and the noise model '
        'with its coefficients.',
    )
    parser.set_defaults(run=run)


def run(_arguments: argparse.Namespace) -> int:
    """Print the tables."""
    modes = flexx2().modes
    table = _table('mode', 'rate [Hz]', 'range [m]', 'MHz', 'raw frames', 'noise of', 'source')
    for mode in modes:
        table.add_row(
            mode.name,
            f'{mode.rate_hz:g}',
            f'{mode.range_min:g} - {mode.range_max:g}',
            ' + '.join(f'{f / 1e6:g}' for f in mode.modulation_hz),
            str(mode.raw_frames),
            'itself' if mode.measured else f'{mode.noise_of}*',
            mode.source,
        )
    noise = _table('measured in', 'a', 'b', 'c', 'd', 'n', 'sigma_x', 'sigma_z')
    for mode in modes:
        if mode.measured:
            model = mode.noise
            facing, slanted = (
                1e3 * float(model.sigma_z(1.0, math.radians(angle))) for angle in (0.0, 60.0)
            )
            noise.add_row(
                mode.name,
                *(f'{value:.6f}' for value in (model.a, model.b, model.c, model.d)),
                f'{model.n:g}',
                f'{model.sigma_x:.3f}',
                f'{facing:.1f} / {slanted:.1f}',
            )
    console = Console(markup=False)
    console.print(table)
    console.print(
        '* not measured: takes the noise of the nearest measured mode of its family\n', style='dim'
    )
    console.print(noise)
    console.print(
        'sigma_z = a + b z + c z² + d zⁿ θ² / (π/2 - θ)², metres and radians; at '
        '1 m: mm, at 0° / 60°.\nsigma_x in pixels. Source: Cai et al., COINS 2024.',
        style='dim',
    )
    return 0


def _table(*names: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    for name in names:
        table.add_column(
            name, justify='left' if name in _TEXT else 'right', no_wrap=name in _WHOLE
        )
    return table
