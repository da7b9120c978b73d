"""The camera: clean depth in, what a Flexx2 would have seen out."""

from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from typing import Any

from flexx2_sim_ros.camera.arguments import as_effects, as_views, Views
from flexx2_sim_ros.camera.frame import Frame
from flexx2_sim_ros.camera.stages import run_stages
from flexx2_sim_ros.effects.time_offset import changing
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.physics.axial import hold_reflectivity, observe, prepare, scale_by_surface
from flexx2_sim_ros.physics.frame_state import (
    check_frequencies,
    EffectProtocol,
    FrameState,
    Memory,
)
from flexx2_sim_ros.physics.lateral import edge_limit, pixel_sigma
from flexx2_sim_ros.physics.philox import camera_key, stamp_words
from flexx2_sim_ros.physics.surface import analysis_constants
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE, flexx2, Mode, Profile
import numpy as np

_LARGE = 50_000  # pixels of all frames of a call: more than a frame of this camera


class Camera:
    """
    A Flexx2 in one of its modes.

    The noise is a pure function of (seed, name, stamp): the same frame gets the same noise
    whatever was captured before it or beside it.

    Parameters
    ----------
    usecase : str
        A mode's name, whatever its case, e.g. ``Mode_9_30fps``.
    profile : Profile, optional
        Another camera than the Flexx2.
    effects : sequence of Effect, mapping, str or pathlib.Path
        Effects beyond the paper's model (see `flexx2_sim_ros.effects`): themselves, a table of
        their parameters by name, or the path of a YAML file. Those of strength 0 are off.
    seed : int
        Seed of the noise.
    name : str
        Cameras of different names share no noise.

    Attributes
    ----------
    exposure_share : float
        Exposure time as a fraction of the one that the effects' parameters are for; 1 unless it is
        set. It scales the light that effects see, not the frame's amplitude.

    Raises
    ------
    InputError
        When there is no such mode.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera('Mode_5_30fps', seed=1, name='front_left')
    >>> K = np.array([[210.6, 0, 111.5], [0, 212.9, 85.5], [0, 0, 1]])
    >>> frame = camera.capture(np.full((172, 224), 1.5), K, stamp=0.1)
    >>> frame.depth.shape
    (172, 224)

    """

    def __init__(
        self,
        usecase: str = DEFAULT_USECASE,
        *,
        profile: Profile | None = None,
        effects: Any = (),
        seed: int = 0,
        name: str = '',
    ) -> None:
        """Look the mode up and derive the generator's key."""
        self.profile = profile or flexx2()
        self.mode: Mode = self.profile.mode(usecase)
        if (
            isinstance(seed, bool)
            or not isinstance(seed, int | np.integer)
            or not -(2**63) <= seed < 2**63
        ):
            raise InputError(f'seed: must be a whole number of 64 bits, got {shown(seed)}')
        if not isinstance(name, str):
            raise InputError(f'name: must be a string, got {shown(name)}')
        self.seed = int(seed)
        self.name = name
        noise = self.mode.noise
        sensor = self.mode.sensor
        self.exposure_share = 1.0
        self._memories: dict[tuple[int, ...], Memory] = {}
        self._environments: tuple[int, ...] = ()
        self.effects = effects
        self._key = camera_key(self.seed, name)
        self._coefficients = noise.coefficients
        self._cap = np.float32(noise.incidence_cap)
        self._jitter = (
            sensor.neighbourhood_px,
            np.float32(pixel_sigma(noise.sigma_x)),
            edge_limit(noise.sigma_x),
            np.float32(0.0),  # fraction of Laplacian edges
        )
        self._zero_confidence = np.float32(sensor.zero_at_sigma_m)

    @property
    def usecase(self) -> str:
        """Return the mode's canonical name."""
        return self.mode.name

    @property
    def effects(self) -> tuple[EffectProtocol, ...]:
        """Return the effects that are on; can be set, between frames, to what Camera takes."""
        return self._effects

    @effects.setter
    def effects(self, effects: Any) -> None:
        chosen = tuple(effect for effect in as_effects(effects) if effect.strength)
        names = [effect.name for effect in chosen]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f'effects: must have {name} once, got it {names.count(name)} times'
                )
        check_frequencies(chosen, self.mode)
        self._effects, self._changing = chosen, changing(chosen)
        for memory in self._memories.values():
            # An effect that changes nothing now does not see the frames of this time.
            memory.keep_only([effect.name for effect in self._changing])

    def capture(
        self,
        clean_depth: Any,
        K: Any,
        stamp: Any,  # noqa: N803
        reflectivity: Any = None,
    ) -> Frame:
        """
        Look at clean depth.

        Leading dimensions of all arguments broadcast against each other: one (H, W) scene with
        (T,) stamps gives T frames.

        Some effects remember the frames before. With effects the last leading dimension is time
        when ``stamp`` has dimensions, and those before it are environments: cameras of their own,
        each with its own memory. With a scalar ``stamp`` all leading dimensions are environments.
        The next call goes on where this one ended if its environments have the same shape; if
        not, or where a stamp is earlier than the one before, it starts afresh. See `reset`.

        Parameters
        ----------
        clean_depth : array_like
            (..., H, W), metres along the optical axis, any real dtype. NaN, infinities, zero,
            negative and masked values mean no return.
        K : array_like
            (..., 3, 3) camera matrix of ``clean_depth``, pixels.
        stamp : array_like
            (...), the frame's time: whole numbers are nanoseconds, floating-point numbers are
            seconds (taken to the nearest nanosecond).
        reflectivity : array_like, optional
            (..., H, W) in 0..1 at the camera's wavelength; 1 everywhere when left out. sigma_z
            depends on it if the profile says how (``modes.*.surfaces``).

        Raises
        ------
        InputError
            For wrong shapes, dtypes, whole numbers that look like millimetres, or a matrix that
            is no camera's.

        """
        views = as_views(clean_depth, K, stamp, reflectivity)
        self._keep_environments(views)
        shape = views.clean.shape
        if views.clean.size > _LARGE:
            _keep_freed_memory()
        out = [np.empty(shape, np.float32) for _ in range(4)]
        if self._changing:
            self._run_stages(views, out)
        else:
            self._run_base_model(views, out)
        depth, sigma, amplitude, confidence = out
        return Frame(depth, sigma, amplitude, confidence, views.matrices_given.astype(np.float64))

    def skip(self, stamp: int) -> None:
        """
        Let a frame pass that nobody looks at: time goes on for effects that count it.

        Parameters
        ----------
        stamp : int
            The frame's time, nanoseconds.

        """
        for memory in self._memories.values() if self._environments else [self._memory(())]:
            memory.begin(stamp)

    def reset(self, mask: Any = None) -> None:
        """
        Forget what effects keep between frames.

        Parameters
        ----------
        mask : array_like, optional
            Of bool, over the environments (see `capture`): which to reset. All when left out.

        Raises
        ------
        InputError
            When ``mask`` is not bool or not of the environments' shape.

        """
        if mask is None:
            self._memories.clear()
            return
        chosen = np.asarray(mask)
        if chosen.dtype != bool or (self._memories and chosen.shape != self._environments):
            raise InputError(
                f'mask: must be bool of the shape of the environments, {self._environments}, '
                f'got {chosen.dtype} of shape {chosen.shape}'
            )
        for index in list(self._memories):
            if chosen[index]:
                del self._memories[index]

    def _keep_environments(self, views: Views) -> None:
        # Memories are of the environments of the call before.
        environments = views.stamps.shape[: views.environments]
        if environments != self._environments:
            self._memories.clear()
            self._environments = environments

    def _memory(self, index: tuple[int, ...]) -> Memory:
        return self._memories.setdefault(index, Memory())

    def _run_base_model(self, views: Views, out: list[np.ndarray]) -> None:
        prepared: _Prepared | None = None
        for index in product(*map(range, views.stamps.shape)):
            # Nothing is kept, but an effect that is turned on later may count the time.
            self._memory(index[: views.environments]).begin(int(views.stamps[index]))
            scene, matrix = views.clean[index], views.matrices[index]
            # A scene broadcast over many stamps is analysed once.
            if prepared is None or not prepared.holds(scene, matrix):
                prepared = self._prepare(scene, matrix)
            images = [array[index] for array in out]
            self._expose(prepared, int(views.stamps[index]), views.reflectivity[index], *images)
            if prepared.outside is not None:
                _blank(images, prepared.outside)

    def _run_stages(self, views: Views, out: list[np.ndarray]) -> None:
        height, width = views.clean.shape[-2:]
        for index in np.ndindex(views.stamps.shape):
            given = np.ascontiguousarray(views.reflectivity[index])
            reflectivity = np.empty(given.shape, np.float32)
            hold_reflectivity(given, reflectivity)
            state = FrameState(
                self.mode,
                _intrinsics(
                    np.asarray(views.matrices[index], np.float64).tobytes(), width, height
                ),
                int(views.stamps[index]),
                self._key,
                self._memory(index[: views.environments]),
                views.clean[index].copy(),
                reflectivity,
                self.exposure_share,
            )
            finished = run_stages(state, self._changing, self.mode.noise.sigma_x)
            for array, image in zip(out, finished, strict=True):
                array[index] = image

    def _prepare(self, scene: np.ndarray, matrix: np.ndarray) -> '_Prepared':
        height, width = scene.shape
        camera = _intrinsics(np.asarray(matrix, np.float64).tobytes(), width, height)
        constants = analysis_constants(camera, self.mode.sensor)
        inverse, cosine, sigma, edges = prepare(
            _read_only(scene), constants, self._coefficients, self._cap
        )
        outside = self.mode.sensor.outside(camera)
        return _Prepared(scene, matrix, inverse, cosine, sigma, edges, outside)

    def _expose(
        self, prepared: '_Prepared', stamp: int, albedo: np.ndarray, *images: np.ndarray
    ) -> None:
        model, reflectivity = prepared.sigma, _read_only(albedo)
        surfaces = self.mode.noise.surfaces
        if surfaces is not None and reflectivity.size > 1:
            model = model.copy()
            scale_by_surface(
                prepared.inverse_depth,
                prepared.cos_incidence,
                reflectivity,
                surfaces.coefficients,
                model,
            )
        observe(
            prepared.inverse_depth,
            prepared.cos_incidence,
            model,
            reflectivity,
            prepared.edges,
            self._jitter,
            self._key,
            *stamp_words(stamp),
            np.float32(self.mode.range_min),
            np.float32(self.mode.range_max),
            self._zero_confidence,
            *images,
        )


