"""octomap_server of ROS 2: the probability of a hit, and the range."""

from flexx2_sim_ros.export.fits import fit_constant, within
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters, reach
import numpy as np

_LEAST, _MOST = 0.51, 0.97  # a hit below 0.5 would clear a cell; the server's own upper clamp


def write(noise: MapperNoise, cell: float) -> Parameters:
    """
    Write the range in which sigma is at most half a cell, and the probability of a hit there.

    The probability is that of a point to lie at most half a cell from its surface, averaged over
    this range.
    """
    far, unusable = reach(noise, cell)
    near = np.isfinite(noise.typical) & (noise.distance <= far)
    right = within(noise.typical[near], cell / 2)
    fit = fit_constant(noise.distance[near], right, _LEAST, _MOST)
    text = (
        f'{header(noise)}\n'
        'octomap_server:\n'
        '  ros__parameters:\n'
        f'    resolution: {cell:g}\n'
        f'    sensor_model.max_range: {far:.4g}\n'
        f'    sensor_model.hit: {fit.values[0]:.3f}\n'
    )
    lost = ('sigma(z): one probability at all distances', *unusable, *common_losses(noise))
    return Parameters(text, (('sensor_model.hit', fit),), lost)


TARGET = ExportTarget(
    'octomap_server',
    'octomap_server.yaml',
    'probability of a hit, range',
    'OctoMap/octomap_mapping, branch ros2: octomap_server/src/octomap_server.cpp',
    write,
)
