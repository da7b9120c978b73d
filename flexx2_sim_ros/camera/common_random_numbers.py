"""The same frames again and again, each time with other effects."""

from typing import Any

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.stages import measure
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.surfaces import usable_reflectivity
from flexx2_sim_ros.physics.frame_state import Common, FrameState, Memory
from flexx2_sim_ros.physics.philox import camera_key
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np


class CommonRandomNumbers:
    """
    A scene to be seen with many sets of effects and always the same random numbers.

    What the effects leave as it is (light, noise, edges) is worked out once; without ``sharing``
    nothing is kept, and the outcome is the same. The effects of `camera` will be changed.
    ``clean`` is (H, W) or (T, H, W) float32 metres, ``K`` the (3, 3) camera matrix, ``stamps``
    (T,) int64 nanoseconds, and ``reflectivity`` (H, W) or (T, H, W) float32 in 0..1; 1 everywhere
    when left out.
    """

    def __init__(
        self,
        camera: Camera,
        clean: np.ndarray,
        K: np.ndarray,  # noqa: N803
        stamps: np.ndarray,
        reflectivity: np.ndarray | None = None,
        sharing: bool = True,
    ) -> None:
        """Look at nothing yet."""
        self._camera = camera
        self._key = camera_key(camera.seed, camera.name)
        self._lens = Intrinsics.from_matrix(K, clean.shape[-1], clean.shape[-2])
        albedo = np.ones((1, 1), np.float32) if reflectivity is None else reflectivity
        albedo = on_images(usable_reflectivity)(albedo)
        still = clean.ndim == 2 and albedo.ndim == 2
        scene: dict[Any, Any] = {}
        self._frames = [
            (
                int(stamp),
                clean if clean.ndim == 2 else clean[t],
                albedo if albedo.ndim == 2 else albedo[t],
                Common(scene if still else {}) if sharing else None,
            )
            for t, stamp in enumerate(stamps)
        ]
        self._shape = (len(stamps), *clean.shape[-2:])

    def depth(self, effects: Any) -> np.ndarray:
        """
        Return what a camera that has just been switched on measures, with effects as for `Camera`.

        It is (T, H, W) float32 metres, NaN where invalid.
        """
        camera = self._camera
        camera.effects = effects
        memory = Memory()
        out = np.empty(self._shape, np.float32)
        for t, (stamp, clean, albedo, common) in enumerate(self._frames):
            state = FrameState(
                camera.mode,
                self._lens,
                stamp,
                self._key,
                memory,
                clean if common else clean.copy(),
                albedo,
                camera.exposure_share,
                common=common,
            )
            measure(state, camera.effects, camera.mode.noise.sigma_x)
            out[t] = state.measured
        return out
