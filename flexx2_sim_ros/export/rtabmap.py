"""rtabmap: it has no noise model, only ranges and a filter."""

from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import common_losses, ExportTarget, header, Parameters, reach


def write(noise: MapperNoise, cell: float) -> Parameters:
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


TARGET = ExportTarget(
    'rtabmap',
    'rtabmap.ini',
    'range',
    'introlab/rtabmap, July 2026: corelib/include/rtabmap/core/Parameters.h, data/presets/*.ini; '
    'issue 638: no noise model',
    write,
)
