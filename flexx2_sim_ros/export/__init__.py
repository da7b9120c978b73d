"""The noise of a camera, written as parameters of mappers and simulators."""

from collections.abc import Mapping
from types import MappingProxyType

from flexx2_sim_ros.export import (
    elevation_mapping,
    elevation_mapping_cupy,
    gazebo,
    isaac_lab,
    mujoco_playground,
    nvblox,
    octomap_server,
    rtabmap,
)
from flexx2_sim_ros.export.noise import MapperNoise, measure_noise
from flexx2_sim_ros.export.target import ExportTarget, Parameters

__all__ = ['TARGETS', 'MapperNoise', 'Parameters', 'ExportTarget', 'measure_noise']
# A file each.
TARGETS: Mapping[str, ExportTarget] = MappingProxyType(
    {
        target.name: target
        for target in (
            elevation_mapping.STRUCTURED_LIGHT,
            elevation_mapping.PERFECT,
            elevation_mapping_cupy.TARGET,
            octomap_server.TARGET,
            rtabmap.TARGET,
            nvblox.TARGET,
            gazebo.TARGET,
            isaac_lab.TARGET,
            mujoco_playground.TARGET,
        )
    }
)
