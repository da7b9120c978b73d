"""The figures of a characterization, as PNG."""

import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.characterize.amplitude import AmplitudeCounts, sigma_against
from flexx2_sim_ros.characterize.analysis import Cell, Characterization, ModeResult
from flexx2_sim_ros.characterize.histogram import Histogram
from flexx2_sim_ros.characterize.paper_tables import angle_groups, paper_noise
from flexx2_sim_ros.characterize.tiles import join
from flexx2_sim_ros.profiles.modes import NoiseModel
import numpy as np

_CORE = math.radians(2.5)
_GREY = '#555555'
_FEW = 100  # pixels in a bin that are enough for a fraction


def axial_figure(result: Characterization, path: Path) -> None:
    """Draw sigma_z against distance: a panel a mode, a colour an angle, model and band."""
    columns = min(3, len(result.modes))
    rows = math.ceil(len(result.modes) / columns)
    figure = _figure(4.1 * columns + (1.6 if columns == 1 else 0.6), 3.7 * rows + 0.4)
    axes = figure.subplots(rows, columns, squeeze=False)
    angles = angle_groups(result.modes)
    colours = _colours(len(angles))
    for axis, mode in zip(axes.flat, result.modes, strict=False):
        for angle, colour in zip(angles, colours, strict=True):
            _draw_angle(axis, mode, angle, colour)
        axis.set(title=_text(mode.usecase), xlabel='distance [m]', yscale='log')
        _plain_log(axis.yaxis)
        axis.grid(True, which='both', alpha=0.25)
    for axis in axes.flat[len(result.modes) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel('sigma_z [mm]')
    # One legend for all panels, in its own place.
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    labels = [f'{angle:g}°' for angle in angles if f'{angle:g}°' in handles]
    figure.legend(
        [handles[label] for label in labels],
        labels,
        title='incidence',
        loc='outside right center',
        frameon=False,
    )
    figure.savefig(path)


def _draw_angle(axis: Any, mode: ModeResult, angle: float, colour: Any) -> None:
    # Measured points of one mode at one angle, and the model with its band.
    cells = [cell for cell in mode.white if cell.angle_group == angle]
    if not cells:
        return
    distances = [m.distance for m in mode.measurements]
    near, far = min(distances), max(distances)  # No curve beyond what was measured.
    z = np.linspace(near, far, 200)
    theta = np.full_like(z, math.radians(angle))
    curve = mode.axial.model().sigma_z(z, theta)
    half = mode.axial.band(z, theta)
    if len(cells) > 1 or near < far:
        axis.plot(z, 1e3 * curve, color=colour, linewidth=1.3)
        axis.fill_between(
            z,
            1e3 * np.maximum(curve - half, 1e-6),
            1e3 * (curve + half),
            color=colour,
            alpha=0.25,
            linewidth=0,
        )
    points = np.array([_at_axis(cell, mode.axial.model()) for cell in cells])
    axis.plot(
        points[:, 0],
        1e3 * points[:, 1],
        'o',
        color=colour,
        markersize=4.5,
        markeredgecolor='white',
        markeredgewidth=0.5,
        label=f'{angle:g}°',
    )


def _at_axis(cell: Cell, model: NoiseModel) -> tuple[float, float]:
    """Return distance and sigma at the optical axis, under the angle that it is shown for."""
    tiles, theta = cell.measurement.tiles, math.radians(cell.measurement.angle_deg)
    near = np.abs(tiles.theta - theta) < _CORE
    near = near if near.any() else np.ones(len(tiles), bool)
    tiles, z = tiles.take(near), cell.measurement.distance
    there = np.square(model.sigma_z(tiles.z, np.nan_to_num(tiles.theta)))
    ratio = np.average(tiles.variance, weights=tiles.pixels) / np.average(
        there, weights=tiles.pixels
    )
    return z, math.sqrt(ratio) * float(model.sigma_z(z, math.radians(cell.angle_group)))


def histogram_figure(histogram: Histogram, path: Path) -> None:
    """Draw one recording's noise with the model's Gaussian."""
    figure = _figure(7.4, 3.7)
    axis = figure.subplots()
    middle = 0.5e3 * (histogram.edges[1:] + histogram.edges[:-1])
    width = 1e3 * float(np.diff(histogram.edges)[0])
    total = histogram.counts.sum()
    axis.bar(
        middle,
        histogram.counts / total / width,
        width=width,
        color='#9ecae1',
        label=f'measured: {total:,} samples in {len(middle)} bins',
    )
    fine = np.linspace(middle[0], middle[-1], 400)
    sigma = 1e3 * histogram.sigma
    axis.plot(
        fine,
        np.exp(-0.5 * (fine / sigma) ** 2) / sigma / math.sqrt(2 * math.pi),
        color='#b30000',
        linewidth=1.6,
        label=f'model: Gaussian, sigma {sigma:.2f} mm',
    )
    distance, angle = histogram.measurement.label
    axis.set(
        title=f'{_text(histogram.measurement.usecase)}, {distance:g} m, {angle:g}°',
        xlabel='depth minus fitted plane [mm]',
        ylabel='density [1/mm]',
    )
    axis.set_ylim(top=1.28 * axis.get_ylim()[1])
    axis.legend(loc='upper right', frameon=False)
    axis.grid(True, alpha=0.25)
    figure.savefig(path)


def lateral_figure(result: Characterization, path: Path) -> bool:
    """Draw every edge's sigma, by mode; return False when there is none."""
    modes = [mode for mode in result.modes if mode.edges]
    if not modes:
        return False
    figure = _figure(max(6.4, 2.3 * len(modes) + 1.8), 3.9)
    axis = figure.subplots()
    angles = angle_groups(modes)
    colours = dict(zip(angles, _colours(len(angles)), strict=True))
    for place, mode in enumerate(modes):
        _draw_edges(axis, mode, place, colours)
        axis.plot(
            [place - 0.4, place + 0.4],
            [mode.sigma_x] * 2,
            color='black',
            linewidth=1.6,
            label='sigma_x (90th percentile)' if place == 0 else None,
        )
        noise = paper_noise(result, mode.usecase)
        if noise is not None:
            axis.plot(
                [place - 0.4, place + 0.4],
                [noise.sigma_x] * 2,
                '--',
                color='#b30000',
                linewidth=1.2,
                label='paper' if place == 0 else None,
            )
    for angle in angles:
        axis.plot([], [], 'o', color=colours[angle], markersize=4, label=f'{angle:g}°')
    if any(edge.method == 'outline' for mode in modes for _, edge in mode.edges):
        axis.plot(
            [], [], 'o', color=_GREY, mfc='white', markersize=4, label='no return behind the edge'
        )
    axis.set(
        xticks=range(len(modes)),
        xticklabels=[_text(mode.usecase) for mode in modes],
        ylabel='standard deviation of the edge [px]',
        xlim=(-0.55, len(modes) - 0.45),
    )
    axis.set_ylim(bottom=0)
    axis.grid(True, axis='y', alpha=0.25)
    figure.legend(loc='outside right center', frameon=False)
    figure.savefig(path)
    return True


def _draw_edges(axis: Any, mode: ModeResult, place: int, colours: dict[float, Any]) -> None:
    # The sigma of each edge with its error, side by side around the mode's place on the axis.
    pairs = [(cell.angle_group, edge) for cell in mode.cells for edge in cell.measurement.edges]
    spread = np.linspace(-0.28, 0.28, len(pairs)) if len(pairs) > 1 else np.zeros(1)
    for offset, (angle, edge) in zip(spread, pairs, strict=True):
        axis.errorbar(
            place + offset,
            edge.sigma,
            2 * edge.error,
            color=colours[angle],
            fmt='o',
            markersize=3.5,
            elinewidth=0.8,
            mfc=colours[angle] if edge.method == 'gradient' else 'white',
        )


def bias_figure(result: Characterization, path: Path) -> bool:
    """Draw bias against distance, by mode; return False when the truth is not known."""
    modes = [mode for mode in result.modes if any(m.bias_of for m in mode.measurements)]
    if not modes:
        return False
    figure = _figure(8.4, 3.2)
    axis = figure.subplots()
    colours = _colours(len(modes))
    for mode, colour in zip(modes, colours, strict=True):
        points = np.array([(m.distance, 1e3 * m.bias) for m in mode.measurements if m.bias_of])
        axis.plot(
            points[:, 0],
            points[:, 1],
            'o',
            color=colour,
            markersize=4,
            alpha=0.8,
            label=_text(mode.usecase),
        )
    axis.axhline(0, color=_GREY, linewidth=0.8)
    truth = ' / '.join(
        sorted({m.bias_of for mode in modes for m in mode.measurements if m.bias_of})
    )
    axis.set(xlabel='distance [m]', ylabel='bias [mm]', title=f'measured depth minus {truth}')
    axis.grid(True, alpha=0.25)
    axis.margins(y=0.15)
    figure.legend(loc='outside right center', frameon=False)
    figure.savefig(path)
    return True


def amplitude_figure(result: Characterization, path: Path) -> bool:
    """Draw noise and validity against amplitude; return False when there is none."""
    counted: list[tuple[ModeResult, AmplitudeCounts]] = []
    for mode in result.modes:
        parts = [m.amplitude for m in mode.measurements if m.amplitude is not None]
        if parts:
            counted.append((mode, sum(parts[1:], parts[0])))
    if not counted:
        return False
    from flexx2_sim_ros.characterize.amplitude import EDGES

    figure = _figure(9.0, 3.6)
    noise, validity = figure.subplots(1, 2)
    for (mode, counts), colour in zip(counted, _colours(len(counted)), strict=True):
        curve = sigma_against(join([m.tiles for m in mode.measurements]))
        label = _text(mode.usecase)
        if math.isfinite(curve.exponent):
            label += f': proportional to amplitude^{curve.exponent:.2f} above the floor'
        noise.plot(
            curve.amplitude, 1e3 * curve.sigma, 'o-', color=colour, markersize=4, label=label
        )
        enough = counts.pixels >= _FEW
        middle = np.sqrt(EDGES[1:] * EDGES[:-1])[enough]
        validity.plot(
            middle,
            100 * counts.invalid[enough] / counts.pixels[enough],
            'o-',
            color=colour,
            markersize=4,
        )
    noise.set(xscale='log', yscale='log', xlabel='amplitude', ylabel='sigma_z [mm]')
    _plain_log(noise.yaxis)
    validity.set(xscale='log', xlabel='amplitude', ylabel='invalid [%]', ylim=(-3, 103))
    for axis in (noise, validity):
        axis.grid(True, alpha=0.25)
    handles, labels = noise.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', frameon=False)
    figure.savefig(path)
    return True


def _text(name: str) -> str:
    """Return a name as it is: between dollar signs Matplotlib would read formulas."""
    return name.replace('$', r'\$')


def _plain_log(axis: Any) -> None:
    """Write 2, 5, 10, 20 on a logarithmic axis, and more where it is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high > 8 * low else (1, 2, 3, 4, 5, 6, 8)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    axis.set_minor_formatter(NullFormatter())


def _colours(number: int) -> list[Any]:
    from matplotlib import colormaps

    return list(colormaps['viridis'](np.linspace(0.0, 0.85, max(number, 1))))


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=130, layout='constrained')
