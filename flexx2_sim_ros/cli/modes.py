"""`flexx2 modes`: the camera's modes as a table."""

import argparse
import math

from flexx2_sim_ros.cli.common import plain_table
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import BUILT_IN, find_profile, shipped
from flexx2_sim_ros.profiles.modes import Mode
from flexx2_sim_ros.profiles.sensor import KINDS
from rich.console import Console

_TEXT = ('mode', 'noise of', 'source')
_WHOLE = ('mode', 'noise of', 'range [m]', 'MHz')
OPTIONS = f"""
List the modes: rate, range, modulation, raw frames, and the noise model with its coefficients.
Shipped profiles: {', '.join(shipped())}.

--profile

example: flexx2 modes --profile kinect_v2
"""


def run(arguments: argparse.Namespace) -> int:
    """Print the tables."""
    profile = find_profile(arguments.profile)
    modes = profile.modes
    names: tuple[str, ...] = 'mode', 'rate [Hz]', 'range [m]', 'MHz', 'raw frames'
    names += 'noise of', 'source'
    table = plain_table(*names, text=_TEXT, whole=_WHOLE)
    for mode in modes:
        table.add_row(
            mode.name,
            f'{mode.rate_hz:g}',
            f'{mode.range_min:g} - {mode.range_max:g}',
            ' + '.join(f'{f / 1e6:g}' for f in mode.modulation_hz) or '-',
            str(mode.raw_frames or '-'),
            _noise_of(mode),
            mode.source,
        )
    names = 'noise of', *'abcdn', 'sigma_x', 'sigma_z'
    noise = plain_table(*names, text=_TEXT, whole=_WHOLE)
    for mode in modes:
        if mode.noise_of == mode.name:
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
    of_flexx2 = arguments.profile.lower() in ('', BUILT_IN)
    source = 'Cai et al., COINS 2024' if of_flexx2 else 'see the profile'
    console = Console(markup=False)
    if not of_flexx2:
        console.print(printable(f'{profile.model}, a {KINDS[profile.sensor.kind]}\n'))
    console.print(table)
    if not all(mode.measured for mode in modes):
        console.print(
            '* not measured in this mode'
            + (
                ': takes the noise of the nearest measured mode of its family\n'
                if of_flexx2
                else '\n'
            ),
            style='dim',
        )
    else:
        console.print()
    console.print(noise)
    console.print(
        'sigma_z = a + b z + c z² + d zⁿ θ² / (π/2 - θ)², metres and radians; at '
        f'1 m: mm, at 0° / 60°.\nsigma_x in pixels. Source: {source}.',
        style='dim',
    )
    return 0


def _noise_of(mode: Mode) -> str:
    if mode.measured:
        return 'itself'
    return f'{mode.noise_from.replace("_", " ") if mode.noise_of == mode.name else mode.noise_of}*'
