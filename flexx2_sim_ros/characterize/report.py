"""The report: one HTML page that needs nothing else, and its figures as PNG."""

import base64
from collections.abc import Callable, Iterable, Sequence
from html import escape
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera.modes import flexx2, Mode
from flexx2_sim_ros.camera.profiles import ProfileFile
from flexx2_sim_ros.characterize import figures
from flexx2_sim_ros.characterize.analysis import Cell, Characterization, Divergence
from flexx2_sim_ros.characterize.assumptions import check_assumptions
from flexx2_sim_ros.characterize.axial import NAMES
from flexx2_sim_ros.characterize.histogram import noise_histogram
from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
import numpy as np

_DASH = '–'
_SHARPNESS = 1.45  # of the figures' pixels a pixel of the page
_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #1c1c1c;
  background: #fff; max-width: 64rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid #ddd; }
p { margin: .4rem 0; } .note { color: #555; font-size: .9rem; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .9rem; }
th, td { padding: .22rem .7rem; text-align: right; white-space: nowrap; }
th { border-bottom: 1.5px solid #444; font-weight: 600; }
td { border-bottom: 1px solid #eee; font-variant-numeric: tabular-nums; }
th:first-child, td:first-child, .text { text-align: left; }
td.text { white-space: normal; } td.yes, td.no, td.unknown { white-space: nowrap; }
img { max-width: 100%; height: auto; }
.paper td { color: #8a3324; } .no { color: #a40000; font-weight: 600; }
.yes { color: #1b6e2d; } .unknown { color: #777; }
details { margin: .6rem 0; } summary { cursor: pointer; color: #234; }
.scroll { overflow-x: auto; } code { font-size: .92em; }
"""


def write_report(result: Characterization, profile: ProfileFile, folder: Path,
                 camera: str | None = None) -> Path:
    """
    Write the page and its figures.

    Parameters
    ----------
    result : Characterization
        The analysis.
    profile : ProfileFile
        Made of it.
    folder : pathlib.Path
        An existing folder; gets ``report.html`` and the figures.
    camera : str, optional
        Which camera of bags that have several.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    InputError
        When a file cannot be written.

    """
    try:
        pictures = _draw(result, folder, camera)
        page = folder / 'report.html'
        page.write_text(_page(result, profile, pictures), encoding='utf-8')
    except OSError as error:
        raise InputError(f'{folder}: the report cannot be written: {error}') from error
    return page


def _draw(result: Characterization, folder: Path, camera: str | None) -> dict[str, str]:
    histogram = noise_histogram(result, camera)
    drawings: dict[str, Callable[[Path], Any]] = {
        'sigma_z': lambda path: figures.axial_figure(result, path),
        'histogram': lambda path: figures.histogram_figure(histogram, path),
        'lateral': lambda path: figures.lateral_figure(result, path),
        'bias': lambda path: figures.bias_figure(result, path),
        'amplitude': lambda path: figures.amplitude_figure(result, path)}
    pictures = {}
    for name, draw in drawings.items():
        path = folder / f'{name}.png'
        path.unlink(missing_ok=True)  # of an earlier run, if this one has none
        if draw(path) is not False:
            pictures[name] = base64.b64encode(path.read_bytes()).decode('ascii')
    return pictures


def _page(result: Characterization, profile: ProfileFile, pictures: dict[str, str]) -> str:
    cells = [cell for mode in result.modes for cell in mode.cells]
    frames = sum(cell.measurement.frames for cell in cells)
    width, height = cells[0].measurement.size
    title = f'{profile.profile.model}: noise of its depth'
    several = f'{len(result.modes)} modes' if len(result.modes) > 1 else 'one mode'
    parts = [
        f'<h1>{escape(title)}</h1>',
        _paragraph(f'{len(cells)} recordings, {frames:,} frames of {width} x {height} pixels, '
                   f'{several}, from the folder {result.folder.resolve().name}. '
                   f'Made {profile.provenance.get("date", "")} by '
                   f'{profile.provenance.get("made_by", "")}.', 'note'),
        *_summary(result),
        *_modes_table(result), *_axial(result, pictures), *_axial_divergence(result),
        *_histogram(pictures), *_lateral(result, pictures), *_assumptions(result),
        *_bias_and_amplitude(pictures), *_details(result), *_left_out(result, profile),
        *_method(result)]
    return ('<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f'<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n'
            + '\n'.join(parts) + '\n</body></html>\n')


def _summary(result: Characterization) -> list[str]:
    lines = []
    for mode in result.modes:
        failed = [f.assumption for f in check_assumptions(mode) if f.holds is False]
        sigma = mode.axial.model()
        z = float(np.clip(1.0, *mode.axial.distances))
        text = (f'{mode.usecase}: sigma_z {1e3 * float(sigma.sigma_z(z, 0.0)):.2f} mm at '
                f'{z:.3g} m')
        if mode.axial.coefficients['d']:
            text += f' ({1e3 * float(sigma.sigma_z(z, math.radians(60))):.2f} mm at 60 degrees)'
        if not math.isnan(mode.sigma_x):
            text += f', edges {mode.sigma_x:.3f} px'
        text += ('. All assumptions that could be checked hold.' if not failed else
                 f'. {len(failed)} assumption{"s do" if len(failed) > 1 else " does"} not hold.')
        lines.append(f'<li>{escape(text)}</li>')
    if any(mode.spatial for mode in result.modes):
        lines.append('<li class="no">Single frames: noise is what one frame leaves of a plane, '
                     'not what changes from frame to frame. Correlated neighbours hide some of '
                     'it, a fixed pattern adds to it.</li>')
    return [f'<ul>{"".join(lines)}</ul>']


def _modes_table(result: Characterization) -> list[str]:
    rows = []
    for mode in result.modes:
        known = _known(mode.usecase)
        near, far = _ends([m.distance for m in mode.measurements])
        low, high = _ends([m.angle_deg for m in mode.measurements])
        rates = [m.rate_hz for m in mode.measurements if math.isfinite(m.rate_hz)]
        rows.append([
            mode.usecase,
            ' + '.join(f'{f / 1e6:g}' for f in known.modulation_hz) if known else _DASH,
            f'{known.rate_hz:g}' if known else f'{np.median(rates):.3g}' if rates else _DASH,
            f'{known.range_min:g} to {known.range_max:g}' if known else _DASH,
            str(len(mode.cells)), f'{sum(m.frames for m in mode.measurements):,}',
            f'{near:.2f} to {far:.2f}', f'{low:.0f} to {high:.0f}'])
    return ['<h2>Modes</h2>', _table(
        ('mode', 'modulation [MHz]', 'rate [Hz]', 'range [m]', 'recordings', 'frames',
         'boards at [m]', 'incidence [°]'), rows)]


def _axial(result: Characterization, pictures: dict[str, str]) -> list[str]:
    rows: list[tuple[str, list[str]]] = []
    for mode in result.modes:
        fit = mode.axial
        rows.append(('', [mode.usecase, *(_with_error(_shown(name, fit.coefficients[name]),
                                                      _shown(name, fit.errors[name]))
                                          for name in NAMES),
                          _DASH if fit.interval_n is None else
                          f'{fit.interval_n[0]:.2f} to {fit.interval_n[1]:.2f}',
                          f'{fit.scatter:.1%}']))
        noise = figures.paper_noise(mode.usecase)
        if noise is not None:
            rows.append(('paper', ['the paper', *(f'{_shown(name, getattr(noise, name)):g}'
                                                  for name in NAMES), '', '']))
    notes = [f'{mode.usecase}: {note}.' for mode in result.modes for note in mode.axial.notes]
    return [
        '<h2>Axial noise</h2>',
        _paragraph('sigma_z = a + b z + c z² + d zⁿ θ² / (π/2 − θ)², metres and radians; θ is '
                   "the angle between a pixel's ray and the surface's normal. ± is one standard "
                   'error, the interval of n and the bands are 95 %; scatter is how far '
                   'recordings deviate from the fit (root mean square).', 'note'),
        _table(('mode', 'a [mm]', 'b [mm/m]', 'c [mm/m²]', 'd [mm/mⁿ]', 'n', 'n is in',
                'scatter'), rows),
        *(_paragraph(note, 'note') for note in notes),
        _image(pictures, 'sigma_z', 'sigma_z against distance, by incidence angle; lines and '
               'bands: the model; points: recordings, at the optical axis')]


def _axial_divergence(result: Characterization) -> list[str]:
    paper = read_section(config_dir() / 'paper.yaml', 'divergence', dict)
    angles = figures.groups(result.modes)
    rows: list[tuple[str, list[str]]] = []
    for mode in result.modes:
        by_angle = [[cell.axial for cell in mode.cells if figures.angle_group(cell) == angle]
                    for angle in angles]
        everything = [cell.axial for cell in mode.cells]
        rows.append(('', [mode.usecase, *(_divergence(found) for found in
                                          [*by_angle, everything])]))
        reported = paper.get(mode.usecase)
        if reported:
            table = {float(key): value for key, value in reported['axial_kl'].items()}
            rows.append(('paper', ['the paper', *(f'{table[angle]:.3f}' if angle in table
                                                  else '' for angle in angles), '']))
    return ['<h3>Divergence of the measured noise from the model [nats]</h3>',
            _paragraph('Mean over pixels of the Kullback-Leibler divergence; in brackets without '
                       'what so many frames give a perfect model (about 1 / frames).', 'note'),
            _table(('mode', *(f'{angle:g}°' for angle in angles), 'all'), rows)]


def _histogram(pictures: dict[str, str]) -> list[str]:
    return [_image(pictures, 'histogram', 'Depth less the fitted plane, all pixels and frames of '
                   'one recording around the optical axis')]


def _lateral(result: Characterization, pictures: dict[str, str]) -> list[str]:
    paper = read_section(config_dir() / 'paper.yaml', 'divergence', dict)
    rows: list[tuple[str, list[str]]] = []
    for mode in result.modes:
        sigmas = [edge.sigma for _, edge in mode.edges]
        found = [cell.lateral for cell in mode.cells if cell.lateral is not None]
        rows.append(('', [
            mode.usecase, str(len(sigmas)),
            _with_error(mode.sigma_x, mode.sigma_x_error) if sigmas else 'not measured',
            f'{np.median(sigmas):.3f}' if sigmas else _DASH,
            f'{min(sigmas):.2f} to {max(sigmas):.2f}' if sigmas else _DASH,
            _divergence(found)]))
        noise = figures.paper_noise(mode.usecase)
        if noise is not None:
            kl = paper.get(mode.usecase, {}).get('lateral_kl')
            rows.append(('paper', ['the paper', '', f'{noise.sigma_x:g}', '', '',
                                   '' if kl is None else f'{kl:g}']))
    parts = ['<h2>Lateral noise</h2>',
             _paragraph("sigma_x: the 90th percentile of all edges' standard deviations about "
                        'their own lines, in pixels. An edge is found to whole pixels: that '
                        'alone is 0.29 px, and it is in these figures.', 'note'),
             _table(('mode', 'edges', 'sigma_x [px]', 'median', 'from, to', 'divergence [nats]'),
                    rows)]
    if 'lateral' in pictures:
        parts.append(_image(pictures, 'lateral', 'Every edge, by distance and angle from left to '
                            'right; bars are two standard errors'))
    return parts


def _assumptions(result: Characterization) -> list[str]:
    words = {True: ('yes', 'holds'), False: ('no', 'does not hold'),
             None: ('unknown', 'cannot be told')}
    parts = ['<h2>What the model assumes</h2>']
    for mode in result.modes:
        rows = []
        for finding in check_assumptions(mode):
            kind, word = words[finding.holds]
            rows.append(f'<tr><td class="text">{escape(finding.assumption)}</td>'
                        f'<td class="text {kind}">{word}</td>'
                        f'<td class="text">{escape(finding.evidence)}</td></tr>')
        parts += [f'<h3>{escape(mode.usecase)}</h3><table><tr><th>assumption</th>'
                  '<th class="text"></th><th class="text">evidence</th></tr>'
                  f'{"".join(rows)}</table>']
    return parts


def _bias_and_amplitude(pictures: dict[str, str]) -> list[str]:
    parts = []
    if 'bias' in pictures:
        parts += ['<h2>Bias</h2>', _image(pictures, 'bias', 'Bias of every recording')]
    if 'amplitude' in pictures:
        parts += ['<h2>Amplitude</h2>', _image(
            pictures, 'amplitude', 'Noise and share of invalid pixels against the amplitude '
            "image, in the camera's units")]
    return parts


def _details(result: Characterization) -> list[str]:
    parts = ['<h2>Every recording</h2>']
    for mode in result.modes:
        rows = [_detail(cell) for cell in mode.cells]
        parts.append(
            f'<details><summary>{escape(mode.usecase)}: {len(rows)} recordings</summary>'
            '<div class="scroll">' + _table(
                ('recording', 'z [m]', 'θ [°]', 'bias [mm]', 'invalid', 'sigma_z [mm]', '/ model',
                 'KL [nats]', 'lag 1', 'right', 'down', 'kurtosis', 'edges [px]', 'KL'), rows)
            + '</div></details>')
    return parts


def _detail(cell: Cell) -> list[str]:
    m = cell.measurement
    return [
        m.path.name, f'{m.distance:.3f}', f'{m.angle_deg:.1f}', _number(1e3 * m.bias, '+.2f'),
        f'{m.pixels.invalid:.2%}', f'{1e3 * cell.sigma:.2f}', f'{cell.sigma / cell.modelled:.3f}',
        f'{cell.axial.raw:.4f} ({cell.axial.debiased:+.4f})',
        *(_number(value, '+.3f') for value in (m.pixels.lag, m.pixels.right, m.pixels.down,
                                               m.pixels.kurtosis)),
        ', '.join(f'{edge.sigma:.2f}' for edge in m.edges) or _DASH,
        _divergence([cell.lateral] if cell.lateral else [])]


def _left_out(result: Characterization, profile: ProfileFile) -> list[str]:
    parts = []
    if result.left_out:
        reasons = ''.join(f'<li>{escape(reason)}</li>' for reason in result.left_out)
        parts += [f'<h2>Left out: {len(result.left_out)}</h2><ul>{reasons}</ul>']
    notes = [*profile.provenance.get('notes', ()),
             *(note for mode in result.modes for m in mode.measurements for note in m.notes)]
    if notes:
        parts += ['<h2>Notes</h2><ul>' + ''.join(f'<li>{escape(str(note))}</li>'
                                                 for note in notes) + '</ul>']
    return parts


def _method(result: Characterization) -> list[str]:
    return ['<h2>How it was measured</h2>', _paragraph(
        'The board is the plane in the middle of the image, found by RANSAC and followed to its '
        'edges; a margin there and incidence beyond 70° are left out. Distance and angle are the '
        "plane's. sigma_z is each pixel's standard deviation over the frames, invalid pixels left "
        'out; a, b, c, d by least squares of relative residuals for every n from -1 to 3 in '
        'steps of 0.1, each recording weighing the same; standard errors by leaving out one '
        'recording after another. Lateral noise: per row the largest step of depth is the edge '
        'pixel; a line is fitted to the edge pixels of a frame; what counts is what is left.',
        'note'), _paragraph(
        'After Cai, Plozza, Marty, Joseph, Magno: "Noise Analysis and Modeling of the PMD Flexx2 '
        'Depth Camera for Robotic Applications", IEEE COINS 2024, '
        'doi 10.1109/COINS61597.2024.10622644.', 'note')]


def _known(usecase: str) -> Mode | None:
    try:
        return flexx2().mode(usecase)
    except InputError:
        return None


def _ends(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def _shown(name: str, value: Any) -> Any:
    """Return a coefficient in millimetres."""
    return value if name == 'n' or value is None else 1e3 * value


def _with_error(value: float, error: float | None) -> str:
    if error is None or not math.isfinite(error):
        return f'{value:.4g}'
    # The error's first two digits say how many of the value's mean something.
    digits = max(0, min(6, 1 - math.floor(math.log10(error)))) if error > 0 else 6
    return f'{value:.{digits}f} ± {error:.{digits}f}'


def _divergence(found: Sequence[Divergence]) -> str:
    if not found:
        return _DASH
    raw, debiased = (float(np.mean(values)) for values in
                     ([d.raw for d in found], [d.debiased for d in found]))
    return f'{raw:.4f} ({round(debiased, 4) + 0.0:.4f})'


def _number(value: float, form: str) -> str:
    return f'{value:{form}}' if math.isfinite(value) else _DASH


def _paragraph(text: str, kind: str) -> str:
    return f'<p class="{kind}">{escape(text)}</p>'


def _table(head: Iterable[str], rows: Iterable[Sequence[str] | tuple[str, list[str]]]) -> str:
    lines = [''.join(f'<th>{escape(name)}</th>' for name in head)]
    kinds = ['']
    for row in rows:
        kind, fields = row if isinstance(row, tuple) and len(row) == 2 else ('', row)
        kinds.append(f' class="{kind}"' if kind else '')
        lines.append(''.join(f'<td>{escape(str(field))}</td>' for field in fields))
    return '<table>' + ''.join(f'<tr{kind}>{line}</tr>' for kind, line in
                               zip(kinds, lines, strict=True)) + '</table>'


def _image(pictures: dict[str, str], name: str, caption: str) -> str:
    # A PNG's width is in its header; a figure is shown as large as its text asks for.
    width = int.from_bytes(base64.b64decode(pictures[name][:32])[16:20], 'big')
    return (f'<figure style="margin:.8rem 0"><img width="{round(width / _SHARPNESS)}" '
            f'alt="{escape(caption)}" src="data:image/png;base64,{pictures[name]}">'
            f'<figcaption class="note">{escape(caption)}</figcaption></figure>')
