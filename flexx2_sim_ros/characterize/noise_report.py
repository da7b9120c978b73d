"""The report: one HTML page that needs nothing else, and its figures as PNG."""

import base64
from collections.abc import Callable, Iterable
from html import escape
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import named, whole_files
from flexx2_sim_ros.characterize import figures
from flexx2_sim_ros.characterize.analysis import Cell, Characterization
from flexx2_sim_ros.characterize.assumptions import check_assumptions
from flexx2_sim_ros.characterize.histogram import noise_histogram
from flexx2_sim_ros.characterize.paper_tables import (
    DASH,
    divergence,
    four_tables,
    surfaces_table,
    TextRow,
    TextTable,
)
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.profiles.files import ProfileFile
import numpy as np

_PAGE = 'report.html'
_FIGURES = ('sigma_z', 'histogram', 'tables', 'lateral', 'bias', 'amplitude')
_SHARPNESS = 1.45  # pixels of a figure for each pixel of the page
_STYLE = """
.note { color: var(--dim); font-size: .9rem; }
th, td { padding: .22rem .55rem; text-align: right; white-space: nowrap; }
th { border-bottom: 1.5px solid var(--dim); }
td { border-bottom: 1px solid var(--line); }
th:first-child, td:first-child, .text { text-align: left; }
td.text { white-space: normal; } td.yes, td.no, td.unknown { white-space: nowrap; }
.paper td { color: var(--orange); } .no { color: var(--red); font-weight: 600; }
.yes { color: var(--green); } .unknown { color: var(--dim); }
details { margin: .6rem 0; } summary { cursor: pointer; } figure { margin: .8rem 0; }
"""


def write_report(
    result: Characterization, profile: ProfileFile, folder: Path, camera: str | None = None
) -> Path:
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
        'tables': lambda path: figures.tables_figure(four_tables(result), path),
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
        f'<h1>{escape(title)}</h1>',
        _paragraph(
            f'{len(cells)} recordings, {frames:,} frames of {size}, '
            f'{several}, from the folder {result.folder.resolve().name}. '
            f'Made {profile.provenance.get("date", "")} by '
            f'{profile.provenance.get("made_by", "")}.',
            'note',
        ),
        *_summary(result),
        *_section(modes),
        *_axial(axial, result, pictures),
        *_section(axial_divergence, 'h3'),
        *_surfaces(result),
        *_histogram(result, pictures),
        *_lateral(lateral, pictures),
        *_assumptions(result),
        *_bias_and_amplitude(pictures),
        *_details(result),
        *_left_out(result, profile),
        *_method(result),
    ]
    return html_page(title, _STYLE, '\n'.join(parts))


def _summary(result: Characterization) -> list[str]:
    lines = []
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
        lines.append(f'<li>{escape(text)}</li>')
    if any(mode.spatial for mode in result.modes):
        lines.append(
            '<li class="no">Single frames: the noise is the deviation of each frame from fitted '
            'planes, not the change from frame to frame. Correlation between neighbours '
            'lowers this estimate, and fixed-pattern noise raises it.</li>'
        )
    if result.left_out:
        lines.append(
            f'<li class="no">{len(result.left_out)} recordings were left out; the '
            'reasons are at the end.</li>'
        )
    return [f'<ul>{"".join(lines)}</ul>']


def _axial(table: TextTable, result: Characterization, pictures: dict[str, str]) -> list[str]:
    notes = [f'{mode.usecase}: {note}.' for mode in result.modes for note in mode.axial.notes]
    return [
        *_section(table),
        *(_paragraph(note, 'note') for note in notes),
        _image(
            pictures,
            'sigma_z',
            'sigma_z against distance, by incidence angle. Lines and bands: the fitted model and '
            'its 95 % band. Points: the recordings, at the optical axis',
        ),
    ]


def _surfaces(result: Characterization) -> list[str]:
    table = surfaces_table(result)
    if table.rows:
        return _section(table)
    return [
        _paragraph(
            'Assumed: one white board. How noise depends on reflectivity was not measured; it '
            'needs boards of three reflectivities.',
            'note',
        )
    ]


def _histogram(result: Characterization, pictures: dict[str, str]) -> list[str]:
    caption = (
        'Depth minus the fitted plane: all pixels around the optical axis and all frames of one '
        'recording'
    )
    if any(mode.spatial for mode in result.modes):
        caption += '. It includes deviations of the image from a plane, which the model leaves out'
    return [_image(pictures, 'histogram', caption)]


def _lateral(table: TextTable, pictures: dict[str, str]) -> list[str]:
    parts = _section(table)
    if 'lateral' in pictures:
        parts.append(
            _image(
                pictures,
                'lateral',
                'Each edge, in order of distance and angle from left to '
                'right. Bars: two standard errors',
            )
        )
    return parts


