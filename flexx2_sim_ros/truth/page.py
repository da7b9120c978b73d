"""The page of a campaign: the pose of each recording, and how well it fits."""

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from flexx2_sim_ros.html_drawing import data_url, depth_picture, picture
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.truth.clean import PARTS
from flexx2_sim_ros.truth.writing import Written
import numpy as np

_STYLE = """
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
th, small, figcaption { color: var(--dim); } figcaption { font-size: .85rem; }
.tag { display: inline-block; padding: 0 .6rem; border-radius: 1rem; color: #fff; }
.used { background: #2e7d4f; } .doubtful { background: #b7791f; } .refused { background: #a8324a; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { max-width: 26.25rem; }
td.words { min-width: 12rem; }
"""
# Colours of `PARTS` on the map; told apart with any colour vision.
_COLOURS = {
    'outside': (120, 120, 120),
    'known': (0, 114, 178),
    'hidden': (230, 159, 0),
    'refused': (204, 121, 167),
}
_SHADES = 50  # of the image under the map
_LIMIT = 0.03  # metres, end of the colour scale of the residual map


_STATES = 'used', 'doubtful', 'refused'
# By the kind of ground truth: what the edges on the first figure are.
_CAPTIONS = {
    'scan': 'measured depth (dark is near), edges of the room in orange',
    'board': 'gray image, outline of the board as it was found in orange',
    'planes': 'measured depth (dark is near), outlines of the known part of planes in orange',
}


def page(table: Mapping[str, Any], written: Mapping[int, Written]) -> str:
    """
    Return the page as HTML, all text escaped and all pictures inside.

    Parameters
    ----------
    table : dict
        The content of ``truth.yaml``.
    written : mapping of int to Written
        The recordings that are not refused, by number.

    """
    rows = table['recordings']
    count = {state: sum(r['verdict'] == state for r in rows) for state in _STATES}
    words = ', '.join(f'{number} {state}' for state, number in count.items() if number)
    caption = _CAPTIONS[table['kind']]
    body = [
        f'<h1>Ground truth of {len(rows)} recordings: {escape(words)}</h1>',
        f'<p>{_about(table)}</p>',
        *([_shared(table)] if 'shared' in table else []),
        _undecided(table['cannot_decide']),
        _recordings(table['kind'], rows),
        *(_figures(rows[i]['name'], one, caption) for i, one in written.items()),
        f'<p><small>{escape(table["command"])}</small></p>',
    ]
    return html_page('Ground truth', _STYLE, '\n'.join(body))


def _about(table: Mapping[str, Any]) -> str:
    if table['kind'] == 'planes':
        return f'Planes: <code>{escape(table["planes"])}</code>.'
    if table['kind'] == 'board':
        size = ' x '.join(f'{value * 1e3:g}' for value in table['board_size_m'])
        return (
            f'Board: <code>{escape(table["board"])}</code>, {size} mm; focal length within '
            f'{table["lens_error"]:.1%} (given).'
        )
    size = ' x '.join(f'{value:g}' for value in table['room_size_m'])
    return (
        f'Room: <code>{escape(table["room"])}</code>, {size} m, accuracy '
        f'{table["room_error_mm"]:g} mm (given).'
    )


def _shared(table: Mapping[str, Any]) -> str:
    lines = []
    for effect, found in table['shared'].items():
        lines.append(
            f'<tr><td>{escape(effect)}</td><td>{escape(str(found["verdict"]))}</td>'
            f'<td class="words">{escape(_sizes(found))}</td>'
            f'<td class="words">{escape(str(found.get("reason", "")))}</td></tr>'
        )
    return (
        '<h2>Errors that the recordings share</h2><p>Fitted together with the poses, so that the '
        'poses do not hide them. They are not part of clean_depth.</p>'
        '<div class="scroll"><table><tr><th>effect</th><th>verdict</th><th>size</th><th></th></tr>'
        f'{"".join(lines)}</table></div>'
    )


