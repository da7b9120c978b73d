"""Isaac Lab: a Gaussian that is added to an observation, or multiplied with it."""

import math

from flexx2_sim_ros.export.fits import fit_constant, fit_power
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters


def write(noise: MapperNoise, cell: float) -> Parameters:
    """Write the one of ``add`` and ``scale`` that fits sigma better."""
    del cell
    added = fit_constant(noise.distance, noise.typical)
    scaled = fit_power(noise.distance, noise.typical, 1, 'a z')
    if abs(math.log(added.worst)) <= abs(math.log(scaled.worst)):
        fit, operation, mean = added, 'add', noise.mean_bias
    else:
        fit, operation, mean = scaled, 'scale', 1.0
    text = (
        f'{header(noise)}\n'
        'from isaaclab.utils.noise import GaussianNoiseCfg\n\n'
        'DEPTH_NOISE = GaussianNoiseCfg(\n'
        f'    mean={mean:.6f}, std={fit.values[0]:.6f}, operation={operation!r}\n'
        ')\n'
    )
    lost = (
        'sigma(z): one value at all distances'
        if operation == 'add'
        else 'sigma(z): proportional to distance only',
        *common_losses(noise, bias=operation == 'add'),
    )
    return Parameters(text, (('std', fit),), lost)


TARGET = ExportTarget(
    'isaac_lab',
    'CAMERA_depth_noise.py',
    'one sigma and mean bias, or sigma as a z',
    'isaac-sim/IsaacLab v2.3.2: isaaclab.utils.noise.noise_cfg.GaussianNoiseCfg',
    write,
)
