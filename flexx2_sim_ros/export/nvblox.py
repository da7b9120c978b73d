"""nvblox: weights that fall with the square of the distance, and a truncation distance."""

import math

from flexx2_sim_ros.export.fits import fit_power
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters
import numpy as np

_SIGMAS = 3.0  # that the truncation distance holds
_LEAST_CELLS = 4.0  # nvblox's own default


def write(noise: MapperNoise, cell: float) -> Parameters:
    """
    Write range, truncation distance and weighting.

    The weight 1 / z^2 is right for a sigma that grows with z; the fit says how well that holds.
    """
    fit = fit_power(noise.distance, noise.typical, 1, 'a z')
    largest = float(np.nanmax(noise.typical))
    cells = max(_LEAST_CELLS, math.ceil(_SIGMAS * largest / cell))
    text = (
        f'{header(noise)}\n'
        '/**:\n'
        '  ros__parameters:\n'
        f'    voxel_size: {cell:g}\n'
        '    static_mapper:\n'
        f'      projective_integrator_max_integration_distance_m: {noise.mode.range_max:.1f}\n'
        f'      projective_integrator_truncation_distance_vox: {cells:.1f}\n'
        '      projective_integrator_weighting_mode: "inverse_square"\n'
    )
    return Parameters(text, (('weight 1 / z^2', fit),), common_losses(noise))


TARGET = ExportTarget(
    'nvblox',
    'nvblox_CAMERA.yaml',
    'sigma(z) as a z, range',
    'NVIDIA-ISAAC-ROS/isaac_ros_nvblox, March 2026: config/nvblox/nvblox_base.yaml, '
    'mapper_initialization.cpp',
    write,
)
