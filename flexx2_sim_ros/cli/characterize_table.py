"""The tables of `flexx2 characterize fit`: coefficients, errors and checks."""

import math

from flexx2_sim_ros.characterize.analysis import Characterization
from flexx2_sim_ros.characterize.assumptions import check_assumptions
from flexx2_sim_ros.characterize.axial_fit import NAMES
from flexx2_sim_ros.characterize.paper_tables import paper_noise, with_error
from flexx2_sim_ros.cli.common import plain_table
import numpy as np
from rich.console import Console


def print_result(result: Characterization) -> None:
    """Print one table, with the paper's figures below each mode that the paper measured."""
    console = Console(markup=False, highlight=False)
    names = 'mode', *NAMES, 'sigma_x', 'KL'
    table = plain_table(*names, text=('mode',), whole=names)
    for mode in result.modes:
        fit = mode.axial
        table.add_row(
            mode.usecase,
            *(f'{fit.coefficients[name]:.6f}' for name in NAMES[:4]),
            f'{fit.coefficients["n"]:.1f}',
            _text(mode.sigma_x, '.3f'),
            f'{np.mean([cell.axial.raw for cell in mode.cells]):.4f}',
        )
        errors = [fit.errors[name] for name in NAMES]
        table.add_row(
            '  ±',
            *(_text(error, '.1g') for error in errors[:4]),
            _text(errors[4], '.3f'),
            _text(mode.sigma_x_error, '.3f'),
            '',
            style='dim',
        )
        noise = paper_noise(result, mode.usecase)
        if noise is not None:
            table.add_row(
                '  paper',
                *(f'{getattr(noise, name):.6f}' for name in NAMES[:4]),
                f'{noise.n:.1f}',
                f'{noise.sigma_x:.3f}',
                '',
                style='dim',
            )
    console.print(table)
    for mode in result.modes:
        if mode.surfaces is not None:
            shares = ', '.join(
                f'{name} {with_error(getattr(mode.surfaces.noise, name), error)}'
                for name, error in mode.surfaces.errors.items()
            )
            console.print(f'{mode.usecase}: surfaces: {shares}')
        for note in mode.axial.notes:
            console.print(f'{mode.usecase}: {note}', soft_wrap=True)
        for finding in check_assumptions(mode):
            if finding.holds is False:
                console.print(
                    f'{mode.usecase}: assumption does not hold: {finding.assumption}: '
                    f'{finding.evidence}',
                    style='yellow',
                    soft_wrap=True,
                )


def _text(value: float | None, form: str) -> str:
    return '-' if value is None or not math.isfinite(value) else f'{value:{form}}'
