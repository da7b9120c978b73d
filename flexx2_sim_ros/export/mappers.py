"""The noise of a camera as parameters of mappers."""

import math

from flexx2_sim_ros.export.export_target import (
    common_losses,
    ExportTarget,
    header,
    Parameters,
    reach,
)
from flexx2_sim_ros.export.fits import fit_constant, fit_power, fit_structured_light, within
from flexx2_sim_ros.export.mapper_noise import MapperNoise
import numpy as np

_SOURCE = 'ANYbotics/elevation_mapping, November 2024: config/sensor_processors/*.yaml'
_LEAST, _MOST = 0.51, 0.97  # a hit below 0.5 would clear a cell; the server's own upper clamp
_SIGMAS = 3.0  # that the truncation distance holds
_LEAST_CELLS = 4.0  # nvblox's own default


def _write_structured_light(noise: MapperNoise, cell: float) -> Parameters:
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


def _write_perfect(noise: MapperNoise, cell: float) -> Parameters:
    """Write the processor of a sensor without noise."""
    del cell
    text = f'{header(noise)}\nsensor_processor:\n  type: perfect\n'
    lost = ('noise: the map takes every point as exact', *common_losses(noise))
    return Parameters(text, (), lost)


STRUCTURED_LIGHT = ExportTarget(
    'elevation_mapping',
    'CAMERA.yaml',
    'sigma(z), sigma_x, range',
    _SOURCE,
    _write_structured_light,
)
PERFECT = ExportTarget(
    'elevation_mapping_perfect', 'perfect.yaml', 'nothing', _SOURCE, _write_perfect
)


def _write_elevation_mapping_cupy(noise: MapperNoise, cell: float) -> Parameters:
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


ELEVATION_MAPPING_CUPY = ExportTarget(
    'elevation_mapping_cupy',
    'CAMERA_core_param.yaml',
    'sigma(z) as a z^2, range',
    'leggedrobotics/elevation_mapping_cupy, May 2025: config/core/core_param.yaml',
    _write_elevation_mapping_cupy,
)


def _write_octomap_server(noise: MapperNoise, cell: float) -> Parameters:
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


OCTOMAP_SERVER = ExportTarget(
    'octomap_server',
    'octomap_server.yaml',
    'probability of a hit, range',
    'OctoMap/octomap_mapping, branch ros2: octomap_server/src/octomap_server.cpp',
    _write_octomap_server,
)


def _write_rtabmap(noise: MapperNoise, cell: float) -> Parameters:
    """Write the range in which sigma is at most half a cell."""
    near = noise.mode.range_min
    far, unusable = reach(noise, cell)
    lines = [header(noise, ';'), '[Core]', f'Grid\\CellSize = {cell:g}']
    for group in ('Grid\\Range', 'Icp\\Range'):
        lines += [f'{group}Min = {near:.4g}', f'{group}Max = {far:.4g}']
    for group in ('Kp', 'Vis'):
        lines += [f'{group}\\MinDepth = {near:.4g}', f'{group}\\MaxDepth = {far:.4g}']
    lost = (
        'sigma(z): rtabmap has no noise model; points are cut off where sigma exceeds half a cell',
        *unusable,
        *common_losses(noise),
    )
    return Parameters('\n'.join(lines) + '\n', (), lost)


RTABMAP = ExportTarget(
    'rtabmap',
    'rtabmap.ini',
    'range',
    'introlab/rtabmap, July 2026: corelib/include/rtabmap/core/Parameters.h, data/presets/*.ini; '
    'issue 638: no noise model',
    _write_rtabmap,
)


def _write_nvblox(noise: MapperNoise, cell: float) -> Parameters:
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


NVBLOX = ExportTarget(
    'nvblox',
    'nvblox_CAMERA.yaml',
    'sigma(z) as a z, range',
    'NVIDIA-ISAAC-ROS/isaac_ros_nvblox, March 2026: config/nvblox/nvblox_base.yaml, '
    'mapper_initialization.cpp',
    _write_nvblox,
)
