"""The picture of `flexx2 batch`: what a robot sees, its height grids and their errors."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import whole
import numpy as np

_INVALID = '#3a3a3a'
_EXTENT = (-0.35, 0.35, -0.55, 0.55)  # metres: left, right, behind, ahead of the grid


def draw(
    path: Path,
    clean: np.ndarray,
    noisy: np.ndarray,
    truth: np.ndarray,
    errors: dict[str, np.ndarray],
) -> None:
    """
    Draw the robot that stands on most steps, and the errors of all robots.

    Parameters
    ----------
    path : pathlib.Path
        PNG to write.
    clean, noisy : numpy.ndarray
        (N, H, W) depth of the left cameras without and with noise, metres; 0 is invalid.
    truth : numpy.ndarray
        (N, rows, columns) true heights, metres.
    errors : dict of str to numpy.ndarray
        (N, rows, columns) height errors of the grids ``without noise`` and ``with noise``, metres;
        NaN where a cell was not seen.

    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 4, figsize=(14, 7.2), layout='constrained')
    robot = int(np.argmax([len(np.unique(np.round(own, 2))) for own in truth]))
    _draw_images(axes[0, :2], {'clean': clean[robot], 'with noise': noisy[robot]}, robot)
    _draw_heights(axes[0, 2:], truth[robot], errors['with noise'][robot], robot)
    _draw_errors(axes[1, :2], {name: one[robot] for name, one in errors.items()}, robot)
    difference = 1e3 * (errors['with noise'] - errors['without noise'])
    _draw_change(axes[1, 2], difference)
    _draw_distribution(axes[1, 3], errors, np.isfinite(difference))
    figure.suptitle(f'Height grids of {len(truth)} Go1 on stairs (gray: not seen)')
    with whole(path) as part:
        figure.savefig(part, dpi=100, format='png')
    pyplot.close(figure)


def _draw_images(axes: Any, images: dict[str, np.ndarray], robot: int) -> None:
    for axis, (title, image) in zip(axes, images.items(), strict=True):
        shown = axis.imshow(
            np.where(image > 0, image, np.nan),
            cmap=_colours('turbo_r'),
            vmin=0.3,
            vmax=4.0,
            interpolation='nearest',
        )
        axis.set(xticks=[], yticks=[], title=f'robot {robot}, left: {title}')
    axes[-1].figure.colorbar(shown, ax=axes[-1], label='depth [m]')


def _draw_heights(axes: Any, truth: np.ndarray, error: np.ndarray, robot: int) -> None:
    limits = {'vmin': np.nanmin(truth), 'vmax': np.nanmax(truth) + 1e-3}
    for axis, image, title in zip(
        axes, (truth, truth + error), ('true heights', 'seen with noise'), strict=True
    ):
        shown = _grid(axis, image, f'robot {robot}: {title}', 'viridis', **limits)
    axes[-1].figure.colorbar(shown, ax=axes[-1], label='height [m]')


def _draw_errors(axes: Any, errors: dict[str, np.ndarray], robot: int) -> None:
    for axis, (name, error) in zip(axes, errors.items(), strict=True):
        title = f'robot {robot}: error {name}'
        shown = _grid(axis, 1e3 * error, title, 'RdBu', vmin=-20, vmax=20)
    axes[-1].figure.colorbar(shown, ax=axes[-1], label='height error [mm]')


def _draw_change(axis: Any, difference: np.ndarray) -> None:
    valid = np.isfinite(difference)
    spread = np.sqrt(
        np.divide(
            np.where(valid, difference**2, 0).sum(axis=0),
            valid.sum(axis=0),
            where=valid.any(axis=0),
            out=np.full(difference.shape[1:], np.nan),
        )
    )
    shown = _grid(axis, spread, 'all robots: change by noise', 'magma')
    axis.figure.colorbar(shown, ax=axis, label='RMS [mm]')


def _draw_distribution(axis: Any, errors: dict[str, np.ndarray], valid: np.ndarray) -> None:
    steps = np.geomspace(0.05, 300, 200)
    for name, error in errors.items():
        size = np.sort(1e3 * np.abs(error[valid]))
        axis.plot(steps, np.searchsorted(size, steps) / max(size.size, 1), label=name)
    axis.set(
        xscale='log',
        xlabel='absolute error [mm]',
        ylabel='fraction of cells below',
        title='all robots: height error',
        ylim=(0, 1),
    )
    axis.legend(loc='lower right')
    axis.grid(alpha=0.3)


def _grid(axis: Any, image: np.ndarray, title: str, colours: str, **limits: float) -> Any:
    shown = axis.imshow(
        image,
        origin='lower',
        extent=_EXTENT,
        interpolation='nearest',
        cmap=_colours(colours),
        **limits,
    )
    axis.set(title=title, xlabel='left [m]', ylabel='ahead [m]', xlim=_EXTENT[1::-1])
    return shown


def _colours(name: str) -> Any:
    from matplotlib import colormaps

    return colormaps[name].with_extremes(bad=_INVALID)
