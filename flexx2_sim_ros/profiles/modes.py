"""The camera's modes (the driver's use cases) and the noise measured in them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
import math
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.errors import did_you_mean, InputError, shown
from flexx2_sim_ros.formulas.surfaces import surface_factor
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.sensor import DEFAULT_SENSOR, Sensor
import numpy as np

DEFAULT_USECASE = 'Mode_9_30fps'
# Where a mode's noise comes from.
NOISE_FROM = {
    'measured': 'measured in this mode',
    'other_mode': 'derived from that of another mode',
    'data_sheet': 'from a data sheet',
    'assumed': 'assumed',
    'not_stated': 'of an origin that the profile does not state',
}


@dataclass(frozen=True)
class SurfaceNoise:
    """
    How sigma_z depends on reflectivity; see `flexx2_sim_ros.formulas.surfaces.surface_factor`.

    Attributes
    ----------
    white : float
        Reflectivity of the board on which a, b, c, d and n were measured.
    constant_share : float
        Fraction of the board's variance that does not depend on light, 0..1.
    read_share : float
        Fraction of read noise in the rest of the variance at an amplitude of 1/m^2, 0..1.

    """

    white: float
    constant_share: float
    read_share: float

    @property
    def coefficients(self) -> np.ndarray:
        """Return the three, (3,) float32."""
        return np.array([self.white, self.constant_share, self.read_share], np.float32)


@dataclass(frozen=True)
class NoiseModel:
    """
    Coefficients of the paper's noise model.

    Attributes
    ----------
    a, b, c, d, n : float
        ``sigma_z = a + b z + c z^2 + d z^n theta^2 / (pi/2 - theta)^2``, metres and radians.
    sigma_x : float
        Standard deviation of an edge's position, pixels.
    incidence_cap : float
        The incidence angle beyond which sigma_z no longer grows, radians.
    surfaces : SurfaceNoise or None
        How sigma_z depends on reflectivity; None: not known, all surfaces have the same noise.

    """

    a: float
    b: float
    c: float
    d: float
    n: float
    sigma_x: float
    incidence_cap: float = math.radians(85.0)
    surfaces: SurfaceNoise | None = None

    @property
    def coefficients(self) -> np.ndarray:
        """Return a, b, c, d and n, (5,) float32."""
        return np.array([self.a, self.b, self.c, self.d, self.n], np.float32)

    def sigma_z(self, z: Any, theta: Any, reflectivity: Any = None) -> np.ndarray:
        """
        Evaluate the axial standard deviation.

        Parameters
        ----------
        z : array_like
            Depth along the optical axis, metres.
        theta : array_like
            Incidence angle, radians; held at ``incidence_cap`` near 90 degrees.
        reflectivity : array_like, optional
            0..1; that of the white board when left out. It matters only with ``surfaces``.

        Returns
        -------
        numpy.ndarray
            Standard deviation in metres, float64, never negative; NaN where an input is NaN.

        """
        z = np.asarray(z, dtype=np.float64)
        theta = np.minimum(np.abs(np.asarray(theta, dtype=np.float64)), self.incidence_cap)
        slant = (theta / (math.pi / 2 - theta)) ** 2
        sigma = self.a + self.b * z + self.c * z**2 + self.d * z**self.n * slant
        sigma = np.maximum(sigma, 0.0)
        own = self.surfaces
        if own is None or reflectivity is None:
            return sigma
        rho: Any = np.asarray(reflectivity, np.float64)
        return sigma * surface_factor(
            rho,
            np.cos(theta),
            1 / z,
            *(np.float64(x) for x in (own.white, own.constant_share, own.read_share)),
        )


@dataclass(frozen=True)
class Mode:
    """
    One mode of the camera.

    Attributes
    ----------
    name : str
        The driver's name, e.g. ``Mode_9_30fps``.
    rate_hz : float
        Frames a second.
    range_min, range_max : float
        Depths the mode reports, metres.
    modulation_hz : tuple of float
        Modulation frequencies.
    raw_frames : int
        Raw exposures a depth frame; 0: not known.
    exposure_us : tuple of int
        Shortest and longest exposure, microseconds.
    noise : NoiseModel
    noise_of : str
        The mode whose noise it is: its own name, or that of the mode it was taken over from.
    source : str
        Where rate and range come from (see ``config/modes.yaml``).
    sensor : Sensor
        What it has in common with the camera's other modes.
    noise_from : str
        Where ``noise`` comes from, out of `NOISE_FROM`.

    """

    name: str
    rate_hz: float
    range_min: float
    range_max: float
    modulation_hz: tuple[float, ...]
    raw_frames: int
    exposure_us: tuple[int, int]
    noise: NoiseModel
    noise_of: str
    source: str
    sensor: Sensor = DEFAULT_SENSOR
    noise_from: str = 'measured'

    def noisier(self, factor: float) -> 'Mode':
        """Return the mode with sigma_z times a factor, as of another camera of the same kind."""
        noise = {name: factor * getattr(self.noise, name) for name in 'abcd'}
        return replace(self, noise=replace(self.noise, **noise))

    @property
    def period_ns(self) -> int:
        """Return the time from frame to frame, nanoseconds."""
        return round(1e9 / self.rate_hz)

    def stamps(self, count: int, start: float = 0.0) -> np.ndarray:
        """Return the stamps of so many frames, (T,) float64 seconds, the first at ``start``."""
        # Whole nanoseconds, so that a frame's stamp does not depend on how it is computed.
        stamps: np.ndarray = np.rint(start * 1e9 + np.arange(count) * (1e9 / self.rate_hz)) / 1e9
        return stamps

    @property
    def measured(self) -> bool:
        """Whether the noise was measured in this very mode."""
        return self.noise_from == 'measured'

    @property
    def noise_words(self) -> str:
        """Say where the noise comes from: what follows "its noise is"."""
        if self.noise_of != self.name:
            return f'that of {self.noise_of}, the nearest measured mode of its family'
        return NOISE_FROM[self.noise_from]


@dataclass(frozen=True)
class Profile:
    """A camera: its name, intrinsics and modes."""

    model: str
    intrinsics: Intrinsics
    modes: tuple[Mode, ...]

    @property
    def sensor(self) -> Sensor:
        """Return what the modes have in common."""
        return self.modes[0].sensor

    @property
    def modulation_hz(self) -> list[float]:
        """Return the modulation frequencies of all modes, rising."""
        return sorted({f for mode in self.modes for f in mode.modulation_hz})

    def noisier(self, factor: float) -> 'Profile':
        """Return the camera with sigma_z of all modes times a factor."""
        return replace(self, modes=tuple(mode.noisier(factor) for mode in self.modes))

    @property
    def names(self) -> list[str]:
        """Return the modes' names in the profile's order."""
        return [mode.name for mode in self.modes]

    @property
    def default_usecase(self) -> str:
        """Return the mode to start in: the driver's default, or the first there is."""
        return DEFAULT_USECASE if DEFAULT_USECASE in self.names else self.names[0]

    def mode(self, usecase: str) -> Mode:
        """
        Look a mode up by name, whatever its case.

        Raises
        ------
        InputError
            When there is none; the message lists the valid names.

        """
        for mode in self.modes:
            if isinstance(usecase, str) and mode.name.lower() == usecase.strip().lower():
                return mode
        hint = did_you_mean(usecase, self.names) if isinstance(usecase, str) else ''
        raise InputError(
            f'usecase: must be one of {", ".join(self.names)}, got {shown(usecase)}{hint}'
        )


