"""Single frames of recordings beside their simulations, as HTML."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.data.axes import Axes
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.single_frame import SingleFrame
from flexx2_sim_ros.gap.report.places import group
from flexx2_sim_ros.gap.report.text import short
from flexx2_sim_ros.gap.report.words import camera_effects
from flexx2_sim_ros.html_drawing import depth_picture, MARKS, picture
import numpy as np

MOST_FRAMES = 16  # recordings that have a frame on the page; bounds its size
_STEPS = 15  # colours on either side of white: noise in more of them makes a picture large
_WORST = 0.01  # share of the pixels that differ most
_MOST_MARKED = 0.85  # fraction of the surfaces; a condition with more of them is everywhere

FRAMES_STYLE = """
.frames { display: grid; gap: .7rem; grid-auto-flow: column; grid-template-rows: auto auto;
  grid-auto-columns: 1fr; max-width: 60rem; }
.frames img { width: 100%; image-rendering: pixelated; }
.mark { display: inline-block; width: .8rem; height: .8rem; margin: 0 .3rem 0 .8rem; }
@media (max-width: 40rem) { .frames { grid-auto-flow: row; grid-template-rows: none;
  grid-template-columns: 1fr 1fr; } }
"""


def frames(table: dict[str, Any], confirmed: Sequence[Outcome], axes: Axes) -> html.Html:
    """
    Return one frame of up to `MOST_FRAMES` recordings, real and simulated, as HTML.

    Recordings with a frame are shown, that with the largest gap first.
    """
    shown = [(index, one.frame) for index, one in enumerate(confirmed) if one.frame is not None]
    shown.sort(key=lambda pair: -confirmed[pair[0]].apart.gap)
    parts = [_recording(table, confirmed[index], frame, index, axes) for index, frame in shown]
    rest = len(confirmed) - len(parts)
    others = f' Recordings that are not shown: {rest}.' if rest else ''
    return html.folded(
        'Single frames, real and simulated',
        *parts,
        html.note(
            'The middle frame of each recording, and the same frame as simulated at the fitted '
            'pose: differences of single frames contain the noise of both. Gray: no depth. In the '
            'differences, blue is nearer than simulated, red is farther, white is equal, and the '
            f'worst {100 * _WORST:g} % are green; size is the mean without sign. Marked in gray '
            'depth are the pixels of the first rows of "Where the gap lies", unless these are the '
            f'whole frame.{others}'
        ),
    )


def _recording(
    table: dict[str, Any], one: Outcome, frame: SingleFrame, index: int, axes: Axes
) -> html.Html:
    real, before, after = frame.depth
    low, high = (quantile(frame.depth, share) for share in (0.01, 0.99))
    limit = max(quantile(np.abs(real - before), 0.95), 0.001)
    marks = _marks(table['where'], frame, index, axes)
    pictures = [
        (f'real, {_invalid(real)}', depth_picture(real, low, high)),
        (
            'marked pixels' if marks else 'no pixels are singled out',
            depth_picture(real, low, high, [mask for _, mask in marks]),
        ),
        (f'simulated, {_invalid(before)}', depth_picture(before, low, high)),
        _difference('real minus simulated', real - before, limit),
    ]
    first, last, _ = one.apart.physical['wasserstein_mm']
    errors = f'depth errors {short(first)} mm'
    if camera_effects(table):
        added = f'simulated with the effects, {_invalid(after)}'
        pictures.append((added, depth_picture(after, low, high)))
        pictures.append(_difference('real minus simulated with the effects', real - after, limit))
        errors += f', with the effects {short(last)} mm'
    figures = (html.figure(url, text) for text, url in pictures)
    legend: list[str] = []
    for (text, _), colour in zip(marks, MARKS, strict=False):
        legend += [html.element('span', kind='mark', style=f'background: rgb{colour}'), text]
    return html.join(
        html.heading(f'{one.name}, frame {frame.index}: {errors}', 3),
        html.element('div', *figures, kind='frames'),
        html.note(
            f'Depth {low:.2f} m (dark) to {high:.2f} m (bright); differences: full colour at '
            f'{short(1000 * limit)} mm.',
            *legend,
        ),
    )


def _invalid(depth: np.ndarray) -> str:
    return f'{100 * np.mean(~np.isfinite(depth)):.1f} % invalid'


def _difference(name: str, apart: np.ndarray, limit: float) -> tuple[str, str]:
    # Text and picture, with the worst pixels marked.
    size = np.abs(apart)
    worst = quantile(size, 1 - _WORST)
    marked = picture(apart, limit, 1, _STEPS, size > worst)
    if np.isfinite(size).any():
        middle, mean = 1000 * quantile(apart, 0.5), 1000 * size[np.isfinite(size)].mean()
        name += f': median {middle:+.1f}, size {mean:.1f}, worst {100 * _WORST:g} % from '
        name += f'{1000 * worst:.0f} mm'
    return name, marked


def quantile(values: np.ndarray, share: float) -> float:
    """Return a quantile of the finite values, 0 where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, share)) if finite.size else 0.0


def _marks(
    rows: Sequence[dict[str, Any]], frame: SingleFrame, index: int, axes: Axes
) -> list[tuple[str, np.ndarray]]:
    # Text and (h, w) mask of the first conditions that select a part of this frame's pixels.
    out: dict[str, np.ndarray] = {}
    surfaces = frame.places['all'] >= 0
    most = _MOST_MARKED * max(surfaces.sum(), 1)
    for row in rows:
        mask = _pixels(row, frame, index, axes)
        if mask is not None and mask.any() and (mask & surfaces).sum() <= most:
            out.setdefault(group(row), mask)
    return list(out.items())[: len(MARKS)]


def _pixels(row: dict[str, Any], frame: SingleFrame, index: int, axes: Axes) -> np.ndarray | None:
    # (h, w) bool, the pixels of a row of `where`; None for a row that selects no pixels.
    name, low, high = row['covariate'], row['low'], row['high']
    if name == 'recording':
        return frame.places['all'] >= 0 if low == index else None
    if name.startswith('image region'):
        words = name.replace(',', '').split()
        region = (int(words[3]) - 1) * 4 + int(words[7]) - 1
        return np.asarray(frame.places['region'] == region)
    if name in ('nothing there', 'beyond the range'):
        return np.asarray(frame.places['beyond'] == (name == 'beyond the range'))
    if name == 'edge':
        return np.asarray(frame.places['edge'] >= 0)
    if name == 'amplitude':
        name = 'log_amplitude'
        low, high = (None if end is None else np.log(end) for end in (low, high))
    if name not in axes or not axes[name].edges:
        return None
    # The ends are edges of bins, as they were written.
    edges = np.array(axes[name].edges)
    first = 0 if low is None else int(np.abs(edges - low).argmin()) + 1
    last = axes[name].bins - 1 if high is None else int(np.abs(edges - high).argmin())
    place = frame.places[name]
    return np.asarray((place >= first) & (place <= last))
