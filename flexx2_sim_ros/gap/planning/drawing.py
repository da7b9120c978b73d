"""Small drawings of the set-ups, from above and as the camera sees them."""

from io import BytesIO
from typing import Any

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.planning.plan import PlannedRecording
from flexx2_sim_ros.gap.planning.scenes import render
from flexx2_sim_ros.gap.planning.truths import smaller
from matplotlib.figure import Figure
import numpy as np

_INK, _BLUE, _ORANGE = '#1c2733', '#1f6feb', '#d9480f'
_SCALE = 0.5  # of the camera's image
_FARTHEST = 3.0  # medians of the distance, that are drawn from above


def drawing(planned: PlannedRecording, lens: Intrinsics) -> bytes:
    """Draw a set-up as a PNG: seen from above (left), and its depth (right)."""
    small = smaller(lens, _SCALE)
    depth, _, shown = render(planned.scene, small, [0.0])
    if planned.scene.moving:
        depth, shown = depth[0], shown[0]
    figure = Figure(figsize=(5.0, 2.3), dpi=110, layout='constrained')
    above, image = figure.subplots(1, 2, width_ratios=[1.25, 1])
    _from_above(above, planned, depth, shown, small)
    mapped = image.imshow(depth, cmap='viridis')
    image.set(xticks=[], yticks=[])
    image.set_title('depth image, m', fontsize=8, color=_INK)
    bar = figure.colorbar(mapped, ax=image, shrink=0.8)
    bar.ax.tick_params(labelsize=7)
    file = BytesIO()
    figure.savefig(file, format='png')
    return file.getvalue()


def _from_above(
    ax: Any, planned: PlannedRecording, depth: np.ndarray, shown: np.ndarray, lens: Intrinsics
) -> None:
    # Points that the middle row of the image hits, one line for each panel; the camera is at the
    # origin and looks up.
    row = lens.height // 2
    z, panel = depth[row].astype(float), shown[row]
    x = (np.arange(lens.width) - lens.cx) / lens.fx * z
    # For a view along a wall, a scale that includes its far end would be too small for the rest.
    top = half = 1.0
    if np.isfinite(z).any():  # Else what moves is not in view yet.
        z = np.where(z <= _FARTHEST * np.nanmedian(z), z, np.nan)
        x = np.where(np.isfinite(z), x, np.nan)
        top, half = float(np.nanmax(z)), float(np.nanmax(np.abs(x)))
    for side in (0, -1):
        if np.isfinite(z[side]):
            ax.plot([0, x[side]], [0, z[side]], color=_INK, lw=0.6, ls=':')
    for k, one in enumerate(planned.scene.panels, 1):
        own = panel == k
        if not own.any():
            continue
        moving = any(one.velocity)
        # The line has a gap where a nearer panel hides a part.
        # Dark surfaces are drawn dark; white ones stay visible on white.
        color = _ORANGE if moving else str(round(float(0.1 + 0.65 * one.reflectivity), 3))
        line = np.where(own, x, np.nan), np.where(own, z, np.nan)
        ax.plot(*line, color=color, lw=4, solid_capstyle='butt')
        if moving:
            at, height = x[own].mean(), z[own].mean()
            end = at + 0.3 * top * np.sign(one.velocity[0]), height
            _arrow(ax, (at, height), end, '->', _ORANGE)
    _camera(ax, planned.scene.turn_rate, top)
    middle = lens.width // 2
    if np.isfinite(z[middle]):
        _arrow(ax, (0, 0), (0, z[middle]), '<->', _BLUE)
        ax.text(0.04 * half, 0.45 * z[middle], f'{z[middle]:.2g} m', color=_BLUE, fontsize=8)
    ax.set_aspect('equal')
    wide = 1.1 * max(half, 0.45 * top)
    ax.set(xlim=(-wide, wide), ylim=(-0.14 * top, 1.08 * top), xticks=[], yticks=[])
    ax.spines[:].set_visible(False)
    ax.set_title('from above', fontsize=8, color=_INK)


def _camera(ax: Any, turn_rate: float, top: float) -> None:
    size = 0.05 * top
    ax.fill([-size, size, size, -size], [-1.6 * size, -1.6 * size, 0, 0], color=_INK, linewidth=0)
    if turn_rate:
        way = np.sign(turn_rate)
        start, end = (-way * 0.12 * top, 0.2 * top), (way * 0.25 * top, 0.1 * top)
        _arrow(ax, start, end, '->', _ORANGE, connectionstyle=f'arc3,rad={-0.3 * way}')


def _arrow(ax: Any, start: Any, end: Any, style: str, color: str, **more: str) -> None:
    arrow = {'arrowstyle': style, 'color': color, **more}
    ax.annotate('', xy=end, xytext=start, arrowprops=arrow)
