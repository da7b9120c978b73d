"""The errors that recordings share: what each does to measured depth."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.truth.rooms import Hits
import numpy as np

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
    """
    Which errors are fitted that all recordings share, in the order of the coefficients.

    * `bias`: a constant along the ray, metres.
    * `periods`: periods of wiggling along the range, metres; each has a sine and a cosine.
    * `bounce`: a gain of the light that bounced once.
    * `scale`: a relative scale of depth against the room.
    * `lens`: errors of the lens: focal length, principal point and distortion.
    * `drift`: time constant of a bias along the ray that decays after power-on, seconds; 0: not
      fitted.
    """

    bias: bool = True
    periods: tuple[float, ...] = ()
    bounce: bool = True
    scale: bool = False
    lens: bool = False
    drift: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        waves = [
            f'{part} {period:.3f} m' for period in self.periods for part in ('sine', 'cosine')
        ]
        return (
            *['bias'] * self.bias,
            *waves,
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
        """
        Return the rays along which a camera with these errors of its lens sees.

        `values` is (k,) coefficients, `rays` (N, 2) x/z and y/z as the given lens has them.
        """
        if not self.lens:
            return rays
        focal, cx, cy, k1 = values[[self.names.index(name) for name in LENS]]
        image = (rays - (cx, cy)) / (1 + focal)
        true = image
        for _ in range(_INVERSIONS):
            true = image / (1 + k1 * (true**2).sum(axis=-1, keepdims=True))
        return true

    @property
    def of_lens(self) -> np.ndarray:
        """Return (k,) bool: the errors of the lens."""
        return np.isin(self.names, tuple(LENS))

    def design(
        self, hits: Hits, rays: np.ndarray, bounce: np.ndarray, uptime: float
    ) -> np.ndarray:
        """
        Return the depth error per unit of each coefficient, (N, k) metres along the optical axis.

        `hits` are (N,) surfaces that the rays, (N, 2) x/z and y/z, should hit; `bounce` (N,) the
        simulated depth error by light that bounced once, metres; `uptime` seconds since the camera
        was switched on, infinite if unknown.
        """
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
