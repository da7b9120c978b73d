"""What a target of an export is."""

from collections.abc import Callable
from dataclasses import dataclass
import re

from flexx2_sim_ros.export.fits import NoiseFit
from flexx2_sim_ros.export.mapper_noise import MapperNoise
from flexx2_sim_ros.profiles.modes import Profile
import numpy as np

_SEEN_LOSS = 0.005  # of the pixels
_SEEN_BIAS = 5e-5  # metres: rounded to 0.1 mm


@dataclass(frozen=True)
class Parameters:
    """
    A file for a target.

    Attributes
    ----------
    text : str
        The file's content.
    fits : tuple of (str, Fit)
        The target's name of each fitted parameter, and its fit.
    lost : tuple of str
        What the target cannot hold, one sentence each.

    """

    text: str
    fits: tuple[tuple[str, NoiseFit], ...]
    lost: tuple[str, ...]


@dataclass(frozen=True)
class ExportTarget:
    """
    A mapper or simulator that takes noise parameters.

    Attributes
    ----------
    name : str
        On the command line.
    file : str
        Name of the file, as the target calls such files; ``CAMERA`` stands for the camera's name.
    holds : str
        What its parameters can say, for people.
    source : str
        Where the format was read.
    write : callable
        Takes the noise and an edge length of the map's cells in metres.

    """

    name: str
    file: str
    holds: str
    source: str
    write: Callable[[MapperNoise, float], Parameters]

    def file_of(self, profile: Profile) -> str:
        """Return the name of the file for a camera."""
        return self.file.replace('CAMERA', identifier(profile))


def identifier(profile: Profile) -> str:
    """Return a camera's name in lower case, digits and underscores, e.g. ``kinect_v2``."""
    return re.sub('[^a-z0-9]+', '_', profile.model.lower()).strip('_') or 'camera'


def reach(noise: MapperNoise, cell: float) -> tuple[float, tuple[str, ...]]:
    """
    Return up to which distance sigma is at most half a cell, and what to say if it never is.

    Both are in metres. It is the range of the mode if sigma is never at most half a cell, or is so
    to the end.
    """
    usable = noise.typical <= cell / 2  # False for NaN
    if not usable.any():
        return noise.mode.range_max, (
            f'range: sigma exceeds half a cell of {cell:g} m at all distances, so that the range '
            'of the mode is written; use larger cells',
        )
    if usable[-1]:
        return noise.mode.range_max, ()
    return float(noise.distance[usable].max()), ()


def header(noise: MapperNoise, comment: str = '#') -> str:
    """Return the lines at the top of a file: which camera, which effects."""
    effects = ', '.join(noise.effects) or 'none'
    angles = ', '.join(f'{angle:g}' for angle in noise.angles)
    near, far = noise.distance[[0, -1]]
    return '\n'.join(
        f'{comment} {line}'.rstrip()
        for line in (
            f'{noise.profile.model}, {noise.mode.name}; effects: {effects}',
            f'Least squares over {near:.2f} to {far:.2f} m at incidence angles of {angles} deg',
        )
    )


def common_losses(
    noise: MapperNoise, *, bias: bool = False, lateral: bool = False
) -> tuple[str, ...]:
    """
    Return what no target, or hardly one, can hold.

    ``bias`` and ``lateral`` say whether the target holds the mean error over all distances, and
    sigma_x.
    """
    found = []
    if len(noise.angles) > 1:
        share = noise.sigma / noise.typical[:, None]
        found.append(
            f'incidence: sigma is {np.nanmin(share):.2f} to {np.nanmax(share):.2f} times what is '
            'written'
        )
    left = noise.bias - noise.mean_bias if bias else noise.bias
    largest = float(np.nanmax(np.abs(left)))
    if largest > _SEEN_BIAS:
        beside = ', beside the mean that is written' if bias else ' on average'
        found.append(f'bias: depth is up to {1e3 * largest:.1f} mm off{beside}')
    if noise.mode.noise.sigma_x and not lateral:
        found.append(f'lateral noise: edges move by {noise.mode.noise.sigma_x:.2f} px')
    if noise.lost.max() > _SEEN_LOSS:
        found.append(f'lost pixels: up to {noise.lost.max():.0%} are invalid or off by over 10 %')
    if noise.age:
        found.append(f'age: an image shows the scene {1e3 * noise.age:.0f} ms before it arrives')
    if noise.effects:
        found.append(
            'edges, corners and motion: a wall does not show what effects do there; simulate the '
            'camera for them'
        )
    return tuple(found)
