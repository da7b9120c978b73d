"""Read the files of a diagnosis."""

from collections.abc import Iterable
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_bytes
from flexx2_sim_ros.effects import Effect, load_effects, parse_effects
from flexx2_sim_ros.effects.time_offset import changing
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.gap.data.frames import Arrival
from flexx2_sim_ros.gap.data.given import given_effects, Table
from flexx2_sim_ros.gap.data.prior import USUAL
from flexx2_sim_ros.gap.inference.probability import EXPLAINED
from flexx2_sim_ros.gap.report.age import arrival_of
from flexx2_sim_ros.limits import is_finite

_SCHEMAS = 1, 2  # the keys that are read are the same
_LARGEST = 50_000_000  # bytes of a diagnosis.json


@dataclass(frozen=True)
class Diagnosed:
    """
    An earlier diagnosis.

    * `table`: the content of ``diagnosis.json``, which describes `verdict`, `known`, `pose_prior`,
      `pose_held`, `full_scale` and `noise_factor`.
    * `effects`: the effects of ``effects.yaml`` that change images.
    * `checksums`: names of the recordings that the effects were fitted to, by checksum.
    * `unsummed`: names of recordings without a checksum (diagnoses of older versions).
    * `arrival`: how late images arrive; None where the diagnosis does not say.
    """

    verdict: str
    effects: tuple[Effect, ...]
    known: Table
    pose_prior: tuple[float, float]
    pose_held: bool
    full_scale: float | None
    checksums: dict[str, str]
    unsummed: frozenset[str]
    arrival: Arrival | None
    noise_factor: float
    table: dict[str, Any]

    def effects_to_check(self) -> tuple[Effect, ...]:
        """
        Return the effects that change images: all except pose errors.

        Raises `InputError` when there is no such effect.
        """
        effects = tuple(effect for effect in self.effects if effect.role != 'pose')
        if not effects:
            why = f'none: its verdict is {shown(self.verdict)}'
            if self.verdict in EXPLAINED:
                why = 'only an error of the poses, which belongs to its recordings'
            raise InputError(f'DIAGNOSIS: must have effects to check, got {why}')
        return effects

    def typical_effects(self) -> tuple[Effect, ...]:
        """
        Return `effects` with numbers alone: curves and maps in the form of the catalogue.

        Raises `InputError` when the calibration is not what a diagnosis writes.
        """
        try:
            rows = (self.table.get('calibration') or {}).get('effects', [])
            typical = parse_effects({row['name']: row['typical'] for row in rows}, 'calibration')
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(f'DIAGNOSIS: diagnosis.json: calibration: {error}') from error
        by_name = {one.name: one for one in typical}
        return tuple(by_name.get(one.name, one) if one.forms else one for one in self.effects)


def read_diagnosis(folder: Path) -> Diagnosed:
    """
    Read ``diagnosis.json`` and ``effects.yaml`` of a folder of `flexx2 gap diagnose`.

    Raises `InputError` when a file is missing, cannot be read, or is not what a diagnosis writes.
    """
    path = folder / 'diagnosis.json'
    table = _read_json(path)
    effects = load_effects(folder / 'effects.yaml')
    try:
        return diagnosed(table, effects)
    except InputError as error:
        raise InputError(f'{shown_path(path)}: {error}') from error


def diagnosed(table: Any, effects: Iterable[Effect]) -> Diagnosed:
    """
    Return what a diagnosis found, from ``diagnosis.json`` and the effects of ``effects.yaml``.

    Raises `InputError` when the table is not what a diagnosis writes.
    """
    if not isinstance(table, dict) or table.get('schema') not in _SCHEMAS:
        got = table.get('schema') if isinstance(table, dict) else table
        raise InputError(f'schema: must be 1 or 2, got {shown(got)}')
    rows = table.get('recordings')
    if not isinstance(rows, list) or not all(
        isinstance(row, dict) and isinstance(row.get('name'), str) for row in rows
    ):
        raise InputError('recordings: must be a list of tables with a name')
    used = [row for row in rows if row.get('used')]
    settings = table.get('settings', {})
    if not isinstance(settings, dict):
        raise InputError(f'settings: must be a table, got {shown(settings)}')
    known = settings.get('known', {})
    try:
        given_effects(known)
    except (InputError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f'settings: {error}') from error
    full, gap = settings.get('full_scale'), table.get('gap')
    full = None if full is None else _above_zero('settings: full_scale', full, ' or null')
    # Older versions did not write it.
    noise_factor = gap.get('noise_factor', 1.0) if isinstance(gap, dict) else 1.0
    return Diagnosed(
        verdict=str(table.get('verdict', '')),
        effects=changing(effects),
        known=known,
        pose_prior=_pose_prior(settings.get('pose_prior', USUAL)),
        pose_held=settings.get('pose_held') is True,
        full_scale=full,
        checksums={str(row['checksum']): row['name'] for row in used if 'checksum' in row},
        unsummed=frozenset(row['name'] for row in used if 'checksum' not in row),
        arrival=arrival_of(table.get('age')),
        noise_factor=_above_zero('gap: noise_factor', noise_factor),
        table=table,
    )


def _read_json(path: Path) -> Any:
    try:
        return json.loads(read_bytes(path, _LARGEST))
    except InputError as error:
        raise InputError(f'{shown_path(path)}: {error}') from error
    except FileNotFoundError as error:
        raise InputError(
            f'DIAGNOSIS: must be a folder that flexx2 gap diagnose has written, got no '
            f'{shown_path(path)}'
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f'{shown_path(path)}: cannot be read: {shown(str(error))}') from error


def _pose_prior(value: Any) -> tuple[float, float]:
    two = isinstance(value, list | tuple) and len(value) == 2
    if not two or not all(is_finite(one) and one > 0 for one in value):
        raise InputError(
            f'settings: pose_prior: must be metres and degrees above 0, got {shown(value)}'
        )
    return float(value[0]), float(value[1])


def _above_zero(field: str, value: Any, or_null: str = '') -> float:
    if not (is_finite(value) and value > 0):
        raise InputError(f'{field}: must be a number above 0{or_null}, got {shown(value)}')
    return float(value)
