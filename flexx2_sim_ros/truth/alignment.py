"""Align a depth image to a room: Gauss-Newton on what each ray measures, with a robust loss."""

from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from pathlib import Path

from flexx2_sim_ros.physics.poses import depth_slopes, Pose, weighted_equations
from flexx2_sim_ros.truth.observation import Observation
from flexx2_sim_ros.truth.rooms import Hits, load_room
from flexx2_sim_ros.truth.solver import damped_step, minimise, robust_weights, TRUNCATION
import numpy as np

_NOISE = 2.0  # standard deviations of noise that do not count as a misfit
GRAZING = 0.25  # cosine of the incidence angle: 75 degrees
_FEWEST = 12  # pixels
_LONGEST_STEP, _WIDEST_STEP = 0.15, 0.15  # metres, radians
_CONVERGED = 2e-6
_POSE_PRIOR = 1.0  # 1/m2: keeps the equations regular if the recording does not determine the pose
_TILE = 8  # pixels
# Standard deviations of the priors: bias, drift and amplitudes in metres; gain of the bounce.
PRIOR = 0.02
_PRIOR_GAIN = 1.0
_PRIOR_SCALE = 0.005  # scale error of a scan; photogrammetry without a measured length is worse
# Errors of the lens: relative error of the focal length; principal point, as tangents of angles
# (about 4 pixels of 224); radial distortion.
LENS = {'focal': 0.02, 'cx': 0.02, 'cy': 0.02, 'k1': 0.05}
_INVERSIONS = 4  # of distortion: enough for a tenth of a pixel