def _assumptions(result: Characterization) -> list[str]:
    words = {
        True: ('yes', 'holds'),
        False: ('no', 'does not hold'),
        None: ('unknown', 'cannot be checked'),
    }
    parts = ['<h2>Assumptions of the model</h2>']
    for mode in result.modes:
        rows = []
        for finding in check_assumptions(mode):
            kind, word = words[finding.holds]
            rows.append(
                f'<tr><td class="text">{escape(finding.assumption)}</td>'
                f'<td class="text {kind}">{word}</td>'
                f'<td class="text">{escape(finding.evidence)}</td></tr>'
            )
        parts += [
            f'<h3>{escape(mode.usecase)}</h3><div class="scroll"><table><tr><th>assumption</th>'
            '<th class="text"></th><th class="text">evidence</th></tr>'
            f'{"".join(rows)}</table></div>'
        ]
    return parts


def _bias_and_amplitude(pictures: dict[str, str]) -> list[str]:
    parts = []
    if 'bias' in pictures:
        parts += ['<h2>Bias</h2>', _image(pictures, 'bias', 'Bias of each recording')]
    if 'amplitude' in pictures:
        parts += [
            '<h2>Amplitude</h2>',
            _image(
                pictures,
                'amplitude',
                'Noise and fraction of invalid pixels against the amplitude '
                "image, in the camera's units",
            ),
        ]
    return parts


def _details(result: Characterization) -> list[str]:
    parts = ['<h2>All recordings</h2>']
    for mode in result.modes:
        rows = [_detail(cell) for cell in mode.cells]
        parts.append(
            f'<details><summary>{escape(mode.usecase)}: {len(rows)} recordings</summary>'
            + _table(
                (
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
                ),
                rows,
            )
            + '</details>'
        )
    return parts


def _detail(cell: Cell) -> TextRow:
    m = cell.measurement
    return TextRow(
        (
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
    )


def _left_out(result: Characterization, profile: ProfileFile) -> list[str]:
    parts = []
    if result.left_out:
        reasons = ''.join(f'<li>{escape(reason)}</li>' for reason in result.left_out)
        parts += [f'<h2>Left out: {len(result.left_out)}</h2><ul>{reasons}</ul>']
    notes = [
        *profile.provenance.get('notes', ()),
        *(note for mode in result.modes for m in mode.measurements for note in m.notes),
    ]
    if notes:
        parts += [
            '<h2>Notes</h2><ul>'
            + ''.join(f'<li>{escape(str(note))}</li>' for note in notes)
            + '</ul>'
        ]
    return parts


def _method(result: Characterization) -> list[str]:
    return [
        '<h2>How it was measured</h2>',
        _paragraph(
            'The board is the plane in the middle of the image. RANSAC finds it, and it is '
            'extended to its edges; a margin at the edges and incidence beyond 70° are left out. '
            'Distance and angle are those of the plane. sigma_z is the standard deviation of each '
            'pixel over the frames, without invalid pixels. a, b, c and d are fitted by least '
            'squares of relative residuals for each n from -1 to 3 in steps of 0.1; all '
            'recordings have the same weight. Standard errors are a jackknife over recordings. '
            'Lateral noise: in each row, the edge pixel is the largest step in depth. A line is '
            'fitted to the edge pixels of each frame, and the residuals give sigma_x.',
            'note',
        ),
        _paragraph(
            'After Cai, Plozza, Marty, Joseph, Magno: "Noise Analysis and Modeling of the PMD '
            'Flexx2 Depth Camera for Robotic Applications", IEEE COINS 2024, '
            'doi 10.1109/COINS61597.2024.10622644.',
            'note',
        ),
    ]


def _number(value: float, form: str) -> str:
    return f'{value:{form}}' if math.isfinite(value) else DASH


def _paragraph(text: str, kind: str) -> str:
    return f'<p class="{kind}">{escape(text)}</p>'


def _section(table: TextTable, level: str = 'h2') -> list[str]:
    note = [_paragraph(table.note, 'note')] if table.note else []
    return [f'<{level}>{escape(table.title)}</{level}>', *note, _table(table.head, table.rows)]


def _table(head: Iterable[str], rows: Iterable[TextRow]) -> str:
    lines = ['<tr>' + ''.join(f'<th>{escape(name)}</th>' for name in head) + '</tr>']
    for row in rows:
        kind = ' class="paper"' if row.paper else ''
        fields = ''.join(f'<td>{escape(field)}</td>' for field in row.fields)
        lines.append(f'<tr{kind}>{fields}</tr>')
    return f'<div class="scroll"><table>{"".join(lines)}</table></div>'


def _image(pictures: dict[str, str], name: str, caption: str) -> str:
    # A PNG's width is in its header; a figure is shown as large as its text asks for.
    width = int.from_bytes(base64.b64decode(pictures[name][:32])[16:20], 'big')
    return (
        f'<figure><img width="{round(width / _SHARPNESS)}" '
        f'alt="{escape(caption)}" src="data:image/png;base64,{pictures[name]}">'
        f'<figcaption class="note">{escape(caption)}</figcaption></figure>'
    )