@cache
def _keep_freed_memory() -> None:
    # glibc keeps twice as much as the largest block that it was given back, of those below 32 MB.
    # Without this one, a frame of 1280 x 720 has 5,000 page faults: more than half of its time.
    np.empty(31 << 20, np.uint8)


@dataclass(frozen=True)
class _Prepared:
    # What the stamp does not change.
    scene: np.ndarray
    matrix: np.ndarray
    inverse_depth: np.ndarray
    cos_incidence: np.ndarray
    sigma: np.ndarray
    edges: tuple[np.ndarray, np.ndarray]
    outside: np.ndarray | None

    def holds(self, scene: np.ndarray, matrix: np.ndarray) -> bool:
        return _same_memory(scene, self.scene) and _same_memory(matrix, self.matrix)


@lru_cache(maxsize=16)
def _intrinsics(matrix: bytes, width: int, height: int) -> Intrinsics:
    # Of a float64 matrix; most frames have that of the frame before.
    return Intrinsics.from_matrix(np.frombuffer(matrix), width, height)


def _read_only(image: np.ndarray) -> np.ndarray:
    # Some images are, and numba compiles loops for each kind.
    same = np.ascontiguousarray(image).view()
    same.flags.writeable = False
    return same


def _blank(images: list[np.ndarray], where: np.ndarray) -> None:
    for image, invalid in zip(images, (np.nan, np.nan, 0, 0), strict=True):
        image[where] = invalid


def _same_memory(one: np.ndarray, other: np.ndarray) -> bool:
    return one.__array_interface__['data'] == other.__array_interface__['data']
