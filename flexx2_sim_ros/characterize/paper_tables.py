"""The paper's four tables of a characterization, with the paper's figures beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.characterize.analysis import Characterization, Divergence, ModeResult
from flexx2_sim_ros.characterize.axial_fit import NAMES
from flexx2_sim_ros.characterize.surface_fit import NAMES as SHARES
from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.modes import flexx2, Mode, NoiseModel, Profile
import numpy as np

DASH = '–'
_MOST_DIGITS = 4  # after the point, of a millimetre or pixel


@dataclass(frozen=True)
class TextRow:
    """A row of a table: its fields, and whether they are the paper's."""

    fields: tuple[str, ...]
    paper: bool = False


@dataclass(frozen=True)
class TextTable:
    """A table of text: title, a note how to read it, names of columns, rows."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[TextRow, ...]


def four_tables(result: Characterization) -> tuple[TextTable, TextTable, TextTable, TextTable]:
    """Return modes, axial noise, its divergence from the model, and lateral noise."""
    return _modes(result), _axial(result), _axial_divergence(result), _lateral(result)


def angle_groups(modes: Sequence[ModeResult]) -> list[float]:
    """Return the angles under which the recordings of several modes are shown, degrees."""
    return sorted({cell.angle_group for mode in modes for cell in mode.cells})


def paper_noise(result: Characterization, usecase: str) -> NoiseModel | None:
    """Return the paper's noise of a mode; None for another camera and for unmeasured modes."""
    paper = flexx2()
    if result.camera.model != paper.model:
        return None
    mode = _known(paper, usecase)
    return mode.noise if mode is not None and mode.measured else None


def _modes(result: Characterization) -> TextTable:
    rows = []
    for mode in result.modes:
        known = _known(result.camera, mode.usecase)
        near, far = _ends([m.distance for m in mode.measurements])
        low, high = _ends([m.angle_deg for m in mode.measurements])
        rates = [m.rate_hz for m in mode.measurements if math.isfinite(m.rate_hz)]
        rows.append(
            TextRow(
                (
                    mode.usecase,
                    ' + '.join(f'{f / 1e6:g}' for f in known.modulation_hz) if known else DASH,
                    f'{known.rate_hz:g}'
                    if known
                    else f'{np.median(rates):.3g}'
                    if rates
                    else DASH,
                    f'{known.range_min:g} to {known.range_max:g}' if known else DASH,
                    str(len(mode.cells)),
                    f'{sum(m.frames for m in mode.measurements):,}',
                    f'{near:.2f} to {far:.2f}',
                    f'{low:.0f} to {high:.0f}',
                )
            )
        )
    return TextTable(
        'Modes',
        '',
        (
            'mode',
            'modulation [MHz]',
            'rate [Hz]',
            'range [m]',
            'recordings',
            'frames',
            'boards at [m]',
            'incidence [°]',
        ),
        tuple(rows),
    )


def _axial(result: Characterization) -> TextTable:
    rows = []
    for mode in result.modes:
        fit = mode.axial
        rows.append(
            TextRow(
                (
                    mode.usecase,
                    *(
                        with_error(
                            _shown(name, fit.coefficients[name]), _shown(name, fit.errors[name])
                        )
                        for name in NAMES
                    ),
                    DASH
                    if fit.interval_n is None
                    else f'{fit.interval_n[0]:.2f} to {fit.interval_n[1]:.2f}',
                    f'{fit.scatter:.1%}',
                )
            )
        )
        noise = paper_noise(result, mode.usecase)
        if noise is not None:
            rows.append(
                TextRow(
                    (
                        'paper',
                        *(f'{_shown(name, getattr(noise, name)):g}' for name in NAMES),
                        '',
                        '',
                    ),
                    True,
                )
            )
    return TextTable(
        'Axial noise',
        'sigma_z = a + b z + c z² + d zⁿ θ² / (π/2 − θ)², metres and radians; θ is the angle '
        "between a pixel's ray and the surface's normal. ± is one standard error, the interval "
        'of n and the bands are 95 %; scatter is the RMS relative deviation of the recordings '
        'from the fit.',
        ('mode', 'a [mm]', 'b [mm/m]', 'c [mm/m²]', 'd [mm/mⁿ]', 'n', '95 % of n', 'scatter'),
        tuple(rows),
    )


