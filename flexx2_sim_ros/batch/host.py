"""Environments whose effects have no kernel: one `Camera` after the other, on the CPU."""

from collections.abc import Mapping, Sequence
import logging
from typing import Any

from flexx2_sim_ros.camera import Camera, Intrinsics, Mode, Profile
from flexx2_sim_ros.effects import Effect
import numpy as np
import warp as wp

_log = logging.getLogger(__name__)


def without_kernel(effects: Sequence[Effect]) -> list[str]:
    """Return the names of the effects that no kernel computes."""
    return [effect.name for effect in effects if not effect.has_kernel]


class HostCameras:
    """
    The cameras of some environments: those in `effects`, by environment.

    `modes` and `seeds` are of all environments.
    """

    def __init__(
        self,
        effects: Mapping[int, Sequence[Effect]],
        modes: Sequence[Mode],
        seeds: Sequence[int],
        name: str,
        profile: Profile,
    ) -> None:
        """Make the cameras, and log which effects have no kernel."""
        self._cameras = {
            i: Camera(modes[i].name, profile=profile, effects=own, seed=seeds[i], name=name)
            for i, own in effects.items()
        }
        names = {one for own in effects.values() for one in without_kernel(own)}
        if names:
            _log.warning(
                'effects: %s: no kernel, %d environments are computed one after the other on the '
                'CPU',
                ', '.join(sorted(names)),
                len(effects),
            )

    def __len__(self) -> int:
        """Return how many environments these are."""
        return len(self._cameras)

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """Set the modes of all environments; a camera whose mode changes is reset."""
        for i, camera in self._cameras.items():
            if camera.mode != modes[i]:
                self._cameras[i] = Camera(
                    modes[i].name,
                    profile=camera.profile,
                    effects=camera.effects,
                    seed=camera.seed,
                    name=camera.name,
                )

    def forget(self, mask: np.ndarray) -> None:
        """Forget what effects keep in the environments that a (N,) bool array chooses."""
        for i, camera in self._cameras.items():
            if mask[i]:
                camera.reset()

    def look(
        self,
        depth: wp.array,
        reflectivity: wp.array | None,
        stamps: wp.array,
        lens: Intrinsics,
        is_due: wp.array,
    ) -> dict[int, np.ndarray]:
        """
        Return the frames of the environments that take one: (H, W) float32 metres, NaN if invalid.

        `depth` and `reflectivity` are (N * H * W,) float32, of all environments, on any device;
        `stamps` (N,) int64 nanoseconds; `is_due` (N,) uint8, 1 where an environment takes a frame.
        """
        shape = lens.height, lens.width
        pixels, matrix = lens.height * lens.width, lens.matrix
        moments, takes = stamps.numpy(), is_due.numpy()

        def image(of: Any, i: int) -> np.ndarray:
            return of[i * pixels : (i + 1) * pixels].numpy().reshape(shape)

        return {
            i: camera.capture(
                image(depth, i),
                matrix,
                moments[i],
                None if reflectivity is None else image(reflectivity, i),
            ).depth
            for i, camera in self._cameras.items()
            if takes[i]
        }


def write_frames(frames: Mapping[int, np.ndarray], invalid: float, out: wp.array) -> None:
    """Write frames of environments to (N * H * W,) float32 on any device."""
    for i, frame in frames.items():
        flat = np.where(np.isnan(frame), np.float32(invalid), frame).ravel()
        source = wp.array(flat, dtype=wp.float32, device='cpu', copy=False)
        wp.copy(out, source, dest_offset=i * flat.size, count=flat.size)
