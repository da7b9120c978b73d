"""Pictures inside a page: SVG curves and bars, PNG maps."""

import base64
from collections.abc import Callable, Sequence
from html import escape

from flexx2_sim_ros.html_parts import Html
from flexx2_sim_ros.png import encode_png
from matplotlib import colormaps
import numpy as np

_KINDS = ('real', 'simulated', 'effects')
_RED, _BLUE, _NOTHING = (178, 24, 43), (33, 102, 172), (205, 205, 205)
_DEPTHS = 63  # colours of a scale of depth
# Red, green and blue of marked pixels (Okabe and Ito's colours, which colour-blind people tell
# apart).
MARKS = ((213, 94, 0), (0, 158, 115), (0, 114, 178))
_BAR_WIDTH = 160
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 440, 230, 68, 38


def picture(
    image: np.ndarray,
    limit: float,
    enlarged: int = 4,
    steps: int = 126,
    mark: np.ndarray | None = None,
) -> str:
    """
    Return an image (H, W) as a data URL: blue to red within +-`limit`, gray for NaN.

    Larger values have the colour of the limit. A pixel of the image is ``enlarged`` pixels wide
    and high. There are ``steps`` colours on either side of white, at most 126; fewer make the
    picture smaller. Pixels of ``mark``, (H, W) bool, are green instead.
    """
    part = np.clip(np.nan_to_num(image / limit), -1, 1)
    index = np.where(np.isfinite(image), np.rint(part * steps) + steps, 2 * steps + 1)
    if mark is not None:
        index[mark] = 2 * steps + 2
    palette = _blue_to_red(steps)
    return data_url(index.repeat(enlarged, axis=0).repeat(enlarged, axis=1), palette)


def _blue_to_red(steps: int) -> np.ndarray:
    # (2 steps + 3, 3): blue, white, red, gray for nothing, and green for what is marked.
    amount = np.linspace(0, 1, steps + 1)[:, None]
    red, blue = (255 + amount * (np.array(end) - 255) for end in (_RED, _BLUE))
    return np.concatenate([blue[::-1], red[1:], [_NOTHING], MARKS[1:2]])


def depth_picture(
    depth: np.ndarray, low: float, high: float, marks: Sequence[np.ndarray] | None = None
) -> str:
    """
    Return depth, (H, W) metres, as a data URL: dark blue (near) to yellow (far), gray for NaN.

    ``low`` and ``high`` are the ends of the scale of colours, metres. ``marks``, (H, W) bool, are
    pixels to mark in `MARKS`; the first one lies on top. If given, even empty, depth is gray:
    black (near) to white (far).
    """
    part = np.clip(np.nan_to_num((depth - low) / max(high - low, 1e-9)), 0, 1)
    index = np.where(np.isfinite(depth), np.rint(part * (_DEPTHS - 1)), _DEPTHS)
    scale = colormaps['viridis' if marks is None else 'gray'](np.linspace(0.1, 1, _DEPTHS))[:, :3]
    palette = np.concatenate([255 * scale, [_NOTHING], MARKS])
    for i, mark in reversed(list(enumerate(marks or ()))):
        index[mark] = _DEPTHS + 1 + i
    return data_url(index, palette)


def data_url(index: np.ndarray, palette: np.ndarray) -> str:
    """Return an image with a palette as a data URL; see `encode_png`."""
    return png_url(encode_png(index.astype(np.uint8), palette))


def png_url(file: bytes) -> str:
    """Return a PNG as a data URL."""
    return 'data:image/png;base64,' + base64.b64encode(file).decode()


def bar(before: float, after: float | None, null: float) -> Html:
    """Return a small SVG bar: before, after if any, and a mark at how simulations differ."""
    top = max(before, after or 0.0, null, 1e-12) / _BAR_WIDTH
    drawn = f'<rect y="2" height="5" width="{before / top:.1f}" class="before"/>'
    if after is not None:
        drawn += f'<rect y="8" height="5" width="{after / top:.1f}" class="after"/>'
    mark = f'<rect x="{max(null / top - 1, 0):.1f}" y="0" height="16" width="1.5" class="null"/>'
    return _bar('before and after', drawn + mark)


def part_bar(part: float, whole: float) -> Html:
    """Return a small SVG bar: a part of a whole, which is as long as the picture is wide."""
    width = min(max(part / max(whole, 1e-12), 0.0), 1.0) * _BAR_WIDTH
    return _bar('part', f'<rect y="4" height="8" width="{width:.1f}" class="after"/>')


