"""The noise of a camera as parameters of simulators."""

import math
import re

from flexx2_sim_ros.export.export_target import (
    common_losses,
    ExportTarget,
    header,
    identifier,
    Parameters,
)
from flexx2_sim_ros.export.fits import fit_constant, fit_power
from flexx2_sim_ros.export.mapper_noise import MapperNoise

_UNIFORM = math.sqrt(3.0)  # half-width of a uniform distribution with a sigma of 1


def _write_gazebo(noise: MapperNoise, cell: float) -> Parameters:
    """Write a sensor with the image, range, rate and lens of the camera, and constant noise."""
    del cell
    fit = fit_constant(noise.distance, noise.typical)
    lens, mode = noise.profile.intrinsics, noise.mode
    view = 2.0 * math.atan(lens.width / (2.0 * lens.fx))
    name = identifier(noise.profile)
    comment = re.sub('-(?=-)', '- ', header(noise, ''))  # A comment must not have two in a row.
    text = f"""<?xml version="1.0"?>
<!--{comment} -->
<sdf version="1.10">
  <model name="{name}">
    <link name="{name}_link">
      <sensor name="{name}" type="depth_camera">
        <update_rate>{mode.rate_hz:g}</update_rate>
        <camera>
          <horizontal_fov>{view:.6f}</horizontal_fov>
          <image>
            <width>{lens.width}</width>
            <height>{lens.height}</height>
            <format>R_FLOAT32</format>
          </image>
          <clip>
            <near>{mode.range_min:g}</near>
            <far>{mode.range_max:g}</far>
          </clip>
          <noise>
            <type>gaussian</type>
            <mean>{noise.mean_bias:.6f}</mean>
            <stddev>{fit.values[0]:.6f}</stddev>
          </noise>
        </camera>
      </sensor>
    </link>
  </model>
</sdf>
"""
    lost = (
        'sigma(z): Gazebo has one sigma at all distances',
        'direction: Gazebo adds the noise to x, y and z of a point, not along its ray',
        *common_losses(noise, bias=True),
    )
    return Parameters(text, (('stddev', fit),), lost)


GAZEBO = ExportTarget(
    'gazebo',
    'CAMERA.sdf',
    'one sigma, mean bias, range, lens, rate',
    'gazebosim/sdformat, August 2026: sdf/1.10/camera.sdf, noise.sdf; gz-sensors: depth shader',
    _write_gazebo,
)


def _write_isaac_lab(noise: MapperNoise, cell: float) -> Parameters:
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


ISAAC_LAB = ExportTarget(
    'isaac_lab',
    'CAMERA_depth_noise.py',
    'one sigma and mean bias, or sigma as a z',
    'isaac-sim/IsaacLab v2.3.2: isaaclab.utils.noise.noise_cfg.GaussianNoiseCfg',
    _write_isaac_lab,
)


def _write_mujoco_playground(noise: MapperNoise, cell: float) -> Parameters:
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


MUJOCO_PLAYGROUND = ExportTarget(
    'mujoco_playground',
    'CAMERA_noise_config.py',
    'one sigma',
    'google-deepmind/mujoco_playground, August 2026: locomotion/go1/joystick.py, noise_config',
    _write_mujoco_playground,
)
