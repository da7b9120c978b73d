"""Effects in a batch on what each pixel sees: pose_error, intrinsics_error and time_offset."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import geometry_kernels
from flexx2_sim_ros.batch.history import each_with, FrameHistory
from flexx2_sim_ros.batch.images import Images, launch, Rows
from flexx2_sim_ros.camera import Intrinsics, Profile
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import Reprojection
import numpy as np
import warp as wp

_MOST_VIEWS = 64  # of intrinsics_error; each takes three numbers a pixel


class SceneGeometry:
    """
    What the environments of a pass see, after the effects of geometry and time.

    `effects` are of every environment, those that are on; `latest_ns` is the longest latency that
    an environment may have, nanoseconds; `camera` is of the depth images.
    """

    def __init__(
        self,
        effects: Sequence[Sequence[Effect]],
        latest_ns: int,
        profile: Profile,
        images: Images,
        rows: Rows,
        camera: Intrinsics,
    ) -> None:
        """Put the parameters on the device and allocate the images."""
        device = rows.stamps.device
        self._images = images
        needs = {need for own in effects for effect in own for need in effect.batched or ()}

        def image() -> wp.array:
            return wp.zeros(images.pixels, dtype=wp.float32, device=device)

        # Each kernel with its parameters, and its own images of depth and reflectivity.
        self._steps: list[tuple[Any, tuple[Any, ...], wp.array, wp.array]] = []
        if 'pose' in needs:
            poses = (_poses(effects, device),)
            self._steps.append((geometry_kernels.look_from, poses, image(), image()))
        if 'view' in needs:
            views = _views(effects, camera, device)
            self._steps.append((geometry_kernels.look_up, views, image(), image()))
        self._history = (
            FrameHistory(effects, latest_ns, profile, images, rows) if 'history' in needs else None
        )
        if self._steps:
            wp.load_module(geometry_kernels, device=device)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments; see `FrameHistory.begin`."""
        if self._history is not None:
            self._history.begin(with_reflectivity)

    def look(self, depth: wp.array) -> None:
        """Find the surfaces that the environments of the pass see, from all clean depth."""
        images, frame = self._images, self._images.frame
        first = frame.first
        if self._steps or self._history is None:
            images.find_surfaces(depth, first)
        threads = (images.count, images.height, images.width)
        for kernel, parameters, *seen in self._steps:
            launch(kernel, threads, frame, *parameters, *seen)
            depth, first = seen[0], 0
            self._show(*seen)
        if self._history is not None:
            self._show(*self._history.look_back(depth, first))

    def _show(self, depth: wp.array, reflectivity: wp.array) -> None:
        # What the environments of the pass see from now on.
        self._images.find_surfaces(depth, 0)
        frame = self._images.frame
        if frame.surfaces.reflectivity.size and reflectivity.size:
            frame.surfaces.reflectivity, frame.surfaces.first_of_reflectivity = reflectivity, 0


def _poses(effects: Sequence[Sequence[Effect]], device: Any) -> wp.array:
    layout = np.dtype(geometry_kernels.Pose.numpy_dtype())  # type: ignore
    rows: Any = np.zeros(len(effects), layout)
    for row, own in zip(rows, effects, strict=True):
        for effect in own:
            if 'pose' in (effect.batched or ()):
                row['moved'] = 1
                row['rotation'], row['step'] = effect.motion()  # type: ignore[attr-defined]
    return wp.array(rows, dtype=geometry_kernels.Pose, device=device)


def _views(
    effects: Sequence[Sequence[Effect]], camera: Intrinsics, device: Any
) -> tuple[wp.array, ...]:
    chosen = each_with('view', effects)
    different = list({effect: None for effect in chosen if effect is not None})
    if len(different) > _MOST_VIEWS:
        raise InputError(
            f'effects: {different[0].name}: must have at most {_MOST_VIEWS} different sets of '
            f'parameters in a batch, got {len(different)}'
        )
    lines = [Reprojection(effect.true_camera(camera), camera).lines for effect in different]
    index, du, dv = (np.concatenate(parts) for parts in zip(*lines, strict=True))
    views = np.array([-1 if effect is None else different.index(effect) for effect in chosen])
    return (
        wp.array(views, dtype=wp.int32, device=device),
        wp.array(index, dtype=wp.int32, device=device),
        *(wp.array(part, dtype=wp.float32, device=device) for part in (du, dv)),
    )
