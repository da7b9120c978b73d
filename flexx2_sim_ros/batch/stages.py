"""Frames with effects: what effects keep between frames, and the launches that make a frame."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import effect_kernels, geometry_kernels, grain_kernels, kernels
from flexx2_sim_ros.batch.effect_formulas import Surfaces
from flexx2_sim_ros.batch.effect_tables import Effects, effects_row, Light, light_row
from flexx2_sim_ros.batch.history import each_with, FrameHistory
from flexx2_sim_ros.batch.images import Images, launch, Rows
from flexx2_sim_ros.batch.light import PixelLight
from flexx2_sim_ros.batch.surface_kernels import (
    depends_on_surfaces,
    scale_by_surface,
    surface_rows,
)
from flexx2_sim_ros.camera import Intrinsics, Mode, Profile
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import Reprojection
import numpy as np
import warp as wp

_MOST_VIEWS = 64  # of intrinsics_error; each takes three numbers a pixel


class Development:
    """
    The effects of all environments, for images of one size.

    Parameters
    ----------
    effects : sequence of sequence of Effect
        Of every environment, those that are on.
    profile : Profile
    images : Images
    rows : Rows
    camera : Intrinsics
        Of the depth images.

    Attributes
    ----------
    images : Images
        As given.

    """

    def __init__(
        self,
        effects: Sequence[Sequence[Effect]],
        profile: Profile,
        images: Images,
        rows: Rows,
        camera: Intrinsics,
    ) -> None:
        """Put the parameters on the device and allocate the images."""
        self.images = images
        self._rows, self._profile = rows, profile
        num_envs, device = len(effects), rows.stamps.device
        needs = {need for own in effects for effect in own for need in effect.batched or ()}
        self._keeps_surfaces = 'surfaces' in needs
        self._filters = 'neighbours' in needs
        self._effects = wp.array(
            np.array([effects_row(own) for own in effects]), dtype=Effects, device=device
        )
        self._lights = wp.empty(num_envs, dtype=Light, device=device)
        self._surface_noise: wp.array | None = None

        def zeros(envs: int, used: bool = True, dtype: Any = wp.float32) -> wp.array:
            size = images.height * images.width
            return wp.zeros(envs * size if used else 0, dtype=dtype, device=device)

        kept = self._kept = effect_kernels.Kept()
        kept.fresh = wp.ones(num_envs, dtype=wp.uint8, device=device)
        kept.young = wp.zeros(num_envs, dtype=wp.uint8, device=device)
        kept.started, kept.last, kept.before = (
            wp.zeros(num_envs, dtype=wp.int64, device=device) for _ in range(3)
        )
        kept.depth = zeros(num_envs, self._keeps_surfaces)
        kept.reflectivity = zeros(num_envs, self._keeps_surfaces)
        kept.measured = zeros(num_envs, 'measured' in needs)
        kept.grain = zeros(num_envs, 'grain' in needs)
        seen = self._seen = effect_kernels.Seen()
        (
            seen.facing,
            seen.expected,
            seen.measured,
            seen.sigma,
            seen.cosine,
            seen.amplitude,
            seen.depth,
        ) = (zeros(images.count) for _ in range(7))
        seen.filtered = zeros(images.count, self._filters)
        self._poses = _poses(effects, device) if 'pose' in needs else None
        self._views = _views(effects, camera, device) if 'view' in needs else None
        # What the effects of geometry see: the first one and the second one.
        self._looked = [
            (zeros(images.count), zeros(images.count))
            for used in (self._poses, self._views)
            if used
        ]
        self._history = (
            FrameHistory(effects, profile, images, device) if 'history' in needs else None
        )
        self._light = PixelLight(effects, profile, images, device)
        self._nothing = zeros(0)
        wp.load_module(effect_kernels, device=device)
        if self._looked:
            wp.load_module(geometry_kernels, device=device)
        if 'grain' in needs:
            self._make_grain(num_envs, images.height * images.width)

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """Take notice of the mode of every environment."""
        rows = {mode.name: light_row(mode, self._profile) for mode in set(modes)}
        self._lights.assign(np.array([rows[mode.name] for mode in modes]))
        self._surface_noise = (
            surface_rows(modes, self._lights.device) if depends_on_surfaces(modes) else None
        )

    def forget(self, mask: wp.array) -> None:
        """Start the environments afresh that a (N,) bool array on the device says."""
        launch(effect_kernels.forget, mask.size, mask, self._kept.fresh)

    def begin(self, with_reflectivity: bool) -> None:
        """Take notice of a new frame in all environments, and whether it has reflectivity."""
        stamps = self._rows.stamps
        launch(effect_kernels.begin, stamps.size, self._kept, stamps)
        if self._history is not None:
            self._history.begin(self._kept.young, stamps, with_reflectivity)
        self._light.begin(self._kept.young)

    def observe(
        self, depth: wp.array, reflectivity: wp.array | None, first: int, count: int, out: wp.array
    ) -> None:
        """
        Make the frames of some environments.

        Parameters
        ----------
        depth, reflectivity : warp.array
            (N * H * W,) float32, of all environments.
        first, count : int
            Which environments.
        out : warp.array
            (N * H * W,) float32, of all environments.

        """
        images, rows, kept, seen = self.images, self._rows, self._kept, self._seen
        grid, chunk = images.grid(count)
        threads = (count, images.height, images.width)
        surfaces = Surfaces()
        surfaces.p, surfaces.jumps = images.surfaces
        surfaces.reflectivity = self._nothing if reflectivity is None else reflectivity
        surfaces.first_of_reflectivity = first
        first_of_depth = first
        if self._looked or self._history is None:
            images.find_surfaces(depth, first, count)
        looked = iter(self._looked)
        if self._poses:
            seen_depth, seen_reflectivity = next(looked)
            launch(
                geometry_kernels.look_from,
                threads,
                surfaces,
                images.lens,
                first,
                self._poses,
                seen_depth,
                seen_reflectivity,
            )
            self._look_again(surfaces, seen_depth, seen_reflectivity, count)
            depth, first_of_depth = seen_depth, 0
        if self._views:
            seen_depth, seen_reflectivity = next(looked)
            launch(
                geometry_kernels.look_up,
                threads,
                surfaces,
                images.lens,
                first,
                *self._views,
                seen_depth,
                seen_reflectivity,
            )
            self._look_again(surfaces, seen_depth, seen_reflectivity, count)
            depth, first_of_depth = seen_depth, 0
        if self._history is not None:
            depth, seen_reflectivity = self._history.look_back(
                depth, first_of_depth, surfaces, first, count
            )
            images.find_surfaces(depth, 0, count)
            if seen_reflectivity.size:
                surfaces.reflectivity, surfaces.first_of_reflectivity = seen_reflectivity, 0
        images.move_edges(first, count, rows)
        launch(
            kernels.describe,
            grid,
            *images.surfaces,
            images.lens,
            first,
            chunk,
            rows.noise,
            seen.facing,
            seen.expected,
        )
        self._light.find(surfaces, first, count, seen.facing, self._effects, self._lights)
        if self._surface_noise is not None and reflectivity is not None:
            launch(
                scale_by_surface,
                grid,
                surfaces,
                images.lens,
                first,
                chunk,
                self._surface_noise,
                seen.facing,
                seen.expected,
            )
        seen.normals = images.draw_normals(first, count, rows)
        launch(
            effect_kernels.measure,
            grid,
            surfaces,
            images.lens,
            first,
            chunk,
            rows.noise,
            self._effects,
            self._lights,
            rows.keys,
            rows.stamps,
            kept,
            images.moved,
            self._light.phasors,
            seen,
        )
        if self._filters:
            launch(
                effect_kernels.filter_neighbours,
                grid,
                images.lens,
                first,
                chunk,
                self._effects,
                seen,
            )
        launch(
            effect_kernels.finish,
            grid,
            images.lens,
            first,
            chunk,
            rows.noise,
            self._effects,
            rows.keys,
            rows.stamps,
            kept,
            seen.filtered if self._filters else seen.measured,
            seen,
            out,
        )
        if self._keeps_surfaces:
            launch(effect_kernels.keep_surfaces, grid, surfaces, images.lens, first, chunk, kept)

    def _look_again(
        self, surfaces: Any, depth: wp.array, reflectivity: wp.array, count: int
    ) -> None:
        self.images.find_surfaces(depth, 0, count)
        if surfaces.reflectivity.size:
            surfaces.reflectivity = reflectivity
            surfaces.first_of_reflectivity = 0

    def _make_grain(self, num_envs: int, pixels: int) -> None:
        images, grain = self.images, self._kept.grain
        white = wp.empty_like(grain)
        with wp.ScopedDevice(grain.device):
            launch(
                grain_kernels.white_noise,
                (num_envs, (pixels + 3) // 4),
                pixels,
                self._rows.keys,
                white,
            )
            launch(
                grain_kernels.less_its_mean,
                (num_envs, images.height, images.width),
                white,
                images.lens,
                grain,
            )
            launch(grain_kernels.to_unit_variance, num_envs, pixels, grain)


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
