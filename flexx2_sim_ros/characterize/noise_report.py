"""The report: one HTML page that needs nothing else, and its figures as PNG."""

import base64
from collections.abc import Callable, Iterator
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.atomic import named, whole_files
from flexx2_sim_ros.characterize import figures
from flexx2_sim_ros.characterize.analysis import Cell, Characterization, ModeResult
from flexx2_sim_ros.characterize.assumptions import check_assumptions
from flexx2_sim_ros.characterize.histogram import noise_histogram
from flexx2_sim_ros.characterize.paper_tables import (
    DASH,
    divergence,
    four_tables,
    surfaces_table,
    TextTable,
)
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.profiles.files import ProfileFile
import numpy as np

_PAGE = 'report.html'
_FIGURES = ('sigma_z', 'histogram', 'lateral', 'bias', 'amplitude')
_SHARPNESS = 1.45  # pixels of a figure for each pixel of the page
_STYLE = """
.numbers th, .numbers td { padding: .22rem .55rem; text-align: right; white-space: nowrap; }
.numbers th { border-bottom: 1.5px solid var(--dim); }
.numbers td { border-bottom: 1px solid var(--line); }
.numbers th:first-child, .numbers td:first-child { text-align: left; }
.paper td { color: var(--orange); } .checks td:nth-child(2) { white-space: nowrap; }
figure { margin: .8rem 0; }
"""
# What is said of an assumption that holds, that does not, and that cannot be checked.
_HOLDS = {
    True: ('holds', 'good'),
    False: ('does not hold', 'bad'),
    None: ('cannot be checked', 'dim'),
}
_METHOD = (
    'The board is the plane in the middle of the image. RANSAC finds it, and it is extended '
    'to its edges; a margin at the edges and incidence beyond 70° are left out. Distance and '
    'angle are those of the plane. sigma_z is the standard deviation of each pixel over the '
    'frames, without invalid pixels. a, b, c and d are fitted by least squares of relative '
    'residuals for each n from -1 to 3 in steps of 0.1; all recordings have the same weight. '
    'Standard errors are a jackknife over recordings. Lateral noise: in each row, the edge '
    'pixel is the largest step in depth. A line is fitted to the edge pixels of each frame, '
    'and the residuals give sigma_x.',
    'After Cai, Plozza, Marty, Joseph, Magno: "Noise Analysis and Modeling of the PMD Flexx2 '
    'Depth Camera for Robotic Applications", IEEE COINS 2024, doi '
    '10.1109/COINS61597.2024.10622644.',
)


def write_report(
    result: Characterization, profile: ProfileFile, folder: Path, camera: str | None = None
) -> Path:
    """
    Write the page, ``report.html``, and its figures to an existing folder; return the page.

    ``profile`` was made of `result`; ``camera`` is which one of bags that have several. Raises
    InputError when a file cannot be written.
    """
    # Pictures of an earlier run are removed; without its page, files are somebody else's.
    earlier = (folder / _PAGE).exists()
    with whole_files(folder) as part:
        pictures = _draw(result, part, camera)
        (part / _PAGE).write_text(
            _page(result, profile, pictures), encoding='utf-8', errors='backslashreplace'
        )
    with named(folder):
        for name in set(_FIGURES) - set(pictures) if earlier else ():
            (folder / f'{name}.png').unlink(missing_ok=True)
    return folder / _PAGE


def _draw(result: Characterization, folder: Path, camera: str | None) -> dict[str, str]:
    histogram = noise_histogram(result, camera)
    drawings: dict[str, Callable[[Path], Any]] = {
        'sigma_z': lambda path: figures.axial_figure(result, path),
        'histogram': lambda path: figures.histogram_figure(histogram, path),
        'lateral': lambda path: figures.lateral_figure(result, path),
        'bias': lambda path: figures.bias_figure(result, path),
        'amplitude': lambda path: figures.amplitude_figure(result, path),
    }
    pictures = {}
    for name, draw in drawings.items():
        path = folder / f'{name}.png'
        if draw(path) is not False:
            pictures[name] = base64.b64encode(path.read_bytes()).decode('ascii')
    return pictures


def _page(result: Characterization, profile: ProfileFile, pictures: dict[str, str]) -> str:
    cells = [cell for mode in result.modes for cell in mode.cells]
    frames = sum(cell.measurement.frames for cell in cells)
    view = profile.profile.intrinsics
    size = f'{"crops of " if result.cropped else ""}{view.width} x {view.height} pixels'
    modes, axial, axial_divergence, lateral = four_tables(result)
    title = f'{profile.profile.model}: depth noise'
    several = f'{len(result.modes)} modes' if len(result.modes) > 1 else 'one mode'
    parts = [
        html.heading(title, 1),
        html.note(
            f'{len(cells)} recordings, {frames:,} frames of {size}, '
            f'{several}, from the folder {result.folder.resolve().name}. '
            f'Made {profile.provenance.get("date", "")} by '
            f'{profile.provenance.get("made_by", "")}.'
        ),
        html.bullets(_summary(result)),
        _section(modes),
        _section(axial),
        *(
            html.note(f'{mode.usecase}: {note}.')
            for mode in result.modes
            for note in mode.axial.notes
        ),
        _image(
            pictures,
            'sigma_z',
            'sigma_z against distance, by incidence angle. Lines and bands: the fitted model and '
            'its 95 % band. Points: the recordings, at the optical axis',
        ),
        _section(axial_divergence, 3),
        _surfaces(result),
        _histogram(result, pictures),
        _section(lateral),
        _image(
            pictures,
            'lateral',
            'Each edge, in order of distance and angle from left to right. Bars: two standard '
            'errors',
        ),
        html.heading('Assumptions of the model'),
        *map(_assumptions, result.modes),
        _image(pictures, 'bias', 'Bias of each recording', 'Bias'),
        _image(
            pictures,
            'amplitude',
            "Noise and fraction of invalid pixels against the amplitude image, in the camera's "
            'units',
            'Amplitude',
        ),
        html.heading('All recordings'),
        *map(_details, result.modes),
        *_left_out(result, profile),
        html.heading('How it was measured'),
        *map(html.note, _METHOD),
    ]
    return html_page(title, _STYLE, '\n'.join(parts))


