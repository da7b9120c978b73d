"""Intrinsics error: a camera that is not what it is thought to be."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Term
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, Shape
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

_NAN = np.float32(np.nan)

_TYPICAL = {'focal': 0.005, 'cx': 0.7, 'cy': 0.7, 'k1': -0.01}


def _without(name: str) -> dict[str, float]:
    return {other: 0.0 for other in _TYPICAL if other != name}


@dataclass(frozen=True)
class IntrinsicsError(Effect):
    """A camera that is not what it is thought to be."""

    name: ClassVar[str] = 'intrinsics_error'
    stage: ClassVar[Stage] = Stage.GEOMETRY
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'wrong calibration: focal length, centre or distortion'
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude', 'edges')
    source: ClassVar[str] = (
        "the driver's grid is distorted and its camera_info says how; magnitudes are assumed"
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        Hypothesis(
            label,
            tuple(
                Term(
                    name,
                    (_TYPICAL[name],),
                    -10 * abs(_TYPICAL[name]),
                    10 * abs(_TYPICAL[name]),
                    fixed=_without(name),
                )
                for name in names
            ),
            dict.fromkeys(_TYPICAL, 0.0),
        )
        for label, names in (
            ('focal length', ('focal',)),
            ('centre', ('cx', 'cy')),
            ('distortion', ('k1',)),
            ('all', tuple(_TYPICAL)),
        )
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(
            'focal length, centre and distortion',
            (
                Free('focal', -0.1, 0.1),
                Free('cx', -20.0, 20.0),
                Free('cy', -20.0, 20.0),
                Free('k1', -0.3, 0.3),
                Free('aspect', -0.1, 0.1),
                Free('p1', -0.05, 0.05),
                Free('p2', -0.05, 0.05),
            ),
        ),
    )
    smooth: ClassVar[bool] = True
    like_a_pose: ClassVar[tuple[Mapping[str, float], ...]] = tuple(
        {**dict.fromkeys(_TYPICAL, 0.0), name: value} for name, value in _TYPICAL.items()
    )
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'lens'
    compared: ClassVar[str] = 'focal'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'radius'),)
    picture: ClassVar[Picture] = Picture('along_row')
    batched: ClassVar[tuple[str, ...] | None] = ('view',)

    focal: float = parameter(0.005, -0.2, 0.2, '', 'relative error of the focal lengths')
    cx: float = parameter(0.7, -20.0, 20.0, 'px', 'true principal point, to the right')
    cy: float = parameter(0.7, -20.0, 20.0, 'px', 'true principal point, down')
    k1: float = parameter(-0.01, -0.5, 0.5, '', 'plumb_bob, radial, r^2')
    k2: float = parameter(0.0, -0.5, 0.5, '', 'plumb_bob, radial, r^4')
    p1: float = parameter(0.0, -0.1, 0.1, '', 'plumb_bob, tangential, down')
    p2: float = parameter(0.0, -0.1, 0.1, '', 'plumb_bob, tangential, across')
    k3: float = parameter(0.0, -0.5, 0.5, '', 'plumb_bob, radial, r^6')
    aspect: float = parameter(0.0, -0.2, 0.2, '', 'relative error of fy beyond that of fx')

    def true_camera(self, believed: Intrinsics) -> Intrinsics:
        """Return what the camera is when it is thought to be ``believed``."""
        s = self.strength
        return replace(
            believed,
            fx=believed.fx * (1 + s * self.focal),
            fy=believed.fy * (1 + s * (self.focal + self.aspect)),
            cx=believed.cx + s * self.cx,
            cy=believed.cy + s * self.cy,
            distortion=(s * self.k1, s * self.k2, s * self.p1, s * self.p2, s * self.k3),
        )

    def apply(self, state: FrameState) -> None:
        """See the scene along the true rays."""
        believed = state.intrinsics
        true = self.true_camera(believed)
        kept = state.memory.kept.get(self.name)
        if kept is None or kept.camera != true or kept.source != believed:
            kept = state.memory.kept[self.name] = Reprojection(
                true, believed, sensor=state.mode.sensor
            )
        lost = np.isnan(kept.rays[0])  # Bent so much that no light comes there.
        state.depth = np.where(lost, _NAN, kept.depth(state.depth))
        if state.reflectivity.size > 1:
            state.reflectivity = kept.reflectivity(state.reflectivity)