@dataclass(frozen=True)
class ErrorColumns:
    """Which errors are fitted that all recordings share; `names` has the order of coefficients."""

    bias: bool = True  # a constant along the ray, metres
    periods: tuple[float, ...] = ()  # of wiggling along the range, metres
    bounce: bool = True  # a gain of the light that bounced once
    scale: bool = False  # a relative scale of depth against the room
    lens: bool = False  # focal length, principal point and distortion
    drift: float = 0.0  # seconds: time constant of a bias that decays after power-on; 0: none

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        return (
            *['bias'] * self.bias,
            *(f'{part} {one:.3f} m' for one in self.periods for part in ('sine', 'cosine')),
            *['scale'] * self.scale,
            *tuple(LENS) * self.lens,
            *['drift'] * bool(self.drift),
            *['bounce'] * self.bounce,
        )

    @property
    def precision(self) -> np.ndarray:
        """Return the priors' inverse variances."""
        own = {'bounce': _PRIOR_GAIN, 'scale': _PRIOR_SCALE, **LENS}
        deviations = [own.get(name, PRIOR) for name in self.names]
        return np.array(deviations, float) ** -2.0

    def true_rays(self, values: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return (N, 2) the rays along which a camera sees, from those of the given lens."""
        if not self.lens:
            return rays
        focal, cx, cy, k1 = values[[self.names.index(name) for name in LENS]]
        image = (rays - (cx, cy)) / (1 + focal)
        true = image
        for _ in range(_INVERSIONS):
            true = image / (1 + k1 * (true**2).sum(axis=-1, keepdims=True))
        return true

    def design(
        self, hits: Hits, rays: np.ndarray, bounce: np.ndarray, uptime: float
    ) -> np.ndarray:
        """Return (N, k) depth errors, metres, by a unit of each coefficient; see `PosedImage`."""
        depth, length = hits.depth, np.sqrt(1 + (rays**2).sum(axis=-1))
        parts = [1 / length] if self.bias else []
        for period in self.periods:
            turn = 2 * np.pi * depth * length / period
            parts += [np.sin(turn) / length, np.cos(turn) / length]
        if self.scale:
            parts.append(depth)
        if self.lens:
            parts += _lens_columns(hits, rays)
        if self.drift:
            parts.append(math.exp(-uptime / self.drift) / length)
        if self.bounce:
            parts.append(bounce)
        return np.stack(parts, axis=-1) if parts else np.zeros((len(depth), 0))


def _lens_columns(hits: Hits, rays: np.ndarray) -> list[np.ndarray]:
    # Coefficients as of LENS: those of the true lens minus those given. Each bends the rays.
    x, y = rays.T
    with np.errstate(invalid='ignore', divide='ignore'):
        across, down = -hits.depth * hits.normal[:, :2].T / hits.slant(rays)  # per change of a ray
    outwards = across * x + down * y
    return [-outwards, -across, -down, -outwards * (x**2 + y**2)]


NO_ERRORS = ErrorColumns(False, (), False)


@dataclass(frozen=True)
class AlignedPixels:
    """The N pixels of an `Observation` that are aligned; `rays` is (N, 2), other arrays (N,)."""

    rays: np.ndarray
    depth: np.ndarray
    sigma: np.ndarray
    length: np.ndarray
    wraps: tuple[float, ...]
    pixel: np.ndarray  # places in the flat image
    tile: np.ndarray  # numbers of blocks of 8 x 8; errors within one are not independent
    bounce: np.ndarray  # simulated depth error by light that bounced once, metres

    def thinned(self, most: int) -> 'AlignedPixels':
        """Return about so many of the pixels."""
        step = max(len(self.depth) // most, 1)
        values = {name: one[::step] for name, one in vars(self).items() if name != 'wraps'}
        return replace(self, **values)


@dataclass(frozen=True)
class AlignedPose:
    """An aligned pose."""

    pose: Pose
    cost: float  # mean truncated residual, 0 to 1
    rival: float = math.inf  # cost of the best pose elsewhere; infinite if there is none


def choose(observation: Observation, most: int) -> AlignedPixels:
    """Return up to `most` pixels, drawn at random from those on smooth surfaces."""
    good = np.flatnonzero(observation.smooth)
    if len(good) > most:
        good = np.sort(np.random.default_rng(0).choice(good, most, replace=False))
    width = observation.depth.shape[1]
    tiles = (good // width // _TILE) * (width // _TILE + 1) + good % width // _TILE
    return AlignedPixels(
        observation.rays.reshape(-1, 2)[good],
        observation.depth.ravel()[good],
        observation.sigma.ravel()[good],
        observation.length.ravel()[good],
        observation.wraps,
        good,
        np.unique(tiles, return_inverse=True)[1],
        np.zeros(len(good)),
    )


def unwrapped(residual: np.ndarray, length: np.ndarray, wraps: tuple[float, ...]) -> np.ndarray:
    """
    Return residuals (metres along the optical axis) without the whole wraps that explain them.

    These explain nine tenths of them; `length` is that of a ray per metre of depth.
    """
    out = residual.copy()
    for period in wraps:
        step = period / length
        left = residual - step * np.rint(residual / step)
        with np.errstate(invalid='ignore'):
            better = (np.abs(left) < 0.1 * np.abs(residual)) & (np.abs(left) < np.abs(out))
        out[better] = left[better]
    return out


@dataclass(frozen=True)
class Linear:
    """The weighted linear equations of a view: y = J motion + A coefficients."""

    J: np.ndarray  # (N, 6)
    A: np.ndarray  # (N, k)
    y: np.ndarray  # (N,)
    weight: np.ndarray  # (N,)
    tile: np.ndarray  # (N,) as in `AlignedPixels`
    bias: np.ndarray  # (N,) the depth error by a bias of 1 m along the ray

    @cached_property
    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return their (k + 6, k + 6) matrix and right side: coefficients, and the pose held."""
        normal, right = weighted_equations(np.hstack([self.A, self.J]).T, self.weight, self.y)
        normal[-6:, -6:] += _POSE_PRIOR * np.eye(6)
        return normal, right

    @property
    def H(self) -> np.ndarray:  # noqa: N802
        """Return the (6, 6) information of the pose alone."""
        return self.equations[0][-6:, -6:]

    def free(self, columns: np.ndarray) -> np.ndarray:
        """Return (N, m) columns without the part that a motion of the camera explains."""
        return columns - self.J @ np.linalg.solve(
            self.H, (self.J * self.weight[:, None]).T @ columns
        )


@dataclass(frozen=True)
class PosedImage:
    """One image with its pose; a `State`."""

    recording: int  # its number
    room: Path  # see `load_room`
    target: AlignedPixels
    pose: Pose
    uptime: float = math.inf  # seconds since the camera was switched on; infinite if unknown
    columns: ErrorColumns = NO_ERRORS  # the errors that its camera has
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (k,) their coefficients
    reach: float = TRUNCATION  # metres: larger residuals are truncated to this
    # (6,) motion of its camera per second, as of `Pose.motion_to`.
    speed: np.ndarray = field(default_factory=lambda: np.zeros(6))

    @cached_property
    def rays(self) -> np.ndarray:
        """Return (N, 2) the rays along which its camera sees."""
        return self.columns.true_rays(self.values, self.target.rays)

    @cached_property
    def hits(self) -> Hits:
        """Return what these rays hit."""
        return load_room(self.room).cast(self.pose, self.rays)

    @cached_property
    def residual(self) -> np.ndarray:
        """Return (N,) measured minus expected depth, without whole wraps; NaN without a hit."""
        target = self.target
        return unwrapped(target.depth - self.hits.depth, target.length, target.wraps)

    @cached_property
    def A(self) -> np.ndarray:  # noqa: N802
        """Return (N, k) the depth error per unit of each coefficient."""
        return self.columns.design(self.hits, self.rays, self.target.bounce, self.uptime)

    @cached_property
    def error(self) -> np.ndarray:
        """Return (N,) the residual without the errors of its camera."""
        # The rays have the errors of the lens already.
        of_lens = np.isin(self.columns.names, tuple(LENS))
        return self.residual - self.A @ np.where(of_lens, 0, self.values)

    @cached_property
    def cost(self) -> float:
        """Return the mean of truncated errors, 0 to 1; a ray without a hit counts in full."""
        limit = self.reach + _NOISE * self.target.sigma
        with np.errstate(invalid='ignore'):
            short = np.fmin(np.abs(self.error) / limit, 1)
        return float(short.mean()) if len(short) else 1.0

    @cached_property
    def linear(self) -> Linear:
        """Return its equations, with robust weights; without hits at a grazing angle."""
        target, hits = self.target, self.hits
        with np.errstate(invalid='ignore'):
            use = -hits.slant(target.rays) > GRAZING * target.length
        use &= np.isfinite(self.residual)
        A, error = self.A[use], self.error[use]
        # The error of a mesh is perpendicular to its surface.
        weight = robust_weights(error, target.sigma[use] ** 2, self.reach)
        rays, depth = self.rays[use], hits.depth[use]
        plane = hits.normal[use].T / (hits.slant(self.rays)[use] * depth)
        J = depth_slopes(np.vstack([rays.T, np.ones(len(rays))]), plane, depth).T
        y = error + A @ self.values
        return Linear(J, A, y, weight, target.tile[use], 1 / target.length[use])

    def step(self, damping: float) -> np.ndarray | None:
        """Return the next step of its camera."""
        one = self.linear
        if len(one.y) < _FEWEST:
            return None
        return clamped(damped_step(one.J, one.weight, one.y - one.A @ self.values, damping))

    def moved(self, step: np.ndarray) -> 'PosedImage':
        """Return it after a motion of its camera."""
        return replace(self, pose=self.pose.moved(step))

    def loss(self, other: 'PosedImage') -> float:
        """Return the cost of another one."""
        return other.cost

    def settled(self, steps: int) -> 'PosedImage':
        """Return it aligned, in so many steps."""
        return minimise(self, steps, _CONVERGED)


def view_of(room: Path, image: Observation, most: int, pose: Pose) -> PosedImage:
    """Return up to `most` pixels of an image from a pose, of a camera without errors."""
    return PosedImage(0, room, choose(image, most), pose)


def align(
    room: Path, target: AlignedPixels, start: Pose, steps: int, reach: float = TRUNCATION
) -> AlignedPose:
    """Align pixels to a room, from a pose within about 0.2 m and 10 degrees; see `PosedImage`."""
    found = PosedImage(0, room, target, start, reach=reach).settled(steps)
    return AlignedPose(found.pose, found.cost)


def clamped(step: np.ndarray) -> np.ndarray:
    """Return a (6,) step, limited to the size for which the linearisation holds."""
    long = np.linalg.norm(step[:3]) / _LONGEST_STEP
    wide = np.linalg.norm(step[3:]) / _WIDEST_STEP
    return step / max(long, wide, 1.0)
