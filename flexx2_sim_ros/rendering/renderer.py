"""Open a renderer of exact depth and surface ids: OpenGL where it works, else ray casting."""

from typing import Protocol

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.opengl import OpenGlRenderer
from flexx2_sim_ros.rendering.ray_caster import RayCaster
import mujoco
import numpy as np

BACKENDS = ('auto', 'egl', 'osmesa', 'ray')
# What each OpenGL backend needs, for the message when it does not work.
_NEEDS = {
    'egl': 'libEGL with a driver (Debian: libegl1 libgl1-mesa-dri)',
    'osmesa': 'libOSMesa (Debian: libosmesa6)',
}


class DepthRenderer(Protocol):
    """
    What `open_renderer` returns.

    Attributes
    ----------
    backend : str
        ``egl``, ``osmesa`` or ``ray``.
    reasons : tuple of str
        Why each better backend cannot be used; empty if this is the best one.

    """

    backend: str
    reasons: tuple[str, ...]

    def render(self, data: mujoco.MjData, camera: str) -> tuple[np.ndarray, np.ndarray]:
        """
        Render one camera.

        Parameters
        ----------
        data : mujoco.MjData
            A state of the model, complete up to its positions (``mj_forward`` or later).
        camera : str
            The camera's name.

        Returns
        -------
        depth : np.ndarray
            (H, W) float32, metres along the optical axis; NaN where there is no return before
            the far plane.
        geom_id : np.ndarray
            (H, W) int32, the visible geom, -1 for background.

        Raises
        ------
        InputError
            When the model has no such camera or it has other intrinsics.

        """

    def close(self) -> None:
        """Release the graphics context; `render` cannot be called after it."""


def open_renderer(
    model: mujoco.MjModel, intrinsics: Intrinsics, backend: str = 'auto'
) -> DepthRenderer:
    """
    Open the best renderer that works here.

    Parts of the robot that a camera can never see (`unseen_geoms`) are not rendered for it. An
    OpenGL renderer belongs to the thread that opened it and should be closed there; one that is
    dropped is closed. OpenGL draws round shapes with facets (``visual/quality`` in the model), so
    their depth is off by up to 0.6 % of their radius; the ray caster is exact. Where an object is
    nearer than the near plane, OpenGL sees through it, and the ray caster has no return.

    Parameters
    ----------
    model : mujoco.MjModel
        From `flexx2_sim_ros.robots.model.build_model`; copied, so later changes to it have no
        effect.
    intrinsics : Intrinsics
        Those that the model was built with.
    backend : str
        ``egl``, ``osmesa``, ``ray`` (``mj_multiRay``; no graphics library needed), or ``auto``:
        the first of them that works. Environment variables have no influence.

    Returns
    -------
    DepthRenderer

    Raises
    ------
    InputError
        For an unknown backend, or one that does not work here.

    """
    if backend not in BACKENDS:
        raise InputError(f'backend: must be one of {", ".join(BACKENDS)}, got {shown(backend)}')
    if backend == 'ray':
        return RayCaster(model, intrinsics, ())
    reasons: list[str] = []
    for name in ('egl', 'osmesa') if backend == 'auto' else (backend,):
        try:
            return OpenGlRenderer(model, intrinsics, name, tuple(reasons))
        except Exception as error:  # a missing or broken driver raises anything
            reasons.append(
                f'{name} does not work here, it needs {_NEEDS[name]} '
                f'[{type(error).__name__}: {error}]'
            )
    if backend != 'auto':
        raise InputError(f'backend: must be one that works here, or auto, got {reasons[0]}')
    return RayCaster(model, intrinsics, tuple(reasons))
