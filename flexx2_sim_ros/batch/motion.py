"""The effect motion_artefact in a batch: what moves between two frames."""

from typing import Any

from flexx2_sim_ros.batch import motion_kernels
from flexx2_sim_ros.batch.images import Images, launch
import warp as wp


class SceneMotion:
    """
    Memory for the frame before, and the launches that shift the phases of what moves.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    images : Images
    device : warp.Device

    """

    def __init__(self, num_envs: int, images: Images, device: Any) -> None:
        """Allocate the memory."""
        self._images = images
        pixels = images.height * images.width

        def zeros(envs: int) -> wp.array:
            return wp.zeros(envs * pixels, dtype=wp.float32, device=device)

        motion = self._motion = motion_kernels.Motion()
        motion.depth, motion.reflectivity = zeros(num_envs), zeros(num_envs)
        for name in (
            'late',
            'late_reflectivity',
            'across',
            'down',
            'start',
            'gain',
            'other',
            'light',
            'when',
        ):
            setattr(motion, name, zeros(images.count))
        wp.load_module(motion_kernels, device=device)

    def shift_phases(
        self,
        surfaces: Any,
        first: int,
        count: int,
        effects: wp.array,
        lights: wp.array,
        keys: wp.array,
        kept: Any,
        phasors: Any,
    ) -> None:
        """
        Shift the phases of some environments, and keep their frames.

        Parameters
        ----------
        surfaces : Surfaces
            Of these environments.
        first, count : int
            Which.
        effects, lights, keys : warp.array
            `Effects`, `Light` and vec2ui of all environments.
        kept : Kept
            For the stamps of all environments.
        phasors : light_kernels.Phasors
            Of the pass; its shifts change.

        """
        grid, chunk = self._images.grid(count)
        place = self._images.lens, first, chunk
        rows = effects, lights
        launch(motion_kernels.look, grid, surfaces, *place, self._motion)
        launch(motion_kernels.mark_edges, grid, *place, self._motion)
        launch(motion_kernels.find_motion, grid, *place, *rows, keys, kept, self._motion)
        for kernel in (motion_kernels.shift_phases, motion_kernels.unwrap):
            launch(kernel, grid, *place, *rows, kept, self._motion, phasors)
        launch(motion_kernels.keep, grid, *place, kept, self._motion)
