"""
Camera profiles: another camera than the built-in Flexx2, as a YAML file.

``flexx2 characterize fit`` writes them; `Camera`, ``flexx2 simulate`` and ``flexx2_camera`` run
them. The fields are those of `MODE_FIELDS` and its neighbours here; ``null`` means not known.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from pathlib import Path
import re
from typing import Any

from flexx2_sim_ros.atomic import whole
from flexx2_sim_ros.config_file import is_regular_file, read_config
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import DISTORTION_MODELS, Intrinsics
from flexx2_sim_ros.profiles.modes import (
    flexx2,
    Mode,
    NOISE_FROM,
    NoiseModel,
    Profile,
    SurfaceNoise,
)
from flexx2_sim_ros.profiles.section import Section
from flexx2_sim_ros.profiles.sensor import KINDS, Sensor
from flexx2_sim_ros.profiles.sensor_section import read_sensor, sensor_row
from flexx2_sim_ros.profiles.valid_mask import mask_of, ValidMask, write_mask
import numpy as np
import yaml

SCHEMA = 1
COEFFICIENTS = ('a', 'b', 'c', 'd', 'n', 'sigma_x')
BUILT_IN = 'flexx2'
# Of the option and the parameter `profile`.
PROFILE_HELP = (
    'another camera than the Flexx2: a shipped name (see flexx2 modes --help) or the path of a '
    'profile, as flexx2 characterize fit writes it'
)
_TOP = ('schema', 'model', 'intrinsics', 'modes')
_INTRINSICS = ('width', 'height', 'fx', 'fy', 'cx', 'cy', 'distortion')
MODE_FIELDS = ('rate_hz', 'range_m', 'modulation_hz', 'raw_frames', 'exposure_us', 'noise')
_OPTIONAL_MODE_FIELDS = ('standard_errors', 'noise_from', 'measured', 'surfaces')
SURFACE_SHARES = ('constant_share', 'read_share')
_SURFACES = ('white', *SURFACE_SHARES, 'standard_errors')
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_.+-]{0,63}')
# No depth camera has values beyond these; such a field is taken as a mistake (assumed).
_LARGEST = {
    'pixels': 16384,
    'focal': 1e6,
    'rate_hz': 10_000.0,
    'range_m': 1000.0,
    'a': 1.0,
    'b': 1.0,
    'c': 1.0,
    'd': 1.0,
    'n': 10.0,
    'sigma_x': 25.0,
    'frequency': 1e10,
    'raw_frames': 1000,
    'exposure_us': 10_000_000,
    'distortion': 100.0,
}
_STEEP = math.radians(60)  # the steepest incidence at which noise was measured


@dataclass(frozen=True)
class ProfileFile:
    """
    What a profile's file holds.

    Attributes
    ----------
    profile : Profile
        The camera.
    standard_errors : mapping
        By mode, then by coefficient (a, b, c, d, n, sigma_x, and those of `SURFACE_SHARES`): its
        standard error, None where it was not estimated.
    measured : mapping
        By mode: on what the noise was measured, for people; plain YAML values.
    provenance : mapping
        Where the profile comes from, for people; plain YAML values.

    """

    profile: Profile
    standard_errors: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    measured: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)


def shipped() -> list[str]:
    """Return the names of the profiles in the package; the built-in Flexx2 first."""
    return [BUILT_IN, *sorted(path.stem for path in (config_dir() / 'profiles').glob('*.yaml'))]


def find_profile(name: str | Path) -> Profile:
    """
    Return a shipped profile by name, or read one from a file.

    ``name`` is out of `shipped`, whatever its case, or the path of a file; empty: the Flexx2. A
    name goes before a file of the same name. Raises InputError as `load_profile`, after
    ``profile:``; for a name that is not shipped the message lists those that are.
    """
    known = str(name).lower()
    if known in ('', BUILT_IN):
        return flexx2()
    if known in shipped():
        return load_profile(config_dir() / 'profiles' / f'{known}.yaml')
    looks_like_a_name = '/' not in known and '.' not in known
    if looks_like_a_name and not is_regular_file(Path(name)):
        raise InputError(
            f'profile: must be one of {", ".join(shipped())} or the path of a file, '
            f'got {shown_path(name)}'
        )
    try:
        return load_profile(name)
    except InputError as error:
        raise InputError(f'profile: {error}') from error


def load_profile(path: str | Path) -> Profile:
    """
    Read a camera profile.

    Parameters
    ----------
    path : str or pathlib.Path
        A YAML file as `save_profile` writes it.

    Raises
    ------
    InputError
        When the file cannot be read, or a field is missing, unknown, of the wrong type or
        absurd; the message names the file and the field.

    """
    return read_profile(path).profile


def read_profile(path: str | Path) -> ProfileFile:
    """Read a camera profile and all that its file says; otherwise as `load_profile`."""
    path = Path(path)
    top = Section(f'{shown_path(path)}: ', '', read_config(path), _TOP, ('sensor', 'provenance'))
    view = top.section('intrinsics', _INTRINSICS)
    width, height = (view.whole(name, 1, _LARGEST['pixels']) for name in ('width', 'height'))
    fx, fy = (view.number(name, 1e-3, _LARGEST['focal']) for name in ('fx', 'fy'))
    cx, cy = (view.number(name, -_LARGEST['focal'], _LARGEST['focal']) for name in ('cx', 'cy'))
    distortion = view.numbers(
        'distortion', tuple(DISTORTION_MODELS), -_LARGEST['distortion'], _LARGEST['distortion']
    )
    camera = Intrinsics(width, height, fx, fy, cx, cy, tuple(distortion))
    sensor, cap = read_sensor(top, camera, path.parent)
    modes = top.mapping('modes')
    if not modes:
        raise top.wrong('modes', 'at least one mode')
    for name in modes:
        if not is_mode_name(name):
            raise InputError(
                f'{shown_path(path)}: modes: names must be a letter, then letters, digits, _ '
                f'. + -, got {shown(name)}'
            )
    names = [name.lower() for name in modes]
    if len(set(names)) != len(names):
        raise top.wrong('modes', 'names that differ by more than their case')
    errors, measured, all_modes = {}, {}, []
    for name in modes:
        row = top.section('modes', None).section(name, MODE_FIELDS, _OPTIONAL_MODE_FIELDS)
        surfaces, surface_errors = _read_surfaces(row)
        all_modes.append(_read_mode(name, row, sensor, cap, surfaces))
        errors[name] = _read_standard_errors(row) | surface_errors
        measured[name] = row.mapping('measured') if row.has('measured') else {}
    profile = Profile(top.text('model'), camera, tuple(all_modes))
    provenance = top.mapping('provenance') if top.has('provenance') else {}
    return ProfileFile(profile, errors, measured, provenance)


def save_profile(path: str | Path, content: ProfileFile) -> None:
    """
    Write a camera profile; the file is there whole or not at all.

    A mask of valid pixels is written beside it, as ``<name>_valid.npy``: as an image of the
    profile's size, whatever the image's size in which it was given.

    Parameters
    ----------
    path : str or pathlib.Path
        The YAML file, replaced if it exists.
    content : ProfileFile
        What to write.

    Raises
    ------
    InputError
        When the file cannot be written, `load_profile` would refuse it, or its modes differ in
        their `Sensor` or incidence cap, of which a file has one.

    """
    path = Path(path)
    camera, mask = content.profile.intrinsics, _mask(path, content.profile)
    mask_name = None if mask is None else f'{path.stem}_valid.npy'
    table = {
        'schema': SCHEMA,
        'model': content.profile.model,
        'intrinsics': {name: getattr(camera, name) for name in _INTRINSICS[:-1]}
        | {'distortion': list(camera.distortion)},
        'sensor': sensor_row(content.profile, mask_name),
        'modes': {mode.name: _mode_row(mode, content) for mode in content.profile.modes},
        'provenance': dict(content.provenance),
    }
    text = (
        '# A camera profile: what a camera measures, and with what noise (metres, radians, '
        'pixels).\n# sigma_z = a + b z + c z^2 + d z^n theta^2 / (pi/2 - theta)^2; sigma_x: '
        'of an edge.\n# null: not known.\n'
        + yaml.safe_dump(
            table, sort_keys=False, width=99, allow_unicode=True, default_flow_style=None
        )
    )
    with whole(path) as part:
        if mask is not None and mask_name is not None:
            write_mask(part.with_name(mask_name), mask)
        part.write_text(text, encoding='utf-8', errors='backslashreplace')
        try:
            read_profile(part)
        except InputError as error:
            raise InputError(str(error).replace(str(part), str(path))) from error
        if mask is not None and mask_name is not None:
            write_mask(path.with_name(mask_name), mask)


def _mask(path: Path, profile: Profile) -> ValidMask | None:
    # The mask in the profile's own image; what a file has once must be the same in all modes.
    first = profile.modes[0]
    for mode in profile.modes:
        if (mode.sensor, mode.noise.incidence_cap) != (first.sensor, first.noise.incidence_cap):
            raise InputError(
                f'{shown_path(path)}: sensor: must be the same in all modes, got others in '
                f'{first.name} and {mode.name}'
            )
    if profile.sensor.valid_mask is None:
        return None
    image = ~profile.sensor.valid_mask.outside(profile.intrinsics)
    if not image.any():
        raise InputError(
            f'{shown_path(path)}: sensor.valid_mask: must have a pixel that may have depth, got '
            "none within the profile's image"
        )
    return mask_of(image, profile.intrinsics)


def _mode_row(mode: Mode, content: ProfileFile) -> dict[str, Any]:
    errors = content.standard_errors.get(mode.name, {})
    surfaces = mode.noise.surfaces
    row: dict[str, Any] = {
        'rate_hz': mode.rate_hz,
        'range_m': [mode.range_min, mode.range_max],
        'modulation_hz': list(mode.modulation_hz) or None,
        'raw_frames': mode.raw_frames or None,
        'exposure_us': None
        if mode.exposure_us == _unknown_exposure(mode.rate_hz)
        else list(mode.exposure_us),
        'noise': {name: getattr(mode.noise, name) for name in COEFFICIENTS},
        'standard_errors': {name: errors.get(name) for name in COEFFICIENTS},
        'noise_from': mode.noise_from,
        'measured': dict(content.measured.get(mode.name, {})),
    }
    if surfaces is not None:
        row['surfaces'] = {name: getattr(surfaces, name) for name in _SURFACES[:-1]} | {
            'standard_errors': {name: errors.get(name) for name in SURFACE_SHARES}
        }
    return row


def _unknown_exposure(rate_hz: float) -> tuple[int, int]:
    # Microseconds: no longer than a frame.
    return 1, int(max(1.0, 1e6 / rate_hz))


def _read_standard_errors(mode: 'Section') -> dict[str, float | None]:
    if not mode.has('standard_errors'):
        return dict.fromkeys(COEFFICIENTS)
    return mode.section('standard_errors', COEFFICIENTS).errors()


def _read_surfaces(mode: 'Section') -> tuple[SurfaceNoise | None, dict[str, float | None]]:
    # And the standard errors.
    if not mode.has('surfaces'):
        return None, {}
    row = mode.section('surfaces', _SURFACES)
    white = row.number('white', 0.01, 1.0)
    shares = (row.number(name, 0.0, 1.0) for name in SURFACE_SHARES)
    return SurfaceNoise(white, *shares), row.section('standard_errors', SURFACE_SHARES).errors()


def _read_mode(
    name: str, row: 'Section', sensor: Sensor, cap: float, surfaces: SurfaceNoise | None
) -> Mode:
    rate = row.number('rate_hz', 1e-3, _LARGEST['rate_hz'])
    near, far = row.numbers('range_m', (2,), 1e-3, _LARGEST['range_m'])
    if near >= far:
        raise row.wrong('range_m', 'the nearer limit before the farther one')
    frequencies = row.numbers(
        'modulation_hz', (1, 2, 3), 1.0, _LARGEST['frequency'], optional=True
    )
    if frequencies and sensor.kind != 'tof':
        raise row.wrong('modulation_hz', f'null for a {KINDS[sensor.kind]}')
    raw_frames = row.whole('raw_frames', 1, _LARGEST['raw_frames'], optional=True)
    exposure = row.numbers('exposure_us', (2,), 1, _LARGEST['exposure_us'], optional=True)
    if exposure and not (exposure[0] <= exposure[1] and all(e == int(e) for e in exposure)):
        raise row.wrong('exposure_us', 'two whole numbers, the shorter one first')
    shortest, longest = exposure or _unknown_exposure(rate)
    noise = row.section('noise', COEFFICIENTS)
    values = {
        key: noise.number(key, 0.0 if key in ('d', 'sigma_x') else -_LARGEST[key], _LARGEST[key])
        for key in COEFFICIENTS
    }
    model = NoiseModel(**values, incidence_cap=cap, surfaces=surfaces)
    problem = sigma_problem(model, near, far)
    if problem:
        raise InputError(f'{noise.label}: {problem}')
    return Mode(
        name,
        rate,
        near,
        far,
        tuple(frequencies),
        raw_frames,
        (int(shortest), int(longest)),
        model,
        name,
        'profile',
        sensor,
        row.one_of('noise_from', tuple(NOISE_FROM)) if row.has('noise_from') else 'not_stated',
    )


def is_mode_name(name: Any) -> bool:
    """Say whether a mode can be called so: a letter, then letters, digits, _ . + -."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def sigma_problem(noise: NoiseModel, near: float, far: float) -> str | None:
    """
    Say what is wrong with a noise model from `near` to `far`, metres; None if nothing is.

    Right is a sigma_z that is positive at all depths (then, d not being negative, at all angles
    too), and below the depth itself up to 60 degrees.
    """
    z = np.geomspace(near, far, 2001)
    if noise.c:
        z = np.append(z, np.clip(-noise.b / (2 * noise.c), near, far))
    facing = noise.a + noise.b * z + noise.c * z**2
    lowest = int(facing.argmin())
    if not facing[lowest] > 0:
        return (
            f'sigma_z must be positive from {near:g} to {far:g} m, got {facing[lowest]:.3g} m '
            f'at {z[lowest]:.3g} m'
        )
    slant = (_STEEP / (math.pi / 2 - _STEEP)) ** 2
    excess = (facing + noise.d * z**noise.n * slant) / z
    worst = int(excess.argmax())
    if not excess[worst] < 1:
        return (
            f'sigma_z must be below the distance, got {excess[worst] * z[worst]:.3g} m at '
            f'{z[worst]:.3g} m and 60 degrees'
        )
    return None
