"""The view of one frame: analytic depth, reflectivity, amplitude, base noise and edges."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

from flexx2_sim_ros.physics.surface import analyse, Surface
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2, Mode
import numpy as np
from study.blind.edges import edge_maps
from study.blind.internals import Internals
from study.blind.sensor import split_noise, wavenumbers
from study.blind.shapes import cast, Solids


@dataclass(frozen=True)
class Optics:
    """
    Geometry and mode of the real camera.

    * `intrinsics`: those that the user knows: the K of the recordings
    * `internals`: what differs inside
    """

    mode: Mode
    intrinsics: Intrinsics
    internals: Internals = Internals()

    @classmethod
    def of(cls, usecase: str, width: int = 224, height: int = 172) -> 'Optics':
        """Return the Flexx2 in a mode, its image scaled to another resolution."""
        whole = flexx2().intrinsics
        across, down = width / whole.width, height / whole.height
        return cls(
            flexx2().mode(usecase),
            Intrinsics(
                width,
                height,
                whole.fx * across,
                whole.fy * down,
                (width - 1) / 2,
                (height - 1) / 2,
            ),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.intrinsics.height, self.intrinsics.width

    @cached_property
    def wavenumbers(self) -> np.ndarray:
        """Phase per metre of range, (J,) float64, the highest frequency first."""
        own = self.internals.mhz
        hertz = (1e6 * own,) if own else self.mode.modulation_hz
        return np.sort(wavenumbers(hertz))[::-1].copy()

    @cached_property
    def period(self) -> float:
        """Return the range after which all phases repeat, metres."""
        steps = 2 * np.pi / self.wavenumbers
        # The modes' frequencies are multiples of 20 MHz: 80 and 60 repeat after 4 and 3 turns.
        return (
            float(steps[0])
            if len(steps) == 1
            else float(2 * np.pi / -np.diff(self.wavenumbers)[0])
        )

    @cached_property
    def rays(self) -> np.ndarray:
        """x/z and y/z of every pixel, (H * W, 2) float64."""
        return pixel_rays(self.intrinsics)

    @cached_property
    def ray_length(self) -> np.ndarray:
        """Length of a ray per metre of depth, (H, W) float32."""
        return np.sqrt(1 + (self.rays**2).sum(-1)).reshape(self.shape).astype(np.float32)


def pixel_rays(intrinsics: Intrinsics, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """
    Return x/z and y/z of every pixel, (H * W, 2) float64.

    Radial distortion moves a point outwards by ``1 + k1 r^2``, tangential distortion sideways by
    p1 and p2 of OpenCV. `shift` moves all pixels by a fraction of a pixel.
    """
    v, u = np.mgrid[: intrinsics.height, : intrinsics.width].astype(np.float64)
    x = (u + shift[0] - intrinsics.cx) / intrinsics.fx
    y = (v + shift[1] - intrinsics.cy) / intrinsics.fy
    k1, _, p1, p2, *_ = intrinsics.distortion
    undistorted = np.stack([x.ravel(), y.ravel()], axis=-1)
    if k1 or p1 or p2:
        seen = undistorted.copy()
        for _ in range(12):
            aside = 2 * undistorted * (undistorted @ (p2, p1))[:, None]
            square = (undistorted**2).sum(-1, keepdims=True)
            undistorted = (seen - aside - square * (p2, p1)) / (1 + k1 * square)
    return undistorted


@dataclass(frozen=True)
class View:
    """
    The scene as the camera sees it in one frame.

    * `depth`: (H, W) float32 metres along the optical axis, NaN for no return
    * `reflectivity`: (H, W) float32
    * `solids`, `R`, `origin`: the scene and the true pose, for effects that trace rays
    * `rays`: (H * W, 2) the true rays
    * `irradiance`: indirect light if it has been computed; see `bounce`
    """

    optics: Optics
    depth: np.ndarray
    reflectivity: np.ndarray
    solids: Solids
    R: np.ndarray
    origin: np.ndarray
    rays: np.ndarray = field(repr=False)
    irradiance: np.ndarray | None = field(default=None, repr=False)

    @cached_property
    def ray_length(self) -> np.ndarray:
        """Return the true length of each ray per metre of depth, (H, W) float32."""
        if self.rays is self.optics.rays:
            return self.optics.ray_length
        return np.sqrt(1 + (self.rays**2).sum(-1)).reshape(self.depth.shape).astype(np.float32)

    @cached_property
    def _surface(self) -> Surface:
        return analyse(self.depth, self.optics.intrinsics, self.optics.mode.sensor)

    @property
    def cosine(self) -> np.ndarray:
        """Cosine of the incidence angle, (H, W) float32."""
        return self._surface.cos_incidence

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges that move along rows and along columns, (H, W) bool."""
        return edge_maps(self._surface.row_jumps, self._surface.column_jumps)

    @cached_property
    def near_edge(self) -> np.ndarray:
        """Pixels within two of a depth jump, (H, W) bool."""
        jump = (self._surface.row_jumps + self._surface.column_jumps) > 0
        jump[:, 1:] |= self._surface.row_jumps[:, :-1] > 0
        jump[1:] |= self._surface.column_jumps[:-1] > 0
        for _ in range(2):
            wide = jump.copy()
            wide[:, 1:] |= jump[:, :-1]
            wide[:, :-1] |= jump[:, 1:]
            wide[1:] |= jump[:-1]
            wide[:-1] |= jump[1:]
            jump = wide
        return jump

    @cached_property
    def sigma(self) -> np.ndarray:
        """Return the base sigma_z, (H, W) float32 metres, 0 for no return."""
        return np.nan_to_num(
            self.optics.mode.noise.sigma_z(self.depth, np.arccos(np.clip(self.cosine, 0, 1)))
        ).astype(np.float32)

    @cached_property
    def path(self) -> np.ndarray:
        """Distance along the ray, (H, W) float32 metres, 0 for no return."""
        return np.nan_to_num(self.depth * self.ray_length)

    @cached_property
    def amplitude(self) -> np.ndarray:
        """Reflectivity * cos(incidence) / z^2, (H, W) float32 1/m^2, 0 for no return."""
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.nan_to_num(self.reflectivity * self.cosine / self.depth**2)

    @cached_property
    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Phase noise of the taps (radians) and jitter of the path (metres), (H, W) float32."""
        return split_noise(self.sigma * self.ray_length, self.optics.wavenumbers)

    @cached_property
    def light(self) -> np.ndarray:
        """Phasors of the scene without effects, (J, H, W) complex64."""
        return phasors(self.amplitude, self.path, self.optics.wavenumbers)


def phasors(amplitude: np.ndarray, path: np.ndarray, K: np.ndarray) -> np.ndarray:  # noqa: N803
    """Return amplitude * exp(i K path) for each wavenumber, (J, ...) complex64."""
    turns = path * (K.reshape(-1, *[1] * path.ndim) / (2 * np.pi))
    angle = ((turns - np.rint(turns)) * (2 * np.pi)).astype(np.float32)
    out = np.empty(angle.shape, np.complex64)
    np.multiply(amplitude, np.cos(angle), out=out.real)
    np.multiply(amplitude, np.sin(angle), out=out.imag)
    return out


def cast_rays(
    solids: Solids,
    R: np.ndarray,
    origin: np.ndarray,  # noqa: N803
    rays: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return depth (N,), reflectivity (N,) and world normals (N, 3), float32, of (N, 2) rays."""
    depth, reflectivity = np.empty((2, len(rays)), np.float32)
    normal = np.empty((len(rays), 3), np.float32)
    cast(
        solids.kinds, solids.placement, solids.looks, R, origin, rays, depth, reflectivity, normal
    )
    return depth, reflectivity, normal


def look(
    solids: Solids,
    pose: tuple[np.ndarray, np.ndarray],
    optics: Optics,
    rays: np.ndarray | None = None,
) -> View:
    """
    Render a view.

    * `pose`: rotation camera to world and position
    * `rays`: the true rays, if they differ from those that the user knows
    """
    R, origin = pose
    chosen = optics.rays if rays is None else rays
    depth, reflectivity, _ = cast_rays(solids, R, origin, chosen)
    return View(
        optics,
        depth.reshape(optics.shape),
        reflectivity.reshape(optics.shape),
        solids,
        R,
        origin,
        chosen,
    )


@lru_cache(maxsize=8)
def shared_optics(usecase: str, width: int, height: int) -> Optics:
    """Return `Optics.of`, computed once per process."""
    return Optics.of(usecase, width, height)
