"""The picture of the demo: clean and simulated depth and their difference, by camera and mode."""

from collections.abc import Mapping
from pathlib import Path

from flexx2_sim_ros.atomic import whole
from flexx2_sim_ros.physics.geometry import centred, Reprojection
from flexx2_sim_ros.profiles.modes import Mode, Profile
import numpy as np

_INVALID = '#3a3a3a'


def draw(
    path: Path,
    pictures: Mapping[tuple[str, str], tuple[np.ndarray, np.ndarray]],
    modes: list[Mode],
    profile: Profile,
) -> None:
    """
    Write the picture.

    Parameters
    ----------
    path : pathlib.Path
        PNG to write.
    pictures : mapping
        By (camera, usecase): clean depth as `go1_cameras` renders it for the profile, and
        simulated depth in the camera's pixels; metres, NaN for invalid.
    modes : list of Mode
        One row each.
    profile : Profile
        The camera.

    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot
    from matplotlib.colors import LogNorm

    cameras = list(dict.fromkeys(camera for camera, _ in pictures))
    figure, axes = pyplot.subplots(
        len(modes),
        3 * len(cameras),
        squeeze=False,
        layout='constrained',
        figsize=(2.75 * 3 * len(cameras) + 1.6, 2.15 * len(modes) + 0.7),
    )
    depths = pyplot.get_cmap('turbo_r').with_extremes(bad=_INVALID)
    errors = pyplot.get_cmap('RdBu').with_extremes(bad=_INVALID)
    for row, mode in enumerate(modes):
        for column, camera in enumerate(cameras):
            rendered, seen = pictures[camera, mode.name]
            clean = as_seen(rendered, profile)
            line = axes[row, 3 * column : 3 * column + 3]
            for axis, image in zip(line[:2], (clean, seen), strict=True):
                depth = axis.imshow(
                    image, cmap=depths, norm=LogNorm(0.3, 5.0), interpolation='nearest'
                )
            difference = line[2].imshow(
                1e3 * (seen - clean), cmap=errors, vmin=-20, vmax=20, interpolation='nearest'
            )
            for axis, title in zip(line, ('clean', 'simulated', 'simulated - clean'), strict=True):
                axis.set(xticks=[], yticks=[])
                if row == 0:
                    axis.set_title(f'{camera}: {title}', fontsize=11)
        axes[row, 0].set_ylabel(
            f'{mode.name}\n{mode.range_min:g} to {mode.range_max:g} m\n'
            f'sigma_x {mode.noise.sigma_x:.2f} px',
            fontsize=11,
        )
    ticks = [0.3, 0.5, 1, 2, 3, 5]
    bar = figure.colorbar(depth, ax=axes[:, -1], shrink=0.9, ticks=ticks, label='depth [m]')
    bar.ax.minorticks_off()
    bar.ax.set_yticklabels([f'{tick:g}' for tick in ticks])
    label = 'simulated - clean [mm]: red is nearer, blue farther'
    figure.colorbar(difference, ax=axes[:, -1], shrink=0.9, label=label)
    figure.suptitle(f'Two simulated {profile.model} on a Go1 (dark gray: no depth)', fontsize=13)
    with whole(path) as part:
        figure.savefig(part, dpi=100, format='png')
    pyplot.close(figure)


def as_seen(rendered: np.ndarray, profile: Profile) -> np.ndarray:
    """
    Return rendered depth in the pixels of the camera.

    A renderer has no distortion and the principal point in the middle, so for some cameras it
    draws a larger image.

    Parameters
    ----------
    rendered : numpy.ndarray
        Depth of the `centred` camera, metres.
    profile : Profile
        The camera.

    Returns
    -------
    numpy.ndarray
        (H, W) of the camera, NaN for invalid.

    """
    camera = profile.intrinsics
    view = Reprojection(camera, centred(camera), sensor=profile.sensor)
    return np.where(view.outside, np.float32(np.nan), view.depth(rendered))
