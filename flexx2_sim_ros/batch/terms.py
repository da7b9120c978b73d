"""An observation term for Isaac Lab and mjlab: their depth images with this camera's noise."""

from typing import Any

from flexx2_sim_ros.batch.camera import BatchCamera
import numpy as np


def noisy_depth(base: type = object) -> type:
    """
    Make the class of an observation term.

    Managers of Isaac Lab and mjlab make ``func(cfg=term_cfg, env=env)``, call it with
    ``(env, **params)`` and reset it with ``reset(env_ids)``. ``examples/mjlab_go1.py`` is tested
    in mjlab 1.6. For Isaac Lab, which needs a GPU, a test binds the calls in the source of its
    releases 2.3.2 and 3.0.0 to this class, and runs their base class of terms and their checks.

    Parameters
    ----------
    base : type
        What class terms have to inherit from: ``ManagerTermBase`` of Isaac Lab; nothing in mjlab.

    Returns
    -------
    type
        Of terms whose ``params`` are ``depth``, a function of the environment that returns clean
        depth, (N, H, W) or (N, H, W, 1) float32, metres along the optical axis; and ``camera``,
        the arguments of `BatchCamera` by name. It returns the same shape; invalid is 0 unless
        ``camera`` says otherwise.

    Examples
    --------
    For a camera ``front`` in a scene of Isaac Lab::

        ObservationTermCfg(func=noisy_depth(ManagerTermBase), params={
            'depth': lambda env: env.scene['front'].data.output['distance_to_image_plane'].torch,
            'camera': {'usecase': 'Mode_5_30fps', 'effects': {'heavy_tails': None}}})

    Isaac Lab 2 gives tensors: leave ``.torch`` out there.

    """

    class NoisyDepth(base):  # type: ignore[misc]
        """Clean depth in, what a Flexx2 would have seen out."""

        def __init__(self, cfg: Any, env: Any) -> None:
            if base is not object:
                super().__init__(cfg, env)
            options = {
                'invalid_value': 'zero',
                'device': str(env.device),
                **(cfg.params.get('camera') or {}),  # Isaac Lab 3 fills in None
            }
            self._noise = BatchCamera(env.num_envs, **options)
            self._like: Any = None

        def __call__(self, env: Any, depth: Any, camera: Any = None) -> Any:
            """Return the environments' images with noise; they are the caller's to keep."""
            clean = self._like = depth(env)
            seen = self._noise(clean if clean.ndim == 3 else clean[..., 0]).reshape(clean.shape)
            return seen.clone() if hasattr(seen, 'clone') else seen.copy()

        def reset(self, env_ids: Any = None) -> None:
            """Forget what effects keep of these environments (all when left out)."""
            if self._like is not None:
                # A mask on the images' device, so that nothing waits for it.
                size = self._noise.num_envs
                mask = (
                    self._like.new_zeros(size).bool()
                    if hasattr(self._like, 'new_zeros')
                    else np.zeros(size, bool)
                )
                mask[slice(None) if env_ids is None else env_ids] = True
                self._noise.reset(mask)

    return NoisyDepth
