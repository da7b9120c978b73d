"""`BatchCamera`: many cameras, each in an environment of its own, at once."""

from collections.abc import Sequence
import math
from typing import Any

from flexx2_sim_ros.batch.arguments import device_named, environments, mask_of, one_for_each, seeds
from flexx2_sim_ros.batch.drawn import DrawnCameras
from flexx2_sim_ros.batch.effect_tables import each_environment
from flexx2_sim_ros.batch.exchange import checked, flat, from_warp, given_images, stream_of
from flexx2_sim_ros.batch.host import HostCameras, without_kernel, write_frames
from flexx2_sim_ros.batch.images import Images, MOST_PIXELS, Rows
from flexx2_sim_ros.batch.pickling import reduced
from flexx2_sim_ros.batch.stages import BatchStages
from flexx2_sim_ros.batch.timing import FrameTiming
from flexx2_sim_ros.camera import Intrinsics, Mode, Profile
from flexx2_sim_ros.effects import Effect, Randomisation
from flexx2_sim_ros.effects.time_offset import changing, time_offset_of
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.physics.philox import camera_key
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE, flexx2
import numpy as np
import warp as wp

_INVALID = {'nan': math.nan, 'zero': 0.0}


class BatchCamera:
    """
    Many Flexx2, one for each environment, on the CPU or a GPU.

    Environment i is what ``Camera(usecase[i], seed=seed[i], name=name)`` is with the stamps of
    `stamps`: the same noise in every pixel, to float32 rounding.

    Parameters
    ----------
    num_envs : int
        N.
    usecase : str or sequence of str
        The mode of all environments, or of each.
    profile : Profile, optional
        Another camera than the Flexx2.
    effects : see `Camera`, or a sequence of N such
        Of all environments, or of each. Environments with an effect that has no kernel are
        computed one after the other on the CPU, with a warning.
    seed : int or sequence of int
        Environment i has the seed ``seed + i``, or ``seed[i]``.
    name : str
        Cameras of different names share no noise.
    K : array_like, optional
        (3, 3) camera matrix of the depth images, pixels; the profile's field of view over the
        image when left out.
    device : str, optional
        Warp's name, e.g. ``cpu`` or ``cuda:0``; a GPU if there is one when left out.
    invalid_value : str
        What invalid pixels are, ``nan`` or ``zero``.
    step_s : float, optional
        Seconds of simulated time between two calls. An environment takes a frame in the calls in
        which its mode has one due; the others return the last image again. Without it, every
        call is the next frame.

    Attributes
    ----------
    num_envs : int
    device : warp.Device
    stamps : warp.array
        (N,) int64 on the device, nanoseconds: the time of the next call. Every call adds
        ``step_s``, or without it the mode's period.
    image_stamps : warp.array
        (N,) int64 on the device, nanoseconds: of the images that the last call returned. They are
        earlier than the call where an image is held or arrives late (`TimeOffset.delay`).
    drawn : DrawnCameras or None
        After `randomise`: the cameras of the environments that draw theirs.

    Raises
    ------
    InputError
        For values that cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> camera = BatchCamera(64, usecase='Mode_5_30fps', device='cpu')
    >>> camera(np.full((64, 172, 224), 1.5, np.float32)).shape
    (64, 172, 224)

    """

    def __init__(
        self,
        num_envs: int,
        usecase: str | Sequence[str] = DEFAULT_USECASE,
        *,
        profile: Profile | None = None,
        effects: Any = (),
        seed: int | Sequence[int] = 0,
        name: str = '',
        K: Any = None,  # noqa: N803
        device: str | None = None,
        invalid_value: str = 'nan',
        step_s: float | None = None,
    ) -> None:
        """Look the modes up and put them on the device."""
        self.num_envs = environments(num_envs)
        if invalid_value not in _INVALID:
            raise InputError(f'invalid_value: must be nan or zero, got {shown(invalid_value)}')
        self.profile = profile or flexx2()
        self.device = device_named(device)
        if K is not None:
            Intrinsics.from_matrix(K, 1, 1)  # complains
        self._matrix = K
        self._invalid = _INVALID[invalid_value]
        self._seeds, self._name = seeds(seed, self.num_envs), name
        keys = np.stack([camera_key(one, name) for one in self._seeds])
        self._rows = Rows(keys, self.device)
        self.stamps = self._rows.stamps
        self._shortest_ns = min(mode.period_ns for mode in self.profile.modes)
        self._timing = FrameTiming(step_s, self._rows, self.device)
        self.image_stamps = self._timing.image_stamps
        self._images: Images | None = None
        self._stages: BatchStages | None = None
        self._host: HostCameras | None = None
        self.drawn: DrawnCameras | None = None
        self._modes: list[Mode] = [self.profile.modes[0]] * self.num_envs
        self._effects: list[tuple[Effect, ...]] = [()] * self.num_envs
        self._has_effects = False
        self.set_usecase(usecase)
        self.set_effects(effects)

    @property
    def usecases(self) -> tuple[str, ...]:
        """Return the name of every environment's mode."""
        return tuple(mode.name for mode in self._modes)

    def set_usecase(self, usecase: str | Sequence[str], env_mask: Any = None) -> None:
        """
        Change modes, between two frames; environments forget what `reset` makes them forget.

        Parameters
        ----------
        usecase : str or sequence of str
            Of all chosen environments, or one for each of all N.
        env_mask : array_like of bool, optional
            (N,), which environments to change; all when left out.

        Raises
        ------
        InputError
            When there is no such mode, or the number of modes is not N.

        """
        names = one_for_each('usecase', usecase, str, self.num_envs)
        chosen = mask_of(env_mask, self.num_envs)
        modes = {one: self.profile.mode(one) for one in set(names)}
        self._set(
            [modes[names[i]] if chosen[i] else mode for i, mode in enumerate(self._modes)],
            self._effects,
        )
        self._forget(chosen)

    def set_effects(self, effects: Any, env_mask: Any = None) -> None:
        """
        Change effects, between two frames.

        What effects keep between frames is forgotten, in all environments. After `randomise`,
        the chosen environments draw no camera anymore; the others keep theirs.

        Parameters
        ----------
        effects : see `Camera`, or a sequence of N such
            Of all chosen environments, or one for each of all N.
        env_mask : array_like of bool, optional
            (N,), which environments to change; all when left out.

        Raises
        ------
        InputError
            For effects that `Camera` does not take.

        """
        chosen = mask_of(env_mask, self.num_envs)
        read = each_environment(effects, self.num_envs)
        every = [read[i] if chosen[i] else own for i, own in enumerate(self._effects)]
        self._set(self._modes, every)
        self._rows.set_effects(every)
        self._has_effects = any(changing(own) and not without_kernel(own) for own in every)
        self._stages = None
        on_host = {i: own for i, own in enumerate(every) if without_kernel(own)}
        parts = self._modes, self._seeds, self._name, self.profile
        self._host = HostCameras(on_host, *parts) if on_host else None
        self._give(self.drawn if self.drawn and self.drawn.leave(chosen) else None)

    def randomise(self, randomisation: Randomisation, seed: int = 0, pool: int = 4096) -> None:
        """
        Give each environment a camera drawn from distributions, and another one at each reset.

        Parameters
        ----------
        randomisation : Randomisation
            As `effects.load_randomisation` reads it.
        seed : int
            Of the draws.
        pool : int
            How many cameras are drawn now. A reset chooses among them, on the device.

        Raises
        ------
        InputError
            For effects that cannot be drawn again while the batch runs.

        """
        drawn = DrawnCameras(randomisation, self.num_envs, seed, pool, self.device)
        self.set_effects(drawn.effects)
        self._give(drawn)

    def reset(self, env_mask: Any = None) -> None:
        """
        Forget what effects keep between frames; noise and stamps go on.

        The next call takes a frame and returns it, however late images arrive. After `randomise`,
        these environments also draw another camera.

        Parameters
        ----------
        env_mask : array, optional
            (N,) bool, of NumPy or on the camera's device: which environments. All when left out.

        Raises
        ------
        InputError
            For another shape or dtype.

        """
        self._forget(np.ones(self.num_envs, bool) if env_mask is None else env_mask, draws=True)

    def _forget(self, env_mask: Any, draws: bool = False) -> None:
        host = isinstance(env_mask, np.ndarray)
        place = wp.get_device('cpu') if host else self.device
        kind = checked('env_mask', env_mask, (self.num_envs,), np.bool_, place)
        with stream_of(kind, self.device), wp.ScopedDevice(self.device):
            chosen = flat(kind, env_mask, lambda: wp.empty(self.num_envs, wp.bool, place))
            if self._host is not None:
                self._host.forget(chosen.numpy())
            mask = chosen.to(self.device)
            self._timing.forget(mask)
            if self._stages is not None:
                self._stages.forget(mask)
            if draws and self.drawn is not None:
                self.drawn.draw(mask)
                self.drawn.give(mask, self._rows)
        if host:
            wp.synchronize_device(self.device)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle all that the next images depend on; cameras on a GPU stay there."""
        return reduced(self)

    def __call__(
        self, depth: Any, reflectivity: Any = None, *, out: Any = None, steps: int | None = None
    ) -> Any:
        """
        Return a frame of every environment from its clean depth.

        Parameters
        ----------
        depth : torch tensor, JAX array, NumPy array or Warp array
            (N, H, W), (N, 1, H, W) or (N, H, W, 1) float32 on the camera's device, metres along
            the optical axis; need not be contiguous. NaN, infinities, zero and negative values
            mean no return.
        reflectivity : array, optional
            As ``depth``, 0..1 at the camera's wavelength, which effects look at, and the noise
            if the profile says how (``modes.*.surfaces``); 1 everywhere when left out.
        out : array, optional
            Where to write, like ``depth`` and contiguous.
        steps : int, optional
            How many steps have passed since the last call, 1 when left out. With 0, environments
            return their last image again, but those that were reset take another one. Give it in
            every call, so that the last images are kept.

        Returns
        -------
        array
            Like ``depth``: float32, metres along the optical axis, `invalid_value` where invalid.
            Without ``out`` it is the camera's own memory, written to again by the next call (but
            not with JAX, whose arrays never change). `image_stamps` says of when each image is.

        Raises
        ------
        InputError
            For another kind, shape, dtype or device, and more late frames than can be kept.

        """
        asked = depth, reflectivity, out
        kind, (clean, light, wanted) = given_images(self.num_envs, *asked, self.device)
        images = self._images_for(clean.shape[1], clean.shape[2], steps)
        target = wp.empty_like(images.out) if kind == 'jax' else images.out
        with stream_of(kind, self.device), wp.ScopedDevice(self.device):
            self._timing.begin(steps)
            self._look(
                images,
                flat(kind, clean, lambda: images.staging),
                None if light is None else flat(kind, light, lambda: images.more_staging),
                target.flatten() if wanted is None else flat(kind, wanted, lambda: images.staging),
            )
        return out if out is not None else from_warp(kind, target.reshape(tuple(depth.shape)))

    def _look(
        self, images: Images, depth: wp.array, reflectivity: wp.array | None, out: wp.array
    ) -> None:
        frames: dict[int, np.ndarray] = {}
        if self._host is not None:  # first, since `out` may be the memory of `depth`
            frames = self._host.look(
                depth, reflectivity, self.stamps, images.camera, self._rows.is_due
            )
        if self._host is None or len(self._host) < self.num_envs:
            self._launch(images, depth, reflectivity, out)
            images.blank_outside(out)
        write_frames(frames, self._invalid, out)
        self._timing.exchange(images, out)
        self._timing.end()

    def _launch(
        self, images: Images, depth: wp.array, reflectivity: wp.array | None, out: wp.array
    ) -> None:
        # Slower, with noise by reflectivity; the same in all modes, since graphs are captured.
        with_stages = self._has_effects or (
            reflectivity is not None
            and any(mode.noise.surfaces is not None for mode in self.profile.modes)
        )
        stages = self._stages_for(images) if with_stages else None
        if stages is not None:
            stages.begin(reflectivity is not None)
        for first in range(0, self.num_envs, images.most):
            images.begin(first, reflectivity, out)
            if stages is not None:
                stages.observe(depth)
            else:
                images.find_surfaces(depth, first)
                images.move_edges()
                images.observe()
        images.end()

    def _stages_for(self, images: Images) -> BatchStages:
        if self._stages is None or self._stages.images is not images:
            effects = [() if without_kernel(own) else changing(own) for own in self._effects]
            latest_ns = self._latest_ns + self._timing.step_ns  # Frames come up to a step early.
            self._stages = BatchStages(effects, latest_ns, images)
        return self._stages

    def _give(self, drawn: DrawnCameras | None) -> None:
        # Rows of environments that draw hold the effects of the file, which are no drawn camera.
        self.drawn, cameras = drawn, self._effects
        if drawn is not None:
            kept = zip(self._effects, drawn.drawing, strict=True)
            cameras = drawn.cameras + [own for own, draws in kept if not draws]
            with wp.ScopedDevice(self.device):
                drawn.give(wp.ones(self.num_envs, dtype=wp.bool), self._rows)
            wp.synchronize_device(self.device)  # The next frame may be of another stream.
        # The longest of all cameras that an environment may be.
        offsets = {time_offset_of(own) for own in cameras}
        self._latest_ns = max(offset.latency_ns for offset in offsets)
        self._longest_ns = max(offset.delay_ns for offset in offsets)

    def _set(self, modes: list[Mode], effects: list[tuple[Effect, ...]]) -> None:
        wp.synchronize_device(self.device)  # Frames may be in the making, on another stream.
        self._rows.set_modes(modes, effects, self.profile)
        self._modes, self._effects = modes, effects
        if self._host is not None:
            self._host.set_modes(modes)
        wp.synchronize_device(self.device)

    def _images_for(self, height: int, width: int, steps: int | None) -> Images:
        if self._images is None or (self._images.height, self._images.width) != (height, width):
            if self.num_envs * height * width > MOST_PIXELS:
                raise InputError(
                    f'depth: must have at most {MOST_PIXELS} pixels in all, got '
                    f'{self.num_envs} x {height} x {width} pixels'
                )
            lens = self.profile.intrinsics.resized(width, height)
            if self._matrix is not None:
                lens = Intrinsics.from_matrix(self._matrix, width, height)
            self._images = Images(self._rows, lens, self.profile, self._invalid)
            wp.synchronize_device(self.device)  # Frames may be made on another stream.
        self._timing.keep(self._longest_ns, self._shortest_ns, self._images, steps)
        return self._images
