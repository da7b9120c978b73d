"""Pictures inside a page: SVG curves and bars, PNG maps."""

import base64
from collections.abc import Sequence
from html import escape
from io import BytesIO

from matplotlib.image import imsave
import numpy as np

# What `curves` needs in a page's style; the classes are real, simulated, simulated with effects.
CURVE_STYLE = """
.curve { fill: none; stroke-width: 2; } .grid { stroke: var(--line); }
.real { stroke: var(--ink); } .simulated { stroke: var(--orange); stroke-dasharray: 5 3; }
.effects { stroke: var(--blue); } svg text { fill: var(--ink); }
"""
_KINDS = ('real', 'simulated', 'effects')
_BAR_WIDTH = 160
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 440, 230, 52, 38


def picture(image: np.ndarray, limit: float) -> str:
    """Return an (H, W) image as a data URL: blue to red within +-limit, gray for NaN."""
    part = np.clip(np.nan_to_num(image / limit), -1, 1)[..., None]
    red, blue = np.array([178, 24, 43]), np.array([33, 102, 172])
    colour = np.where(part > 0, 255 + part * (red - 255), 255 - part * (blue - 255))
    colour = np.where(np.isfinite(image)[..., None], colour, 205).astype(np.uint8)
    colour = colour.repeat(4, axis=0).repeat(4, axis=1)
    file = BytesIO()
    imsave(file, colour, format='png')
    return 'data:image/png;base64,' + base64.b64encode(file.getvalue()).decode()


def bar(before: float, after: float, null: float) -> str:
    """
    Return a small SVG bar: before, after, and a mark at what two simulations differ by.

    Its class is ``bar``: the style of the page gives its size.
    """
    top = max(before, after, null, 1e-12) / _BAR_WIDTH
    return (
        f'<svg class="bar" viewBox="0 0 {_BAR_WIDTH} 16" preserveAspectRatio="none" role="img" '
        'aria-label="before and after">'
        f'<rect y="2" height="5" width="{before / top:.1f}" class="before"/>'
        f'<rect y="8" height="5" width="{after / top:.1f}" class="after"/>'
        f'<rect x="{max(null / top - 1, 0):.1f}" y="0" height="16" width="1.5" '
        'class="null"/></svg>'
    )


def _ticks(low: float, high: float) -> list[float]:
    raw = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(float(power * m) for m in (1, 2, 5, 10) if power * m >= raw)
    return [float(t) + 0.0 for t in np.arange(np.ceil(low / step), high / step + 1e-9) * step]


def curves(
    x: np.ndarray,
    lines: np.ndarray,
    names: Sequence[str],
    x_label: str,
    y_label: str,
    least: float,
    kinds: Sequence[str] = _KINDS,
    band: np.ndarray | None = None,
) -> str:
    """
    Return curves as an SVG figure; the page needs `CURVE_STYLE`.

    Parameters
    ----------
    x : numpy.ndarray
        (N,).
    lines : numpy.ndarray
        (L, N), gaps where NaN.
    names : sequence of str
        Of the lines.
    x_label, y_label : str
        Of the axes.
    least : float
        Range of y at least, so that noise does not look like a finding.
    kinds : sequence of str
        Classes of the lines in the page's style.
    band : numpy.ndarray, optional
        (2, N) low and high end of an interval, of class ``band``.

    """
    seen = np.isfinite(lines).any(axis=0)
    x, lines = x[seen], lines[:, seen]
    ends = lines if band is None else np.concatenate([lines, band[:, seen]])
    low, high = float(np.nanmin(ends)), float(np.nanmax(ends))
    pad = max(0.08 * (high - low), (least - (high - low)) / 2)
    low, high = low - pad, high + pad
    left, right = float(x.min()), float(x.max())

    def at_x(value: float) -> float:
        return _LEFT + (value - left) / max(right - left, 1e-9) * (_WIDTH - _LEFT - 10)

    def at_y(value: float) -> float:
        return _HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _BOTTOM - 24)

    parts = [
        f'<line x1="{_LEFT}" x2="{_WIDTH - 10}" y1="{at_y(tick):.1f}" '
        f'y2="{at_y(tick):.1f}" class="grid"/><text x="{_LEFT - 6}" '
        f'y="{at_y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>'
        for tick in _ticks(low, high)
    ]
    parts += [
        f'<text x="{at_x(tick):.1f}" y="{_HEIGHT - _BOTTOM + 16}" '
        f'text-anchor="middle">{tick:g}</text>'
        for tick in _ticks(left, right)
    ]
    if band is not None:
        low_end, high_end = (list(zip(x, one, strict=True)) for one in band[:, seen])
        outline = ' '.join(
            f'{at_x(a):.1f},{at_y(b):.1f}' for a, b in [*low_end, *reversed(high_end)]
        )
        parts.append(f'<polygon points="{outline}" class="band"/>')
    for i, line in enumerate(lines):
        points = ' '.join(
            f'{at_x(a):.1f},{at_y(b):.1f}' for a, b in zip(x, line, strict=True) if np.isfinite(b)
        )
        parts.append(f'<polyline points="{points}" class="curve {kinds[i]}"/>')
        parts.append(_legend_entry(_LEFT + 4 + 125 * i, names[i], kinds[i]))
    parts.append(
        f'<text x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 4}" text-anchor="middle">'
        f'{escape(x_label)}</text>'
    )
    return (
        f'<figure><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" font-size="12" '
        f'role="img" aria-label="{escape(y_label)} against {escape(x_label)}">'
        f'{"".join(parts)}</svg><figcaption>{escape(y_label)} against {escape(x_label)}'
        '</figcaption></figure>'
    )


def _legend_entry(left: int, name: str, kind: str) -> str:
    return (
        f'<line x1="{left}" x2="{left + 18}" y1="10" y2="10" class="curve {kind}"/>'
        f'<text x="{left + 23}" y="14">{escape(name)}</text>'
    )