@dataclass(frozen=True)
class _CameraConfig:
    """
    The Flexx2 apart from its modes: ``config/flexx2.yaml``, which explains every number.

    ``field_of_view_deg`` is horizontal and vertical; ``incidence_cap`` is that of all noise
    models, radians.
    """

    model: str
    width: int
    height: int
    field_of_view_deg: tuple[float, float]
    incidence_cap: float
    sensor: Sensor


@lru_cache(maxsize=1)
def _camera_config() -> _CameraConfig:
    """
    Return ``config/flexx2.yaml``.

    Raises InputError when it is malformed; the message names the file and the field.
    """
    path = config_dir() / 'flexx2.yaml'
    table = read_config(path)

    def number(*keys: str) -> float:
        value: Any = table
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e9:
            raise InputError(
                f'{path}: {".".join(keys)}: must be a positive number, got {shown(value)}'
            )
        return float(value)

    view = table.get('field_of_view_deg')
    if not (
        isinstance(view, list)
        and len(view) == 2
        and all(isinstance(angle, (int, float)) and 0 < angle < 180 for angle in view)
    ):
        raise InputError(f'{path}: field_of_view_deg: must be two angles, got {shown(view)}')
    cap = number('axial', 'incidence_cap_deg')
    if cap >= 90:
        raise InputError(f'{path}: axial.incidence_cap_deg: must be less than 90, got {cap}')
    return _CameraConfig(
        str(table.get('model')),
        int(number('width')),
        int(number('height')),
        (float(view[0]), float(view[1])),
        math.radians(cap),
        Sensor(
            'tof',
            number('surface', 'jump_share'),
            number('surface', 'steep_share'),
            int(number('lateral', 'neighbourhood_px')),
            number('confidence', 'zero_at_sigma_m'),
            number('gray', 'full_scale_amplitude'),
            number('readout_us'),
        ),
    )


@lru_cache(maxsize=1)
def flexx2() -> Profile:
    """
    Return the profile of the PMD Flexx2, from ``config/``.

    Raises
    ------
    InputError
        When a configuration file is malformed; the message names the file and field.

    """
    camera = _camera_config()
    table = read_config(config_dir() / 'modes.yaml')
    try:
        intrinsics = Intrinsics.from_field_of_view(
            camera.width, camera.height, *camera.field_of_view_deg
        )
        measured = {
            name: NoiseModel(
                **{key: float(row[key]) for key in ('a', 'b', 'c', 'd', 'n', 'sigma_x')},
                incidence_cap=camera.incidence_cap,
                surfaces=None,
            )
            for name, row in table['noise'].items()
        }
        modes = tuple(
            _mode(name, row, measured, camera.sensor) for name, row in table['modes'].items()
        )
        return Profile(camera.model, intrinsics, modes)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f'{config_dir()}: modes.yaml or flexx2.yaml is malformed: {shown(error)}'
        ) from error


def _mode(
    name: str, row: Mapping[str, Any], measured: Mapping[str, NoiseModel], sensor: Sensor
) -> Mode:
    low, high = row['range_m']
    shortest, longest = row['exposure_us']
    return Mode(
        name,
        float(row['rate_hz']),
        float(low),
        float(high),
        tuple(float(f) for f in row['modulation_hz']),
        int(row['raw_frames']),
        (int(shortest), int(longest)),
        measured[row['noise']],
        row['noise'],
        str(row['source']),
        sensor,
        'measured' if row['noise'] == name else 'other_mode',
    )
