"""The noise of a camera, written as parameters of mappers and simulators."""

from collections.abc import Mapping
from types import MappingProxyType

from flexx2_sim_ros.export import mappers, simulators
from flexx2_sim_ros.export.export_target import ExportTarget, Parameters
from flexx2_sim_ros.export.mapper_noise import MapperNoise, measure_noise

__all__ = ['TARGETS', 'MapperNoise', 'Parameters', 'ExportTarget', 'measure_noise']
TARGETS: Mapping[str, ExportTarget] = MappingProxyType(
    {
        target.name: target
        for target in (
            mappers.STRUCTURED_LIGHT,
            mappers.PERFECT,
            mappers.ELEVATION_MAPPING_CUPY,
            mappers.OCTOMAP_SERVER,
            mappers.RTABMAP,
            mappers.NVBLOX,
            simulators.GAZEBO,
            simulators.ISAAC_LAB,
            simulators.MUJOCO_PLAYGROUND,
        )
    }
)