def _undecided(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = ''.join(
        f'<tr><td>{escape(row["effect"])}</td><td class="words">{escape(row["reason"])}</td></tr>'
        for row in rows
    )
    return (
        '<h2>What this ground truth cannot decide</h2><div class="scroll"><table>'
        f'{lines}</table></div>'
    )


def _sizes(found: Mapping[str, Any]) -> str:
    if 'waves' in found:
        return '; '.join(
            f'{wave["amplitude"] * 1e3:.1f} mm every {wave["period"]:.3f} m'
            for wave in found['waves']
        )
    if 'lens' in found:
        return '; '.join(
            f'{name} {part["value"]:+.4f}, standard deviation {part["standard_deviation"]:.4f}'
            for name, part in found['lens'].items()
        )
    if 'standard_deviation' not in found:
        return ''
    deviation = found['standard_deviation']
    if 'fraction' in found:
        return f'{found["fraction"]:+.2%}, standard deviation {deviation:.2%}'
    if 'metres' in found:
        return f'{found["metres"] * 1e3:+.2f} mm, standard deviation {deviation * 1e3:.2f} mm'
    return f'gain {found["gain"]:.2f}, standard deviation {deviation:.2f}'


# The columns of the table of recordings: the head, and the cell of a row as HTML.
_POSED: dict[str, Callable[[Mapping[str, Any]], str]] = {
    'camera': lambda row: row['motion'],
    'pixels that fit': lambda row: f'{row["fitting"]:.0%}',
    'pose, standard deviation': lambda row: (
        f'{row["pose_sigma_mm"]:.2f} mm, {row["pose_sigma_deg"]:.3f} deg' if 'pose' in row else ''
    ),
    'median residual': lambda row: _residual(row) if 'pose' in row else '',
    'known': lambda row: _known(row),
}
_PLANES: dict[str, Callable[[Mapping[str, Any]], str]] = {
    'known': lambda row: _known(row),
    'planes: distance, and how much farther the recording shows them': lambda row: '<br>'.join(
        map(_plane, row.get('planes', ()))
    ),
}


def _recordings(kind: str, rows: Sequence[Mapping[str, Any]]) -> str:
    columns = _PLANES if kind == 'planes' else _POSED
    heads = ''.join(f'<th>{one}</th>' for one in ('file', 'verdict', *columns, ''))
    lines = []
    for row in rows:
        own = ''.join(f'<td>{cell(row)}</td>' for cell in columns.values())
        lines.append(
            f'<tr><td>{escape(row["name"])}</td><td><span class="tag {row["verdict"]}">'
            f'{row["verdict"]}</span></td>{own}'
            f'<td class="words"><small>{escape("; ".join(row["reasons"]))}</small></td></tr>'
        )
    return (
        f'<h2>Recordings</h2><div class="scroll"><table><tr>{heads}</tr>{"".join(lines)}</table>'
        '</div>'
    )


def _known(row: Mapping[str, Any]) -> str:
    # What fraction of the pixels is known, and why others are not.
    if 'known' not in row:
        return ''
    why = ', '.join(f'{name} {part:.0%}' for name, part in row['unknown'].items() if part)
    return f'{row["known"]:.0%}' + (f' <small>({why})</small>' if why else '')


def _residual(row: Mapping[str, Any]) -> str:
    return 'no depth' if row['residual_mm'] is None else f'{row["residual_mm"]:.1f} mm'


def _plane(row: Mapping[str, Any]) -> str:
    off = row['residual_mm']
    measured = (
        'not measured' if off is None else f'&plusmn; {row["sigma_mm"]:.1f} mm, {off:+.1f} mm'
    )
    return f'{escape(row["name"])}: {row["distance_m"]:.3f} m, {measured}'


def _figures(name: str, shown: Written, caption: str) -> str:
    name = escape(name)
    return (
        f'<h2>{name}</h2><div class="row">'
        f'<figure><img alt="edges of {name}" width="420" src="{_overlay(shown)}"><figcaption>'
        f'{escape(caption)}</figcaption></figure>'
        f'<figure><img alt="residual of {name}" width="420" '
        f'src="{picture(shown.residual, _LIMIT)}"><figcaption>measured minus clean depth, blue '
        f'{-_LIMIT * 1e3:.0f} to red {_LIMIT * 1e3:+.0f} mm, gray unknown or invalid</figcaption>'
        f'</figure><figure><img alt="map of {name}" width="420" src="{_map(shown)}"><figcaption>'
        f'{_legend(shown)}</figcaption></figure></div>'
    )


def _legend(shown: Written) -> str:
    return ', '.join(
        f'<span style="color:rgb{_COLOURS[name]}">&#9632;</span> {name} {part:.0%}'
        for name, part in shown.shares.items()
    )


def _map(shown: Written) -> str:
    # Which pixels are known, and why others are not, over the image.
    colours = np.array([_COLOURS[name] for name in PARTS])[:, None]
    shades = np.linspace(30, 230, _SHADES)[:, None]
    level = np.rint(_brightness(shown.image) * (_SHADES - 1))
    index = (shown.part * _SHADES + level).repeat(2, axis=0).repeat(2, axis=1)
    return data_url(index, (0.6 * colours + 0.4 * shades).reshape(-1, 3))


def _overlay(shown: Written) -> str:
    # With the edges of clean depth on it.
    image = _brightness(shown.image).repeat(4, axis=0).repeat(4, axis=1)
    # Thin lines: an edge is drawn on one of the four rows and columns that a pixel has.
    lines = shown.edges.repeat(4, axis=0).repeat(4, axis=1)
    inner = lines.copy()
    inner[1:-1, 1:-1] = lines[:-2, 1:-1] & lines[2:, 1:-1] & lines[1:-1, :-2] & lines[1:-1, 2:]
    return depth_picture(image, 0.0, 1.0, [lines & ~inner])


def _brightness(values: np.ndarray) -> np.ndarray:
    # 0 for low values, 1 for high ones and where there are none.
    good = np.isfinite(values)
    low, high = np.percentile(values[good], [2, 98]) if good.any() else (0.0, 1.0)
    return np.where(good, np.clip((values - low) / max(high - low, 1e-6), 0, 1), 1.0)
