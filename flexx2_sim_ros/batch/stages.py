"""Frames with effects: what effects keep between frames, and the launches that make a frame."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import effect_kernels, kernels, light, motion
from flexx2_sim_ros.batch.geometry import SceneGeometry
from flexx2_sim_ros.batch.grain import make_grain
from flexx2_sim_ros.batch.history import needs_of
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.batch.timing import forget
from flexx2_sim_ros.effects import Effect
import warp as wp


class BatchStages:
    """
    The stages of frames with effects, of all environments, for images of one size.

    `effects` are of every environment, those that are on and have a kernel; `latest_ns` is the
    longest latency that an environment may have, nanoseconds.
    """

    def __init__(
        self, effects: Sequence[Sequence[Effect]], latest_ns: int, images: Images
    ) -> None:
        """Put the parameters on the device and allocate the images."""
        self.images = images
        num_envs, device = len(effects), images.device
        on = {effect.name for own in effects for effect in own}
        self._loses = [name for name in effect_kernels.LOSES if name in on]
        self._needs = needs_of(effects)
        modes = images.profile.modes
        self._depends_on_surfaces = any(mode.noise.surfaces is not None for mode in modes)
        self._allocate(num_envs, device)
        images.rows.was_reset.fill_(1)
        self._geometry = SceneGeometry(effects, latest_ns, images)
        self._light = light.PixelLight(effects, images)
        if 'motion' in self._needs:
            motion.prepare(images, num_envs)
        wp.load_module(effect_kernels, device=device)
        if 'grain' in self._needs:
            make_grain(images, num_envs)

    def _allocate(self, num_envs: int, device: Any) -> None:
        # What effects keep between frames, and the images between kernels.
        images, frame = self.images, self.images.frame
        kept = num_envs * images.height * images.width
        sizes = dict.fromkeys(
            ('facing', 'expected', 'measured', 'sigma', 'cosine', 'signal', 'depth'), images.pixels
        )
        sizes['kept'] = kept if 'measured' in self._needs else 0
        sizes['grain'] = kept if 'grain' in self._needs else 0
        sizes['chances'] = 4 * images.most * images.blocks if self._loses else 0
        for name, size in sizes.items():
            setattr(frame, name, wp.zeros(size, dtype=wp.float32, device=device))
        filters = 'neighbours' in self._needs
        frame.filtered = wp.zeros_like(frame.measured) if filters else frame.measured

    def forget(self, mask: wp.array) -> None:
        """Reset the environments that a (N,) bool array on the device chooses."""
        launch(forget, mask.size, mask, self.images.frame.was_reset)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments, and whether it has reflectivity."""
        frame = self.images.frame
        launch(effect_kernels.begin, frame.stamps.size, frame)
        self._geometry.begin(with_reflectivity)
        self._light.begin()

    def observe(self, depth: wp.array) -> None:
        """Make the frames of the pass, from (N * H * W,) float32 depth of all environments."""
        images, needs = self.images, self._needs
        self._geometry.look(depth)
        images.move_edges()
        images.each_pixel(kernels.describe)
        self._light.find()
        if self._depends_on_surfaces and images.frame.surfaces.reflectivity.size:
            images.each_pixel(light.scale_by_surface)
        # What effects add to the light and the noise of each pixel's own surface:
        if 'motion' in needs:
            motion.see(images)
        if 'taps' in needs:
            motion.shift(images)
        if 'harmonics' in needs:
            images.each_pixel(light.wiggle)
        if 'shift' in needs:
            images.each_pixel(light.shift_alike)
        if 'sigma' in needs:
            images.each_pixel(light.change_noise)
        images.draw_normals()
        if 'tails' in needs:
            images.each_block(light.widen_tails)
        images.each_pixel(effect_kernels.measure)
        # And to what each pixel sees:
        if 'neighbours' in needs:
            images.blank_measured()
            images.each_pixel(effect_kernels.filter_neighbours)
        if 'measured' in needs:
            images.each_pixel(effect_kernels.filter_in_time)
        images.each_pixel(effect_kernels.finish)
        for name in self._loses:
            images.each_pixel(effect_kernels.LOSES[name])
        if 'passing' in needs:
            images.each_pixel(motion.drop)
        if 'motion' in needs:
            images.each_pixel(motion.keep)