def _axial_divergence(result: Characterization) -> TextTable:
    paper = _paper_divergence(result)
    angles = angle_groups(result.modes)
    rows = []
    for mode in result.modes:
        found = [(cell.angle_group, cell.axial) for cell in mode.cells]
        rows.append(
            TextRow(
                (
                    mode.usecase,
                    *(
                        divergence([axial for group, axial in found if group == angle])
                        for angle in angles
                    ),
                    divergence([axial for _, axial in found]),
                )
            )
        )
        reported = paper.get(mode.usecase)
        if reported:
            table = {float(key): value for key, value in reported['axial_kl'].items()}
            rows.append(
                TextRow(
                    (
                        'paper',
                        *(f'{table[angle]:.3f}' if angle in table else '' for angle in angles),
                        '',
                    ),
                    True,
                )
            )
    return TextTable(
        'Divergence of the measured noise from the model [nats]',
        'Kullback-Leibler divergence, mean over pixels. In brackets: without the finite-sample '
        'bias (about 1 / frames).',
        ('mode', *(f'{angle:g}°' for angle in angles), 'all'),
        tuple(rows),
    )


def _paper_divergence(result: Characterization) -> dict[str, Any]:
    if result.camera.model != flexx2().model:
        return {}
    return read_section(config_dir() / 'paper.yaml', 'divergence', dict)


def _lateral(result: Characterization) -> TextTable:
    paper = _paper_divergence(result)
    rows = []
    for mode in result.modes:
        sigmas = [edge.sigma for _, edge in mode.edges]
        found = [cell.lateral for cell in mode.cells if cell.lateral is not None]
        rows.append(
            TextRow(
                (
                    mode.usecase,
                    str(len(sigmas)),
                    with_error(mode.sigma_x, mode.sigma_x_error) if sigmas else 'not measured',
                    f'{np.median(sigmas):.3f}' if sigmas else DASH,
                    f'{min(sigmas):.2f} to {max(sigmas):.2f}' if sigmas else DASH,
                    divergence(found),
                )
            )
        )
        noise = paper_noise(result, mode.usecase)
        if noise is not None:
            kl = paper.get(mode.usecase, {}).get('lateral_kl')
            rows.append(
                TextRow(
                    ('paper', '', f'{noise.sigma_x:g}', '', '', '' if kl is None else f'{kl:g}'),
                    True,
                )
            )
    return TextTable(
        'Lateral noise',
        "sigma_x is the 90th percentile of the edges' standard deviations about their fitted "
        'lines, in pixels. Edges are located to whole pixels; these figures include this '
        'rounding, 0.29 px by itself.',
        ('mode', 'edges', 'sigma_x [px]', 'median', 'smallest to largest', 'divergence [nats]'),
        tuple(rows),
    )


def surfaces_table(result: Characterization) -> TextTable:
    """Return how noise depends on reflectivity; without rows where nobody measured it."""
    rows = [
        TextRow(
            (
                mode.usecase,
                ', '.join(f'{rho:.0%}' for rho in fit.reflectivities),
                *(with_error(getattr(fit.noise, name), fit.errors[name]) for name in SHARES),
                f'{fit.scatter:.1%}',
            )
        )
        for mode in result.modes
        if (fit := mode.surfaces) is not None
    ]
    return TextTable(
        'Noise and reflectivity',
        'sigma_z² of a surface over that of the white board in its place: c + (1 − c) q (s + r q) '
        '/ (s + r), with q the ratio of the reflectivities, s = (1 − r) A, A the amplitude of the '
        'white board in 1/m²; c is what does not depend on light, r the fraction of read noise '
        'at A = 1/m².',
        ('mode', 'boards', 'constant share c', 'read share r', 'scatter'),
        tuple(rows),
    )


def with_error(value: float, error: float | None) -> str:
    """Write a value as exactly as its standard error says that it is known."""
    if error is None or not math.isfinite(error):
        return f'{value:.4g}'
    # The error's first two digits say how many of the value's mean something.
    digits = (
        max(0, min(_MOST_DIGITS, 1 - math.floor(math.log10(error)))) if error > 0 else _MOST_DIGITS
    )
    return f'{value:.{digits}f} ± {error:.{digits}f}'


def divergence(found: Sequence[Divergence]) -> str:
    """Write the mean of divergences, as it is and without its finite-sample bias."""
    if not found:
        return DASH
    raw, debiased = (
        float(np.mean(values)) for values in ([d.raw for d in found], [d.debiased for d in found])
    )
    return f'{raw:.4f} ({debiased:z.4f})'


def _known(camera: Profile, usecase: str) -> Mode | None:
    try:
        return camera.mode(usecase)
    except InputError:
        return None


def _ends(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def _shown(name: str, value: Any) -> Any:
    """Return a coefficient in millimetres."""
    return value if name == 'n' or value is None else 1e3 * value