def _summary(result: Characterization) -> Iterator[str]:
    for mode in result.modes:
        failed = [f.assumption for f in check_assumptions(mode) if f.holds is False]
        sigma = mode.axial.model()
        z = float(np.clip(1.0, *mode.axial.distances))
        text = f'{mode.usecase}: sigma_z {1e3 * float(sigma.sigma_z(z, 0.0)):.2f} mm at {z:.3g} m'
        if mode.axial.coefficients['d']:
            text += f' ({1e3 * float(sigma.sigma_z(z, math.radians(60))):.2f} mm at 60 degrees)'
        if not math.isnan(mode.sigma_x):
            text += f', edges {mode.sigma_x:.3f} px'
        text += (
            '. All assumptions that could be checked hold.'
            if not failed
            else f'. {len(failed)} assumption{"s do" if len(failed) > 1 else " does"} not hold.'
        )
        yield text
    if any(mode.spatial for mode in result.modes):
        yield _warning(
            'Single frames: the noise is the deviation of each frame from fitted planes, not the '
            'change from frame to frame. Correlation between neighbours lowers this estimate, and '
            'fixed-pattern noise raises it.'
        )
    if result.left_out:
        yield _warning(
            f'{len(result.left_out)} recordings were left out; the reasons are at the end.'
        )


def _warning(text: str) -> html.Html:
    return html.element('strong', text, kind='bad')


def _surfaces(result: Characterization) -> html.Html:
    table = surfaces_table(result)
    if table.rows:
        return _section(table)
    return html.note(
        'Assumed: one white board. How noise depends on reflectivity was not measured; it needs '
        'boards of three reflectivities.'
    )


def _histogram(result: Characterization, pictures: dict[str, str]) -> html.Html:
    caption = (
        'Depth minus the fitted plane: all pixels around the optical axis and all frames of one '
        'recording'
    )
    if any(mode.spatial for mode in result.modes):
        caption += '. It includes deviations of the image from a plane, which the model leaves out'
    return _image(pictures, 'histogram', caption)


def _assumptions(mode: ModeResult) -> html.Html:
    rows = []
    for finding in check_assumptions(mode):
        word, kind = _HOLDS[finding.holds]
        rows.append([finding.assumption, html.element('span', word, kind=kind), finding.evidence])
    return html.join(
        html.heading(mode.usecase, 3), html.table(['assumption', '', 'evidence'], rows, 'checks')
    )


def _details(mode: ModeResult) -> html.Html:
    heads = (
        'recording',
        'z [m]',
        'θ [°]',
        'bias [mm]',
        'invalid',
        'sigma_z [mm]',
        'measured / model',
        'KL [nats]',
        'lag-1 corr.',
        'corr. right',
        'corr. down',
        'kurtosis',
        'edges [px]',
        'KL',
    )
    rows = [_detail(cell) for cell in mode.cells]
    summary = f'{mode.usecase}: {len(rows)} recordings'
    return html.folded(summary, html.table(heads, rows, 'numbers'))


def _detail(cell: Cell) -> tuple[str, ...]:
    m = cell.measurement
    return (
        m.path.name,
        f'{m.distance:.3f}',
        f'{m.angle_deg:.1f}',
        _number(1e3 * m.bias, '+z.2f'),
        f'{m.pixels.invalid:.2%}',
        f'{1e3 * cell.sigma:.2f}',
        _number(cell.sigma / cell.modelled if cell.modelled else math.nan, 'z.3f'),
        f'{cell.axial.raw:.4f} ({cell.axial.debiased:+z.4f})',
        *(
            _number(value, '+z.3f')
            for value in (m.pixels.lag, m.pixels.right, m.pixels.down, m.pixels.kurtosis)
        ),
        ', '.join(f'{edge.sigma:.2f}' for edge in m.edges) or DASH,
        divergence([cell.lateral] if cell.lateral else []),
    )


def _left_out(result: Characterization, profile: ProfileFile) -> Iterator[html.Html]:
    if result.left_out:
        yield html.heading(f'Left out: {len(result.left_out)}')
        yield html.bullets(result.left_out)
    notes = [
        *map(str, profile.provenance.get('notes', ())),
        *(note for mode in result.modes for m in mode.measurements for note in m.notes),
    ]
    if notes:
        yield html.heading('Notes')
        yield html.bullets(notes)


def _number(value: float, form: str) -> str:
    return f'{value:{form}}' if math.isfinite(value) else DASH


def _section(table: TextTable, level: int = 2) -> html.Html:
    return html.join(
        html.heading(table.title, level),
        html.note(table.note) if table.note else '',
        html.table(
            table.head,
            [html.row(row.fields, 'paper' if row.paper else '') for row in table.rows],
            'numbers',
        ),
    )


def _image(pictures: dict[str, str], name: str, caption: str, title: str = '') -> html.Html:
    # Nothing without the picture. Its width is in its header; it is shown as large as its text
    # asks for.
    if name not in pictures:
        return html.Html()
    width = int.from_bytes(base64.b64decode(pictures[name][:32])[16:20], 'big')
    shown = html.figure(
        f'data:image/png;base64,{pictures[name]}', caption, width=round(width / _SHARPNESS)
    )
    return html.join(html.heading(title) if title else '', shown)