def _bar(label: str, inside: str) -> Html:
    return Html(
        f'<svg class="bar" viewBox="0 0 {_BAR_WIDTH} 16" preserveAspectRatio="none" role="img" '
        f'aria-label="{label}">{inside}</svg>'
    )


def _ticks(low: float, high: float) -> list[float]:
    raw = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(float(power * m) for m in (1, 2, 5, 10) if power * m >= raw)
    return [float(t) + 0.0 for t in np.arange(np.ceil(low / step), high / step + 1e-9) * step]


def _apart(low: float, high: float) -> tuple[float, float]:
    # Ends of an axis: a single value, or equal ones, lie in the middle of it.
    return (low, high) if low < high else (low - 0.5, high + 0.5)


def curves(
    x: np.ndarray,
    lines: np.ndarray,
    names: Sequence[str],
    x_label: str,
    y_label: str,
    least: float,
    kinds: Sequence[str] = _KINDS,
    band: np.ndarray | None = None,
) -> Html:
    """
    Return curves as an SVG figure: `lines`, (L, N), gaps where NaN, over `x`, (N,).

    The range of y is at least ``least``, so that noise does not look like a finding. ``kinds`` are
    classes of the lines in the page's style. ``band``, (2, N), is the low and high end of an
    interval, of class ``band``.
    """
    seen = np.isfinite(lines).any(axis=0)
    x, lines = x[seen], lines[:, seen]
    ends = lines if band is None else np.concatenate([lines, band[:, seen]])
    low, high = float(np.nanmin(ends)), float(np.nanmax(ends))
    pad = max(0.08 * (high - low), (least - (high - low)) / 2)
    low, high = _apart(low - pad, high + pad)
    left, right = _apart(float(x.min()), float(x.max()))

    def at_x(value: float) -> float:
        return _LEFT + (value - left) / max(right - left, 1e-9) * (_WIDTH - _LEFT - 10)

    def at_y(value: float) -> float:
        return _HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _BOTTOM - 24)

    parts = _axes(at_x, at_y, (left, right), (low, high), x_label, y_label)
    if band is not None:
        low_end, high_end = (list(zip(x, one, strict=True)) for one in band[:, seen])
        outline = ' '.join(
            f'{at_x(a):.1f},{at_y(b):.1f}' for a, b in [*low_end, *reversed(high_end)]
        )
        parts.append(f'<polygon points="{outline}" class="band"/>')
    legend = _LEFT + 4
    for i, line in enumerate(lines):
        points = ' '.join(
            f'{at_x(a):.1f},{at_y(b):.1f}' for a, b in zip(x, line, strict=True) if np.isfinite(b)
        )
        parts.append(f'<polyline points="{points}" class="curve {kinds[i]}"/>')
        parts.append(_legend_entry(legend, names[i], kinds[i]))
        legend += 42 + 7 * len(names[i])
    return Html(
        f'<figure><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" font-size="12" '
        f'role="img" aria-label="{escape(y_label)} against {escape(x_label)}">'
        f'{"".join(parts)}</svg></figure>'
    )


def _axes(
    at_x: Callable[[float], float],
    at_y: Callable[[float], float],
    along_x: tuple[float, float],
    along_y: tuple[float, float],
    x_label: str,
    y_label: str,
) -> list[str]:
    # Lines of the grid, ticks and labels of both axes, as SVG.
    middle = (24 + _HEIGHT - _BOTTOM) / 2
    grid = [
        f'<line x1="{_LEFT}" x2="{_WIDTH - 10}" y1="{at_y(tick):.1f}" '
        f'y2="{at_y(tick):.1f}" class="grid"/><text x="{_LEFT - 6}" '
        f'y="{at_y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>'
        for tick in _ticks(*along_y)
    ]
    ticks = [
        f'<text x="{at_x(tick):.1f}" y="{_HEIGHT - _BOTTOM + 16}" '
        f'text-anchor="middle">{tick:g}</text>'
        for tick in _ticks(*along_x)
    ]
    labels = [
        f'<text x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 4}" text-anchor="middle">'
        f'{escape(x_label)}</text>',
        f'<text x="12" y="{middle}" text-anchor="middle" transform="rotate(-90 12 {middle})">'
        f'{escape(y_label)}</text>',
    ]
    return grid + ticks + labels


def _legend_entry(left: int, name: str, kind: str) -> str:
    return (
        f'<line x1="{left}" x2="{left + 18}" y1="10" y2="10" class="curve {kind}"/>'
        f'<text x="{left + 23}" y="14">{escape(name)}</text>'
    )
