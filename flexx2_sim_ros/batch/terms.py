"""An observation term for Isaac Lab and mjlab: their depth images with this camera's noise."""

from functools import cache
import pkgutil
from typing import Any

from flexx2_sim_ros.batch.noise import DepthNoise

_PREFIX = 'NoisyDepth-'


class NoisyDepth:
    """Clean depth in, what a Flexx2 would have seen out: see `noisy_depth`."""

    def __init__(self, cfg: Any, env: Any) -> None:
        """Make the cameras."""
        options = {'device': str(env.device), **(cfg.params.get('camera') or {})}
        self._progress = options.pop('progress', None)
        if options.get('name') is None:
            # By the order of the terms in their environment, which is the same in each run.
            number = env._flexx2_terms = getattr(env, '_flexx2_terms', 0) + 1
            options['name'] = f'term {number}' if number > 1 else ''
        self.noise = DepthNoise(**options)
        self.noise.make(env.num_envs, options['device'])
        self._step: int | None = None

    def __call__(self, env: Any, depth: Any, camera: Any = None) -> Any:
        """Return the environments' images with noise; they are the caller's to keep."""
        step, before = _step_of(env), self._step
        # Counters go back when an environment is made anew.
        passed = 1 if step is None or before is None or step < before else step - before
        self._step = step
        if self._progress is not None:
            self.noise.set_progress(self._progress(env))
        return self.noise(depth(env), steps=passed)

    def reset(self, env_ids: Any = None) -> None:
        """Begin an episode in these environments (all when left out)."""
        self.noise.reset(env_ids)


def _step_of(env: Any) -> int | None:
    # The counters of Isaac Lab and mjlab: of steps, or where there is no policy, of the physics.
    if hasattr(env, 'common_step_counter'):
        return int(env.common_step_counter)
    if hasattr(env, '_sim_step_counter'):
        return int(env._sim_step_counter) // int(env.cfg.decimation)
    return None


@cache
def noisy_depth(base: type = object) -> type:
    """
    Make the class of an observation term.

    Managers of Isaac Lab and mjlab make ``func(cfg=term_cfg, env=env)``, call it with
    ``(env, **params)`` and reset it with ``reset(env_ids)``. ``examples/mjlab_go1.py`` is tested
    in mjlab 1.6. For Isaac Lab, which needs a GPU, a test binds the calls in the source of its
    releases 2.3.2 and 3.0.0 to this class, and runs their base class of terms, their checks and
    their functions that write a configuration as text and read it.

    Parameters
    ----------
    base : type
        What class terms have to inherit from: ``ManagerTermBase`` of Isaac Lab; nothing in mjlab.

    Returns
    -------
    type
        Of terms whose ``params`` are ``depth``, a function of the environment that returns clean
        depth, (N, H, W), (N, 1, H, W) or (N, H, W, 1) float32, metres along the optical axis; and
        ``camera``, the arguments of `DepthNoise` by name, of which ``progress`` may be a function
        of the environment. It returns the same shape. Without ``name``, each term of an
        environment has one of its own. Time is the environment's counter of steps, where it has
        one. The class is found again by its module and name, also in another process.

    Examples
    --------
    For a camera ``front`` in a scene of Isaac Lab::

        def front(env):
            return env.scene['front'].data.output['distance_to_image_plane'].torch

        ObservationTermCfg(func=noisy_depth(ManagerTermBase), params={
            'depth': front,
            'camera': {'mode': 'Mode_5_30fps', 'effects': 'randomised'}})

    Isaac Lab 2 gives tensors: leave ``.torch`` out there.

    """
    if base is object:
        return NoisyDepth
    parent: Any = base

    def made(self: Any, cfg: Any, env: Any) -> None:
        parent.__init__(self, cfg, env)
        NoisyDepth.__init__(self, cfg, env)

    # No name of Python has a hyphen: `__getattr__` finds the base from it.
    name = _PREFIX + f'{base.__module__}.{base.__qualname__}'.replace('.', '-')
    members = {'__init__': made, '__module__': __name__, '__doc__': NoisyDepth.__doc__}
    globals()[name] = type(name, (NoisyDepth, base), members)
    return globals()[name]


def __getattr__(name: str) -> type:
    """Make a class that a configuration or a pickle names."""
    if not name.startswith(_PREFIX):
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return noisy_depth(pkgutil.resolve_name(name.removeprefix(_PREFIX).replace('-', '.')))
