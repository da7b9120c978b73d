"""The page of a campaign: the pose of each recording, and how well it fits."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

from flexx2_sim_ros.html_drawing import picture
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.truth.clean import PARTS
from flexx2_sim_ros.truth.writing import PageImages
from matplotlib.image import imsave
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
_LIMIT = 0.03  # metres, end of the colour scale of the residual map


def page(table: dict[str, Any], pictures: Mapping[int, PageImages]) -> str:
    """
    Return the page as HTML, all text escaped and all pictures inside.

    Parameters
    ----------
    table : dict
        The content of ``truth.yaml``.
    pictures : mapping of int to PageImages
        Images of the recordings that are not refused, by number.

    """
    rows = table['recordings']
    about = (
        f'Room: <code>{escape(table["room"])}</code>, '
        f'{" x ".join(f"{value:g}" for value in table["room_size_m"])} m, accuracy '
        f'{table["room_error_mm"]:g} mm (given).'
    )
    body = [_shared(table), undecided(table['cannot_decide']), recordings_table(rows)]
    for i, row in enumerate(rows):
        if i in pictures:
            caption = 'measured depth (dark is near), edges of the room in orange'
            body.append(figures(row['name'], pictures[i], caption))
    return whole_page(table, about, body)


def whole_page(table: Mapping[str, Any], about: str, parts: Sequence[str]) -> str:
    """
    Return the page of a campaign with its parts.

    Parameters
    ----------
    table : dict
        The content of ``truth.yaml``.
    about : str
        The source of the ground truth, as HTML.
    parts : sequence of str
        HTML.

    """
    rows = table['recordings']
    count = {state: sum(r['verdict'] == state for r in rows) for state in _STATES}
    words = ', '.join(f'{number} {state}' for state, number in count.items() if number)
    body = [
        f'<h1>Ground truth of {len(rows)} recordings: {escape(words)}</h1>',
        f'<p>{about}</p>',
        *parts,
        f'<p><small>{escape(table["command"])}</small></p>',
    ]
    return html_page('Ground truth', _STYLE, '\n'.join(body))


_STATES = 'used', 'doubtful', 'refused'


def _shared(table: dict[str, Any]) -> str:
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


def undecided(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of the effects that the ground truth cannot decide."""
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


def recordings_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of the rows of ``truth.yaml``."""
    lines = []
    for row in rows:
        sizes = ''
        if 'pose' in row:
            sizes = (
                f'<td>{row["pose_sigma_mm"]:.2f} mm, {row["pose_sigma_deg"]:.3f} deg</td>'
                f'<td>{_millimetres(row["residual_mm"])}</td><td>{known_share(row)}</td>'
            )
        lines.append(
            f'<td>{row["motion"]}</td><td>{row["fitting"]:.0%}</td>'
            f'{sizes or "<td></td><td></td><td></td>"}'
        )
    heads = 'camera', 'pixels that fit', 'pose, standard deviation', 'median residual', 'known'
    return with_verdicts(rows, heads, lines)


def with_verdicts(
    rows: Sequence[Mapping[str, Any]], heads: Sequence[str], cells: Sequence[str]
) -> str:
    """Return a table of recordings, their verdicts and reasons, and cells of HTML between them."""
    lines = [
        f'<tr><td>{escape(row["name"])}</td><td><span class="tag {row["verdict"]}">'
        f'{row["verdict"]}</span></td>{own}'
        f'<td class="words"><small>{escape("; ".join(row["reasons"]))}</small></td></tr>'
        for row, own in zip(rows, cells, strict=True)
    ]
    return (
        '<h2>Recordings</h2><div class="scroll"><table><tr>'
        f'{"".join(f"<th>{one}</th>" for one in ("file", "verdict", *heads, ""))}</tr>'
        f'{"".join(lines)}</table></div>'
    )


def known_share(row: Mapping[str, Any]) -> str:
    """Return what fraction of the pixels is known, and why others are not, as HTML."""
    why = ', '.join(f'{name} {part:.0%}' for name, part in row['unknown'].items() if part)
    return f'{row["known"]:.0%}' + (f' <small>({why})</small>' if why else '')


def _millimetres(value: float | None) -> str:
    return 'no depth' if value is None else f'{value:.1f} mm'


def figures(name: str, shown: PageImages, caption: str) -> str:
    """
    Return the figures of one recording.

    Parameters
    ----------
    name : str
        Name of the recording.
    shown : PageImages
        The images of the recording.
    caption : str
        Caption of the overlay.

    """
    name = escape(name)
    return (
        f'<h2>{name}</h2><div class="row">'
        f'<figure><img alt="edges of {name}" width="420" src="{overlay(shown)}"><figcaption>'
        f'{escape(caption)}</figcaption></figure>'
        f'<figure><img alt="residual of {name}" width="420" '
        f'src="{picture(shown.residual, _LIMIT)}"><figcaption>measured minus clean depth, blue '
        f'{-_LIMIT * 1e3:.0f} to red {_LIMIT * 1e3:+.0f} mm, gray unknown or invalid</figcaption>'
        f'</figure><figure><img alt="map of {name}" width="420" src="{_map(shown)}"><figcaption>'
        f'{_legend(shown)}</figcaption></figure></div>'
    )


def _legend(shown: PageImages) -> str:
    return ', '.join(
        f'<span style="color:rgb{_COLOURS[name]}">&#9632;</span> {name} {part:.0%}'
        for name, part in shown.shares.items()
    )


def _map(shown: PageImages) -> str:
    # Which pixels are known, and why others are not, over the image.
    colours = np.array([_COLOURS[name] for name in PARTS], float)[shown.part]
    image = 0.6 * colours + 0.4 * _gray(shown.image)[..., None]
    return _data_url(image.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1))


def overlay(shown: PageImages) -> str:
    """Return an image with the edges of clean depth on it, as a data URL."""
    image = np.repeat(_gray(shown.image)[..., None], 3, axis=2)
    image = image.astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    # Thin lines: an edge is drawn on one of the four rows and columns that a pixel has.
    lines = shown.edges.repeat(4, axis=0).repeat(4, axis=1)
    inner = lines.copy()
    inner[1:-1, 1:-1] = lines[:-2, 1:-1] & lines[2:, 1:-1] & lines[1:-1, :-2] & lines[1:-1, 2:]
    image[lines & ~inner] = (217, 72, 15)
    return _data_url(image)


def _gray(values: np.ndarray) -> np.ndarray:
    # From dark for low values to bright; white where there are none.
    good = np.isfinite(values)
    low, high = np.percentile(values[good], [2, 98]) if good.any() else (0.0, 1.0)
    gray = np.clip((values - low) / max(high - low, 1e-6), 0, 1) * 200 + 30
    return np.where(good, gray, 255)


def _data_url(image: np.ndarray) -> str:
    file = BytesIO()
    imsave(file, image, format='png')
    return 'data:image/png;base64,' + base64.b64encode(file.getvalue()).decode()
