"""elevation_mapping_cupy: one factor on the square of the distance."""

from flexx2_sim_ros.export.fits import fit_power
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters


def write(noise: MapperNoise, cell: float) -> Parameters:
    """
    Write ``noise = factor z^2``.

    Its kernels weigh points by this noise as by a variance, and compare it with heights in metres
    to find outliers. It is written as a standard deviation in metres: a variance would make
    outliers of all points.
    """
    del cell
    fit = fit_power(noise.distance, noise.typical, 2, 'a z^2')
    text = (
        f'{header(noise)}\n'
        f'sensor_noise_factor: {fit.values[0]:.6f}\n'
        f'min_valid_distance: {noise.mode.range_min:.4g}\n'
        f'max_ray_length: {noise.mode.range_max:.4g}\n'
    )
    return Parameters(text, (('sensor_noise_factor', fit),), common_losses(noise))


TARGET = ExportTarget(
    'elevation_mapping_cupy',
    'CAMERA_core_param.yaml',
    'sigma(z) as a z^2, range',
    'leggedrobotics/elevation_mapping_cupy, May 2025: config/core/core_param.yaml',
    write,
)
