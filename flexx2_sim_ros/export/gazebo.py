"""Gazebo: the noise of a depth camera in SDF is one Gaussian."""

import math
import re

from flexx2_sim_ros.export.fits import fit_constant
from flexx2_sim_ros.export.noise import MapperNoise
from flexx2_sim_ros.export.target import (
    common_losses,
    ExportTarget,
    header,
    identifier,
    Parameters,
)


def write(noise: MapperNoise, cell: float) -> Parameters:
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


TARGET = ExportTarget(
    'gazebo',
    'CAMERA.sdf',
    'one sigma, mean bias, range, lens, rate',
    'gazebosim/sdformat, August 2026: sdf/1.10/camera.sdf, noise.sdf; gz-sensors: depth shader',
    write,
)
