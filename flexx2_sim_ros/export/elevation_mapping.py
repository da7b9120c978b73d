"""ANYbotics elevation_mapping: sensor processors for structured light and for perfect sensors."""

from flexx2_sim_ros.export.fits import fit_structured_light
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters

_SOURCE = 'ANYbotics/elevation_mapping, November 2024: config/sensor_processors/*.yaml'


def write(noise: MapperNoise, cell: float) -> Parameters:
    """Write ``sigma = a + b (z - c)^2 + d z^e`` and ``sigma_lateral = factor z``, metres."""
    del cell
    fit = fit_structured_light(noise.distance, noise.typical)
    lines = [
        header(noise),
        'sensor_processor:',
        '  type: structured_light',
        f'  cutoff_min_depth: {noise.mode.range_min:.4g}',
        f'  cutoff_max_depth: {noise.mode.range_max:.4g}',
    ]
    lines += [
        f'  normal_factor_{letter}: {value:.6f}'
        for letter, value in zip('abcde', fit.values, strict=True)
    ]
    lines.append(f'  lateral_factor: {noise.lateral:.6f}')
    return Parameters(
        '\n'.join(lines) + '\n', (('normal_factor', fit),), common_losses(noise, lateral=True)
    )


def write_perfect(noise: MapperNoise, cell: float) -> Parameters:
    """Write the processor of a sensor without noise."""
    del cell
    text = f'{header(noise)}\nsensor_processor:\n  type: perfect\n'
    lost = ('noise: the map takes every point as exact', *common_losses(noise))
    return Parameters(text, (), lost)


STRUCTURED_LIGHT = ExportTarget(
    'elevation_mapping', 'CAMERA.yaml', 'sigma(z), sigma_x, range', _SOURCE, write
)
PERFECT = ExportTarget(
    'elevation_mapping_perfect', 'perfect.yaml', 'nothing', _SOURCE, write_perfect
)
