"""The section `sensor` of a profile's file: read and written."""

from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import NoiseModel, Profile
from flexx2_sim_ros.profiles.section import Section
from flexx2_sim_ros.profiles.sensor import DEFAULT_SENSOR, KINDS, Sensor
from flexx2_sim_ros.profiles.valid_mask import read_mask

_FIELDS = (
    'kind',
    'jump_share',
    'steep_share',
    'incidence_cap_deg',
    'neighbourhood_px',
    'zero_at_sigma_m',
    'full_scale_amplitude',
    'readout_us',
    'valid_region_px',
    'valid_mask',
)
# What no depth camera has: beyond these a field is taken for a mistake (design).
_LARGEST = {
    'share': 1.0,
    'neighbourhood_px': 127,
    'zero_at_sigma_m': 100.0,
    'full_scale_amplitude': 1e9,
    'readout_us': 10_000_000,
    'valid_region_px': 16384,
}


def sensor_row(profile: Profile, mask_name: str | None) -> dict[str, Any]:
    """Return the section of a profile; ``mask_name`` is the file of its mask, if it has one."""
    sensor, camera = profile.sensor, profile.intrinsics
    corners = [
        [round(x * camera.fx + camera.cx, 6), round(y * camera.fy + camera.cy, 6)]
        for x, y in sensor.valid_region
    ]
    own = {name: getattr(sensor, name) for name in _FIELDS if hasattr(sensor, name)}
    return own | {
        'incidence_cap_deg': round(math.degrees(profile.modes[0].noise.incidence_cap), 9),
        'valid_region_px': corners or None,
        'valid_mask': mask_name,
    }


def read_sensor(top: Section, camera: Intrinsics, folder: Path) -> tuple[Sensor, float]:
    """
    Read the section, and the incidence cap in radians.

    What the file does not give stays as it is by default. ``top`` is the whole file, ``camera``
    the profile's, and ``folder`` where the file lies; the name of its mask is relative to it.
    Raises InputError, which names the file and the field.
    """
    cap = NoiseModel.incidence_cap
    if not top.has('sensor'):
        return DEFAULT_SENSOR, cap
    row = top.section('sensor', (), _FIELDS)
    given: dict[str, Any] = {}
    if row.has('kind'):
        given['kind'] = row.one_of('kind', tuple(KINDS))
    for name in ('jump_share', 'steep_share'):
        if row.has(name):
            given[name] = row.number(name, 1e-6, _LARGEST['share'])
    if row.has('neighbourhood_px'):
        given['neighbourhood_px'] = row.whole('neighbourhood_px', 1, _LARGEST['neighbourhood_px'])
    for name in ('zero_at_sigma_m', 'full_scale_amplitude'):
        if row.has(name):
            given[name] = row.number(name, 1e-6, _LARGEST[name])
    if row.has('readout_us'):
        given['readout_us'] = row.number('readout_us', 0, _LARGEST['readout_us'])
    if row.has('incidence_cap_deg'):
        cap = math.radians(row.number('incidence_cap_deg', 1.0, 89.9))
    if row.has('valid_region_px'):
        corners = row.corners('valid_region_px', _LARGEST['valid_region_px'])
        given['valid_region'] = tuple(
            ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy) for u, v in corners
        )
    if row.has('valid_mask') and not row.is_null('valid_mask'):
        name = row.text('valid_mask')
        try:
            given['valid_mask'] = read_mask(folder / name, camera)
        except InputError as error:
            raise InputError(f'{row.label}.valid_mask: {error}') from error
    return replace(DEFAULT_SENSOR, **given), cap
