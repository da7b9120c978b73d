"""The page of a campaign: the pose of each recording, and how well it fits."""

from collections.abc import Callable, Mapping
from typing import Any

from flexx2_sim_ros.html_drawing import data_url, depth_picture, picture
from flexx2_sim_ros.html_page import html_page
from flexx2_sim_ros.html_parts import (
    beside,
    element,
    figure,
    heading,
    Html,
    join,
    note,
    table,
    tag,
)
from flexx2_sim_ros.truth.clean import PARTS
from flexx2_sim_ros.truth.writing import Written
import numpy as np

_STYLE = 'td.words { min-width: 12rem; }'
# Colours of `PARTS` on the map; told apart with any colour vision.
_COLOURS = {
    'outside': (120, 120, 120),
    'known': (0, 114, 178),
    'hidden': (230, 159, 0),
    'refused': (204, 121, 167),
}
_SHADES = 50  # of the image under the map
_LIMIT = 0.03  # metres, end of the colour scale of the residual map
_WIDTH = 420  # pixels, of a picture
_STATES = {'used': 'good', 'doubtful': 'doubtful', 'refused': 'bad'}  # the kinds of their tags
# By the kind of ground truth: what the edges on the first figure are.
_CAPTIONS = {
    'scan': 'measured depth (dark is near), edges of the room in orange',
    'board': 'gray image, outline of the board as it was found in orange',
    'planes': 'measured depth (dark is near), outlines of the known part of planes in orange',
}


def page(results: Mapping[str, Any], written: Mapping[int, Written]) -> str:
    """
    Return the page of ``truth.yaml`` as HTML, all text escaped and all pictures inside.

    `written` has the recordings that are not refused, by number.
    """
    rows = results['recordings']
    count = {state: sum(row['verdict'] == state for row in rows) for state in _STATES}
    words = ', '.join(f'{number} {state}' for state, number in count.items() if number)
    caption = _CAPTIONS[results['kind']]
    body = join(
        heading(f'Ground truth of {len(rows)} recordings: {words}', 1),
        element('p', *_about(results)),
        *([_shared(results['shared'])] if 'shared' in results else []),
        heading('What this ground truth cannot decide'),
        table((), ((row['effect'], row['reason']) for row in results['cannot_decide'])),
        *_recordings(results),
        *(part for i, one in written.items() for part in _figures(rows[i]['name'], one, caption)),
        note(results['command']),
    )
    return html_page('Ground truth', _STYLE, body)


def _about(results: Mapping[str, Any]) -> tuple[str, ...]:
    if results['kind'] == 'planes':
        return 'Planes: ', element('code', results['planes']), '.'
    if results['kind'] == 'board':
        size = ' x '.join(f'{value * 1e3:g}' for value in results['board_size_m'])
        more = f', {size} mm; focal length within {results["lens_error"]:.1%} (given).'
        return 'Board: ', element('code', results['board']), more
    size = ' x '.join(f'{value:g}' for value in results['room_size_m'])
    more = f', {size} m, accuracy {results["room_error_mm"]:g} mm ({results["room_error"]}).'
    return 'Room: ', element('code', results['room']), more


def _shared(found: Mapping[str, Mapping[str, Any]]) -> Html:
    return join(
        heading('Errors that the recordings share'),
        element(
            'p',
            'Fitted together with the poses, so that the poses do not hide them. They are not '
            'part of clean_depth.',
        ),
        table(
            ('effect', 'verdict', 'size', ''),
            (
                _row(effect, one['verdict'], words=(_sizes(one), one.get('reason', '')))
                for effect, one in found.items()
            ),
        ),
    )


def _row(*cells: str, words: tuple[str, ...]) -> Html:
    # Cells, then those that are wide.
    wide = (element('td', one, kind='words') for one in words)
    return element('tr', *(element('td', one) for one in cells), *wide)


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


# The columns of the table of recordings: the head, and the cell of a row.
_Cell = Callable[[Mapping[str, Any]], str]
_POSED: dict[str, _Cell] = {
    'camera': lambda row: row['motion'],
    'pixels that fit': lambda row: f'{row["fitting"]:.0%}',
    'pose, standard deviation': lambda row: (
        f'{row["pose_sigma_mm"]:.2f} mm, {row["pose_sigma_deg"]:.3f} deg' if 'pose' in row else ''
    ),
    'median residual': lambda row: (
        ''
        if 'pose' not in row
        else 'no depth'
        if row['residual_mm'] is None
        else f'{row["residual_mm"]:.1f} mm'
    ),
    'known': lambda row: _known(row),
}
_PLANES: dict[str, _Cell] = {
    'known': lambda row: _known(row),
    'planes: distance, and how much farther the recording shows them': lambda row: join(
        *(part for plane in row.get('planes', ()) for part in (_plane(plane), element('br')))
    ),
}


def _recordings(results: Mapping[str, Any]) -> tuple[Html, Html]:
    columns = _PLANES if results['kind'] == 'planes' else _POSED
    lines = (
        _row(
            row['name'],
            tag(row['verdict'], _STATES[row['verdict']]),
            *(cell(row) for cell in columns.values()),
            words=(element('small', '; '.join(row['reasons'])),),
        )
        for row in results['recordings']
    )
    return heading('Recordings'), table(('file', 'verdict', *columns, ''), lines)


def _known(row: Mapping[str, Any]) -> str:
    # What fraction of the pixels is known, and why others are not.
    if 'known' not in row:
        return ''
    why = ', '.join(f'{name} {part:.0%}' for name, part in row['unknown'].items() if part)
    return join(f'{row["known"]:.0%}', *((' ', element('small', f'({why})')) if why else ()))


def _plane(row: Mapping[str, Any]) -> str:
    off = row['residual_mm']
    measured = 'not measured' if off is None else f'± {row["sigma_mm"]:.1f} mm, {off:+.1f} mm'
    return f'{row["name"]}: {row["distance_m"]:.3f} m, {measured}'


def _figures(name: str, shown: Written, caption: str) -> tuple[Html, Html]:
    residual = (
        f'measured minus clean depth, blue {-_LIMIT * 1e3:.0f} to red {_LIMIT * 1e3:+.0f} mm, '
        'gray unknown or invalid'
    )
    return heading(name), beside(
        figure(_overlay(shown), caption, f'edges of {name}', _WIDTH),
        figure(picture(shown.residual, _LIMIT), residual, f'residual of {name}', _WIDTH),
        figure(_map(shown), _legend(shown), f'map of {name}', _WIDTH),
    )


def _legend(shown: Written) -> Html:
    parts = [
        join(element('span', '■', style=f'color:rgb{_COLOURS[name]}'), f' {name} {part:.0%}')
        for name, part in shown.shares.items()
    ]
    return Html(', '.join(parts))


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
