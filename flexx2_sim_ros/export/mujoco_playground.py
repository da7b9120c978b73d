"""mujoco_playground: uniform noise with one scale an observation."""

import math

from flexx2_sim_ros.export.fits import fit_constant
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters

_UNIFORM = math.sqrt(3.0)  # half-width of a uniform distribution with a sigma of 1


def write(noise: MapperNoise, cell: float) -> Parameters:
    """Write a ``noise_config`` whose uniform noise has the camera's sigma."""
    del cell
    fit = fit_constant(noise.distance, noise.typical)
    text = (
        f'{header(noise)}\n'
        'from ml_collections import config_dict\n\n'
        'noise_config = config_dict.create(\n'
        '    level=1.0,  # 0.0 disables noise.\n'
        f'    scales=config_dict.create(depth={_UNIFORM * fit.values[0]:.6f}),\n'
        ')\n'
    )
    lost = (
        'sigma(z): one value at all distances',
        'distribution: uniform, not normal',
        *common_losses(noise),
    )
    return Parameters(text, (('scales.depth', fit),), lost)


TARGET = ExportTarget(
    'mujoco_playground',
    'CAMERA_noise_config.py',
    'one sigma',
    'google-deepmind/mujoco_playground, August 2026: locomotion/go1/joystick.py, noise_config',
    write,
)
