"""
Compile the camera's kernels before the first image needs them.

numba keeps what it has compiled beside the package, or, where that cannot be written, in the
user's cache folder, or in ``NUMBA_CACHE_DIR``. Damaged files are replaced.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from numba.core.event import Event, install_listener, Listener
import numpy as np


class _FirstTime(Listener):
    """Say something when the first kernel is compiled."""

    def __init__(self, say: Callable[[], None]) -> None:
        self._say: Callable[[], None] | None = say

    def on_start(self, event: Event) -> None:
        if self._say is not None:
            self._say()
            self._say = None

    def on_end(self, event: Event) -> None:
        pass


@contextmanager
def compiling_said(say: Callable[[], None]) -> Iterator[None]:
    """
    Call a function once, before the first compilation inside the block starts.

    Nothing is compiled, and nothing is said, when all kernels come from the cache.
    """
    with install_listener('numba:compile', _FirstTime(say)):
        yield


def warm_up(camera: Camera, intrinsics: Intrinsics) -> None:
    """
    Compile or load what a camera needs, by taking two images with a camera of its own.

    `camera` gives mode, profile and effects; its own state stays as it is.
    """
    scene = np.full((intrinsics.height, intrinsics.width), 1.0, np.float32)
    scene[: intrinsics.height // 2] = 2.0
    # Effects remember: hence a camera of its own.
    Camera(camera.usecase, profile=camera.profile, effects=camera.effects).capture(
        np.stack([scene, scene * np.float32(1.01)]), intrinsics.matrix, np.arange(2) * 10**7
    )
    other = Intrinsics(8, 8, 4.0, 4.0, 3.5, 3.5)
    Reprojection(intrinsics, other, sensor=camera.mode.sensor).depth(np.ones((8, 8), np.float32))
