"""Frames with effects: what effects keep between frames, and the launches that make a frame."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import (
    dropout_kernels,
    effect_kernels,
    grain_kernels,
    kernels,
    memory_kernels,
    shift_kernels,
)
from flexx2_sim_ros.batch.effect_tables import Light, light_row
from flexx2_sim_ros.batch.geometry import SceneGeometry
from flexx2_sim_ros.batch.images import Images, launch, Rows
from flexx2_sim_ros.batch.light import PixelLight
from flexx2_sim_ros.batch.motion import SceneMotion
from flexx2_sim_ros.batch.surface_kernels import (
    depends_on_surfaces,
    scale_by_surface,
    surface_rows,
)
from flexx2_sim_ros.camera import Intrinsics, Mode, Profile
from flexx2_sim_ros.effects import Effect
import numpy as np
import warp as wp

# Effects whose kernels run only where an environment has one of them.
_SHIFTS_ALIKE = {'offset', 'warm_up_drift', 'fixed_pattern', 'amplitude_bias'}
_CHANGES_NOISE = {'excess_noise', 'ambient_light'}
_LOSES = {
    'low_signal_dropout': dropout_kernels.lose_dark,
    'grazing_dropout': dropout_kernels.lose_slanted,
    'saturation': dropout_kernels.lose_bright,
    'random_dropout': dropout_kernels.lose_at_random,
}


class BatchStages:
    """
    The stages of frames with effects, of all environments, for images of one size.

    Parameters
    ----------
    effects : sequence of sequence of Effect
        Of every environment, those that are on and have a kernel.
    latest_ns : int
        The longest latency that an environment may have, nanoseconds.
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
        latest_ns: int,
        profile: Profile,
        images: Images,
        rows: Rows,
        camera: Intrinsics,
    ) -> None:
        """Put the parameters on the device and allocate the images."""
        self.images = images
        self._rows, self._profile = rows, profile
        num_envs, device = len(effects), rows.stamps.device
        self._names = {effect.name for own in effects for effect in own}
        self._lights = wp.empty(num_envs, dtype=Light, device=device)
        self._surface_noise = (
            wp.zeros(num_envs, dtype=wp.vec3f, device=device)
            if depends_on_surfaces(profile.modes)
            else None
        )
        self._kept = self._memory(num_envs, device)
        self._seen = self._images_between(device)
        self._geometry = SceneGeometry(effects, latest_ns, profile, images, rows, camera)
        self._light = PixelLight(effects, profile, images, device)
        self._motion = (
            SceneMotion(num_envs, images, device) if 'motion_artefact' in self._names else None
        )
        for module in (dropout_kernels, effect_kernels, memory_kernels, shift_kernels):
            wp.load_module(module, device=device)
        if 'fixed_pattern' in self._names:
            self._make_grain(num_envs, images.height * images.width)

    def _memory(self, num_envs: int, device: Any) -> Any:
        kept = memory_kernels.Kept()
        kept.is_due = self._rows.is_due
        kept.was_reset = wp.ones(num_envs, dtype=wp.uint8, device=device)
        kept.is_first = wp.zeros(num_envs, dtype=wp.uint8, device=device)
        kept.started, kept.last, kept.before = (
            wp.zeros(num_envs, dtype=wp.int64, device=device) for _ in range(3)
        )
        size = num_envs * self.images.height * self.images.width
        kept.measured, kept.grain = (
            wp.zeros(size if name in self._names else 0, dtype=wp.float32, device=device)
            for name in ('temporal_filter', 'fixed_pattern')
        )
        return kept

    def _images_between(self, device: Any) -> Any:
        images, seen = self.images, memory_kernels.PassImages()
        pixels = images.count * images.height * images.width

        def zeros(size: int, used: bool = True) -> wp.array:
            return wp.zeros(size if used else 0, dtype=wp.float32, device=device)

        for name in ('facing', 'expected', 'measured', 'sigma', 'cosine', 'amplitude', 'depth'):
            setattr(seen, name, zeros(pixels))
        seen.filtered = zeros(pixels, 'spatial_filter' in self._names)
        seen.chances = zeros(images.count * images.blocks * 4, bool(self._names & set(_LOSES)))
        seen.normals = images.normals
        return seen

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """Put the numbers of the mode of every environment on the device."""
        rows = {mode.name: light_row(mode, self._profile) for mode in set(modes)}
        self._lights.assign(np.array([rows[mode.name] for mode in modes]))
        if self._surface_noise is not None:  # A captured graph reads the same memory again.
            self._surface_noise.assign(surface_rows(modes))

    def forget(self, mask: wp.array) -> None:
        """Reset the environments that a (N,) bool array on the device chooses."""
        launch(memory_kernels.forget, mask.size, mask, self._kept.was_reset)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments, and whether it has reflectivity."""
        stamps = self._rows.stamps
        launch(memory_kernels.begin, stamps.size, self._kept, stamps)
        self._geometry.begin(self._kept.is_first, with_reflectivity)
        self._light.begin(self._kept.is_first)

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
        surfaces = self._geometry.look(depth, reflectivity, first, count)
        self._find_light(surfaces, reflectivity is not None, first, count)
        self._shift(surfaces, first, count)
        self._measure(surfaces, first, count)
        self._finish(first, count, out)

    def _find_light(self, surfaces: Any, with_reflectivity: bool, first: int, count: int) -> None:
        images, seen = self.images, self._seen
        grid, chunk = images.grid(count)
        part = images.lens, first, chunk
        images.move_edges(first, count, self._rows)
        model = (self._rows.noise, seen.facing, seen.expected)
        launch(kernels.describe, grid, *images.surfaces, *part, *model)
        rows = self._rows
        self._light.find(
            surfaces, first, count, seen.facing, rows.effects, self._lights, rows.keys
        )
        if self._surface_noise is not None and with_reflectivity:
            factors = (self._surface_noise, seen.facing, seen.expected)
            launch(scale_by_surface, grid, surfaces, *part, *factors)

    def _shift(self, surfaces: Any, first: int, count: int) -> None:
        # What effects add to the light and the noise of each pixel's own surface.
        kept, seen, phasors = self._kept, self._seen, self._light.phasors
        grid, chunk = self.images.grid(count)
        part = self.images.lens, first, chunk, self._rows.effects
        if self._motion is not None:
            self._motion.shift_phases(
                surfaces,
                first,
                count,
                self._rows.effects,
                self._lights,
                self._rows.keys,
                kept,
                phasors,
            )
        if 'wiggling' in self._names:
            launch(shift_kernels.wiggle, grid, surfaces.p, *part, self._lights, phasors)
        if self._names & _SHIFTS_ALIKE:
            launch(shift_kernels.shift_alike, grid, *part, self._lights, kept, phasors)
        if self._names & _CHANGES_NOISE:
            launch(shift_kernels.change_noise, grid, surfaces, *part, phasors, seen)

    def _measure(self, surfaces: Any, first: int, count: int) -> None:
        images, rows, seen = self.images, self._rows, self._seen
        images.draw_normals(first, count, rows)
        random = rows.keys, rows.stamps
        if 'heavy_tails' in self._names:
            blocks, chunk = images.block_grid(count)
            pixels = images.height * images.width
            part = pixels, first, chunk, self._rows.effects
            launch(shift_kernels.widen_tails, blocks, *part, *random, seen)
        grid, chunk = images.grid(count)
        launch(
            effect_kernels.measure,
            grid,
            surfaces.p,
            images.lens,
            first,
            chunk,
            rows.noise,
            self._rows.effects,
            self._lights,
            *random,
            images.moved,
            self._light.phasors,
            seen,
        )

    def _finish(self, first: int, count: int, out: wp.array) -> None:
        rows, seen = self._rows, self._seen
        grid, chunk = self.images.grid(count)
        part = self.images.lens, first, chunk
        filtered = seen.measured
        if 'spatial_filter' in self._names:
            self.images.blank_measured(count, filtered)
            launch(effect_kernels.filter_neighbours, grid, *part, self._rows.effects, seen)
            filtered = seen.filtered
        if 'temporal_filter' in self._names:
            images = self._kept, filtered, seen
            launch(effect_kernels.filter_in_time, grid, *part, self._rows.effects, *images)
        launch(effect_kernels.finish, grid, *part, rows.noise, self._rows.effects, filtered, out)
        for name, lose in _LOSES.items():
            if name in self._names:
                launch(lose, grid, *part, self._rows.effects, rows.keys, rows.stamps, seen, out)

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
