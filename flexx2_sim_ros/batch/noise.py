"""`depth_noise`: the depth noise of a camera in one line, for a training program of any kind."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexx2_sim_ros.batch.camera import BatchCamera
from flexx2_sim_ros.batch.drawn import can_be_drawn_again
from flexx2_sim_ros.batch.exchange import device_of, from_warp, kind_of
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.camera.arguments import as_effects
from flexx2_sim_ros.effects import Effect, Randomisation, registry
from flexx2_sim_ros.effects.randomisation import fixed, of_strengths, with_more
from flexx2_sim_ros.effects.registry import randomisation_at
from flexx2_sim_ros.effects.time_offset import arriving_late
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.limits import is_finite
from flexx2_sim_ros.processing import Chain, load_chain, parse_chain
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE
import numpy as np
import warp as wp

RANDOMISED = 'randomised'
# Of every effect: from off to twice typical, as `flexx2 gap randomise` draws what a diagnosis
# could not decide. Assumed.
_STRENGTHS = (0.0, 2.0)
_LEVELS = 100  # of progress; a definition: each new level writes the effects of all cameras again
_STATE = {'stamps', 'drawn', 'counts', 'progress'}


def depth_noise(profile: str | Profile = 'flexx2', **options: Any) -> 'DepthNoise':
    """
    Return the depth noise of a camera: clean depth in, what the camera would have seen out.

    Parameters
    ----------
    profile : str or Profile
        ``flexx2``, another name in ``config/profiles``, or a file.
    **options
        Of `DepthNoise`.

    Examples
    --------
    >>> import numpy as np
    >>> noise = depth_noise('flexx2', mode='Mode_5_30fps', effects='randomised', device='cpu')
    >>> noise(np.full((64, 58, 87), 1.5, np.float32)).shape
    (64, 58, 87)

    """
    return DepthNoise(profile, **options)


class DepthNoise:
    """
    Cameras of all environments, made with the first images; see `depth_noise`.

    Parameters
    ----------
    profile : str or Profile
        As in `depth_noise`.
    mode : str or sequence of str
        Of all environments, or of each.
    effects : str, path, mapping or Randomisation
        Beside the noise model. ``randomised``: all typical effects, each of a strength from off
        to twice typical, another one in each environment and after each reset. Or a file of
        `flexx2 gap randomise`, or whatever `Camera` takes: ``typical``, a table, a file.
    latency : float or tuple of float, optional
        Seconds until an image arrives, or (lowest, highest) for each environment.
    seed : int or sequence of int
        Environment i has the seed ``seed + i``, or ``seed[i]``.
    progress : float
        See `set_progress`.
    pool : int
        From how many cameras a reset chooses.
    invalid_value : str
        What invalid pixels are, ``zero`` or ``nan``.
    process : str, path or list, optional
        What your program does to the images: a file of `flexx2_sim_ros.processing`, or its list of
        stages. It runs in NumPy: from a GPU, the images go through the CPU.
    **camera
        Further arguments of `BatchCamera`: ``name``, ``K``, ``device``, ``step_s``.

    Attributes
    ----------
    camera : BatchCamera or None
        None before the first images.

    Raises
    ------
    InputError
        For values that cannot be used.

    """

    def __init__(
        self,
        profile: str | Profile = 'flexx2',
        *,
        mode: Any = DEFAULT_USECASE,
        effects: Any = (),
        latency: Any = None,
        seed: Any = 0,
        progress: float = 1.0,
        pool: int = 1024,  # assumed: enough that environments seldom share one
        invalid_value: str = 'zero',
        process: Any = None,
        **camera: Any,
    ) -> None:
        """Look up the camera, and what is drawn."""
        self._profile = profile if isinstance(profile, Profile) else find_profile(profile)
        modes = [mode] if isinstance(mode, str) else mode
        has_phases = all(self._profile.mode(one).modulation_hz for one in modes)
        self._drawn, self._effects = _effects_of(effects, has_phases)
        if latency is not None:
            if self._drawn is None:
                raise InputError('latency: must be in the effects here, since they have no kernel')
            self._drawn = with_more(self._drawn, *arriving_late(latency))
        self._options = {'usecase': mode, 'seed': seed, 'invalid_value': invalid_value, **camera}
        self._processing = None
        if process is not None:
            chain = parse_chain(process) if isinstance(process, list) else load_chain(process)
            step_s = camera.get('step_s') or 1 / self._profile.mode(modes[0]).rate_hz
            self._processing = _Processing(chain, step_s, invalid_value)
            self._options['invalid_value'] = 'nan'
        self._pool = pool if self._drawn is not None and self._drawn.distributions else 1
        self._progress = 1.0
        self._state: Mapping[str, Any] | None = None
        self.camera: BatchCamera | None = None
        self._like: Any = None
        self.set_progress(progress)

    def __call__(
        self, depth: Any, reflectivity: Any = None, *, out: Any = None, steps: int | None = None
    ) -> Any:
        """
        Return the images with noise, which are the caller's to keep.

        Parameters
        ----------
        depth : torch tensor, JAX array, NumPy array or Warp array
            (N, H, W), (N, 1, H, W) or (N, H, W, 1) float32, metres along the optical axis; NaN,
            infinities, zero and negative values mean no return.
        reflectivity, out, steps
            As `BatchCamera` takes them; ``out=depth`` writes in place, but not with ``process``.

        Returns
        -------
        array
            Like ``depth``, of the size of the processed images; invalid pixels are
            `invalid_value`.

        Raises
        ------
        InputError
            As `BatchCamera` does.

        """
        camera = self.camera or self.make(len(depth), device_of(kind_of('depth', depth), depth))
        self._like = depth
        if self._processing is not None:
            if out is not None:
                raise InputError('out: must be left out with process, got some')
            seen = camera(depth, reflectivity, steps=steps)
            return self._processing.images(seen, steps, camera.device)
        seen = camera(depth, reflectivity, out=out, steps=steps)
        if out is not None:
            return out
        return seen.clone() if hasattr(seen, 'clone') else seen.copy()

    def make(self, num_envs: int, device: Any) -> BatchCamera:
        """Make the cameras of so many environments on a device; the first images do it, too."""
        options = {'device': str(device), **self._options}
        self.camera = BatchCamera(
            num_envs, profile=self._profile, effects=self._effects, **options
        )
        if self._drawn is not None:
            first = np.atleast_1d(self._options['seed'])[0]
            self.camera.randomise(self._drawn, seed=int(first), pool=self._pool)
        if self._progress < 1:
            self._scale()
        if self._state is not None:
            self.load_state_dict(self._state)
        return self.camera

    def reset(self, envs: Any = None) -> None:
        """
        Begin an episode: effects forget earlier frames, no late image remains, another camera.

        Parameters
        ----------
        envs : array_like, optional
            Indices of environments, a slice, or (N,) bool; all when left out.

        """
        if self.camera is None:
            return
        # A mask on the images' device, so that nothing waits for it.
        size, like = self.camera.num_envs, self._like
        mask = like.new_zeros(size).bool() if hasattr(like, 'new_zeros') else np.zeros(size, bool)
        mask[slice(None) if envs is None else envs] = True
        self.camera.reset(mask)
        if self._processing is not None:
            self._processing.reset(np.asarray(mask.cpu() if hasattr(mask, 'cpu') else mask))

    def set_progress(self, progress: float) -> None:
        """
        Scale the strength of all effects, and their latency, to where the training is.

        The noise model stays as it was measured. Environments keep their cameras. It goes in steps
        of 1 %; each takes a third of a millisecond for each camera of the pool.

        Parameters
        ----------
        progress : float
            0 (no effects) to 1.

        Raises
        ------
        InputError
            For another number, and where effects have no kernel or cannot change.

        """
        if not (is_finite(progress) and 0 <= progress <= 1):
            raise InputError(f'progress: must be a number from 0 to 1, got {shown(progress)}')
        level = round(float(progress) * _LEVELS) / _LEVELS
        if level != self._progress:
            if self._drawn is None:
                raise InputError(
                    'progress: must be 1 with effects that cannot change in a batch, got '
                    f'{level:g}'
                )
            self._progress = level
            self._scale()

    def _scale(self) -> None:
        if self.camera is not None and self.camera.drawn is not None:
            self.camera.drawn.scale(self._progress)

    def state_dict(self) -> dict[str, Any]:
        """
        Return what a checkpoint needs, in plain numbers and lists.

        That is each environment's time and camera, and the progress; not what effects keep of
        earlier frames.
        """
        state: dict[str, Any] = {'progress': self._progress}
        if self.camera is None:
            return {**(self._state or {}), **state}
        state['stamps'] = self.camera.stamps.numpy().tolist()
        if self.camera.drawn is not None:
            state |= self.camera.drawn.state()
        return state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """
        Go on from a checkpoint: the same noise as after it, with all episodes begun anew.

        Raises
        ------
        InputError
            When it is not one of `state_dict`, or of another number of environments.

        """
        if not isinstance(state, Mapping) or not {'progress'} <= set(state) <= _STATE:
            raise InputError(f'state: must be one of state_dict, got {shown(state)}')
        self.set_progress(state['progress'])
        self._state, camera = state, self.camera
        if camera is None or 'stamps' not in state:
            return
        if len(state['stamps']) != camera.num_envs or ('drawn' in state) != bool(camera.drawn):
            raise InputError(
                f'state: must be of {camera.num_envs} environments with the same effects, got '
                f'{len(state["stamps"])}'
            )
        camera.reset()
        camera.stamps.assign(np.array(state['stamps'], np.int64))
        if camera.drawn is not None:
            camera.drawn.restore(state)


class _Processing:
    # A chain for images of all libraries, and the time of its steps.

    def __init__(self, chain: Chain, step_s: float, invalid_value: str) -> None:
        self._chain, self._step_ns = chain, round(step_s * 1e9)
        self._keeps_nan = invalid_value == 'nan'
        self._time = 0
        self._last: Any = None  # (N, h, w)
        self._is_new = True

    def reset(self, mask: np.ndarray) -> None:
        self._chain.reset(mask)
        self._is_new = True

    def images(self, seen: Any, steps: int | None, device: Any) -> Any:
        kind = kind_of('depth', seen)
        images = seen.numpy() if kind == 'warp' else seen
        images = np.asarray(images.cpu() if kind == 'torch' else images)
        channel = None
        if images.ndim == 4:
            channel = 3 if images.shape[3] == 1 else 1
            images = images.squeeze(channel)
        self._time += self._step_ns * (1 if steps is None else steps)
        if steps != 0 or self._is_new:
            found = self._chain.step(images, self._time)
            self._last = self._last if found is None else found
        self._is_new = False
        out = self._last if self._keeps_nan else np.nan_to_num(self._last)
        if channel is not None:
            out = np.expand_dims(out, channel)
        return from_warp(kind, wp.array(out, dtype=wp.float32, device=device))


def _effects_of(effects: Any, has_phases: bool) -> tuple[Randomisation | None, Any]:
    # What is drawn, or effects as they are.
    if isinstance(effects, Randomisation):
        return effects, ()
    if effects == RANDOMISED:
        typical = (kind() for kind in registry().values() if kind.typical)
        usable = [
            one
            for one in typical
            if can_be_drawn_again(one) and (has_phases or not one.needs_modulation)
        ]
        return of_strengths(usable, *_STRENGTHS), ()
    if isinstance(effects, str | Path):
        found = randomisation_at(effects)
        if found is not None:
            return found, ()
    if isinstance(effects, list | tuple) and not all(isinstance(one, Effect) for one in effects):
        return None, effects  # a set for each environment
    own: Any = as_effects(effects)
    return (fixed(own), ()) if all(map(can_be_drawn_again, own)) else (None, own)
