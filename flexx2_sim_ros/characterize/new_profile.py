"""Turn a characterization into a camera profile."""

from datetime import datetime, UTC
import math
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.characterize.analysis import Characterization, LATERAL_PERCENTILE, ModeResult
from flexx2_sim_ros.characterize.axial_fit import NAMES
from flexx2_sim_ros.characterize.surface_fit import FEWEST_BOARDS
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import is_mode_name, ProfileFile, sigma_problem
from flexx2_sim_ros.profiles.modes import Mode, NoiseModel, Profile
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np

_ASSUMED_RATE = 30.0  # Hz, where stamps say nothing


def to_profile(result: Characterization, model: str | None = None) -> ProfileFile:
    """
    Make a camera profile of what was found.

    Parameters
    ----------
    result : Characterization
        From `characterize`.
    model : str, optional
        The camera's name; by default that of ``result.camera`` if all modes are its own, else
        ``unnamed camera``. What recordings cannot say (kind, thresholds, and by mode range, rate,
        frequencies and exposure) is that camera's, too.

    Returns
    -------
    ProfileFile
        Its provenance has a list of notes: what could not be known and what was put instead.

    Raises
    ------
    InputError
        When no mode's fit can be run as a camera.

    """
    known, notes = result.camera, list[str]()
    modes, errors, measured = [], {}, {}
    for mode in result.modes:
        made = _mode(mode, known, notes)
        if made is None:
            continue
        modes.append(made)
        fit = mode.axial
        errors[mode.usecase] = {name: _rounded(fit.errors[name]) for name in NAMES} | {
            'sigma_x': _rounded(mode.sigma_x_error)
        }
        if mode.surfaces is not None:
            errors[mode.usecase] |= {k: _rounded(e) for k, e in mode.surfaces.errors.items()}
            notes += [f'{mode.usecase}: surfaces: {note}' for note in mode.surfaces.notes]
        else:
            notes.append(
                f'{mode.usecase}: surfaces: not known, needs boards of {FEWEST_BOARDS} '
                'reflectivities; all surfaces are assumed to have the noise of the white board'
            )
        measured[mode.usecase] = _measured(mode)
        notes += [f'{mode.usecase}: {note}' for note in fit.notes]
    if not modes:
        raise InputError(
            f'{result.folder}: no mode can be put into a profile:\n  ' + '\n  '.join(notes)
        )
    if model is None:
        own = {mode.name for mode in modes} <= set(known.names)
        model = known.model if own else 'unnamed camera'
    if result.cropped:
        notes.append(
            'intrinsics: the images differ in size and principal point, at the same focal '
            'lengths. They are taken as crops of one image, and the profile has the smallest '
            'image that contains them all'
        )
    provenance = {
        'made_by': f'flexx2_sim_ros {__version__}, flexx2 characterize fit',
        'date': datetime.now(UTC).strftime('%Y-%m-%d'),
        'recordings': result.folder.resolve().name,
        'method': 'Cai et al., COINS 2024, doi 10.1109/COINS61597.2024.10622644; least squares of '
        'relative residuals, standard errors by jackknife over recordings; sigma_x: '
        f'{LATERAL_PERCENTILE}th percentile over edges',
        'left_out': len(result.left_out),
        'notes': notes,
    }
    return ProfileFile(
        Profile(model, result.intrinsics, tuple(modes)), errors, measured, provenance
    )


def _mode(mode: ModeResult, camera: Profile, notes: list[str]) -> Mode | None:
    if not is_mode_name(mode.usecase):
        notes.append(
            f'{mode.usecase}: left out of the profile: its name must be a letter, then '
            'letters, digits, _ . + -'
        )
        return None
    sigma_x = mode.sigma_x
    if math.isnan(sigma_x):
        why = (
            f'{len(mode.edges)} edges that differ are too few'
            if mode.edges
            else 'no upright edge of the board was seen, or none moved from frame to frame'
        )
        notes.append(f'{mode.usecase}: sigma_x: not measured, because {why}; the profile has 0')
        sigma_x = 0.0
    noise = NoiseModel(
        **{name: _significant(value) for name, value in mode.axial.coefficients.items()},
        sigma_x=_significant(sigma_x),
        incidence_cap=camera.modes[0].noise.incidence_cap,
        surfaces=None if mode.surfaces is None else mode.surfaces.noise,
    )
    near, far = (_significant(distance) for distance in mode.axial.distances)
    # Boards at one distance: depth varies with noise and effects, and must not leave the range.
    middle = (near + far) / 2
    near, far = (_significant(end) for end in (min(near, 0.9 * middle), max(far, 1.1 * middle)))
    try:
        known = camera.mode(mode.usecase)
    except InputError:
        return _unknown(mode, noise, near, far, camera.sensor, notes)
    problem = sigma_problem(noise, known.range_min, known.range_max)
    if problem is None:
        near, far = known.range_min, known.range_max
    else:
        notes.append(
            f"{mode.usecase}: range_m: in the mode's own range {problem}; the profile has the "
            f'measured range, {near:g} to {far:g} m'
        )
    if _unusable(mode.usecase, noise, near, far, notes):
        return None
    return Mode(
        known.name,
        known.rate_hz,
        near,
        far,
        known.modulation_hz,
        known.raw_frames,
        known.exposure_us,
        noise,
        known.name,
        'characterize',
        camera.sensor,
    )


def _unknown(
    mode: ModeResult, noise: NoiseModel, near: float, far: float, sensor: Sensor, notes: list[str]
) -> Mode | None:
    if _unusable(mode.usecase, noise, near, far, notes):
        return None
    rate = (
        float(np.nanmedian([*(m.rate_hz for m in mode.measurements), math.nan]))
        if any(math.isfinite(m.rate_hz) for m in mode.measurements)
        else math.nan
    )
    if math.isnan(rate):
        notes.append(
            f'{mode.usecase}: rate_hz: unknown, needs several frames with stamps that rise; '
            f'assumed {_ASSUMED_RATE:g}'
        )
        rate = _ASSUMED_RATE
    notes.append(
        f'{mode.usecase}: range_m: the measured range, at least 10 % to either side of its '
        'middle; modulation, raw frames and exposure are not known'
    )
    rate = _significant(rate)
    return Mode(
        mode.usecase,
        rate,
        near,
        far,
        (),
        0,
        (1, max(1, int(1e6 / rate))),
        noise,
        mode.usecase,
        'characterize',
        sensor,
    )


def _unusable(usecase: str, noise: NoiseModel, near: float, far: float, notes: list[str]) -> bool:
    problem = sigma_problem(noise, near, far)
    if problem:
        notes.append(f'{usecase}: left out of the profile: {problem}')
    return problem is not None


def _measured(mode: ModeResult) -> dict[str, Any]:
    fit = mode.axial
    measurements = mode.measurements
    return {
        'recordings': len(measurements),
        'frames': sum(m.frames for m in measurements),
        'distances_m': [_rounded(d) for d in fit.distances],
        'incidence_deg': [_rounded(a) for a in fit.angles_deg],
        'edges': len(mode.edges),
        'n_interval_95': None if fit.interval_n is None else [_rounded(n) for n in fit.interval_n],
        'axial_kl_nats': _rounded(float(np.mean([cell.axial.raw for cell in mode.cells]))),
        'noise': (
            'the deviation of each frame from fitted planes, with what correlated neighbours hide'
            if mode.spatial
            else 'standard deviation over frames'
        ),
    }


def _significant(value: float) -> float:
    return float(f'{value:.6g}')


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f'{value:.3g}')
