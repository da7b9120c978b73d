"""What `Camera` is called with: effects, images, matrices and stamps, checked and converted."""

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from flexx2_sim_ros.effects import load_effects, parse_effects
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.physics.frame_state import EffectProtocol
import numpy as np


def as_effects(effects: Any) -> tuple[EffectProtocol, ...]:
    """
    Return effects as a tuple of effects.

    Parameters
    ----------
    effects : sequence of Effect, mapping, str or pathlib.Path
        Effects, a table of their parameters by name, or the path of a YAML file.

    Raises
    ------
    InputError
        When it is none of these, or the table or file has errors.

    """
    if isinstance(effects, str | PathLike | Mapping):
        if isinstance(effects, Mapping):
            return parse_effects(effects)
        return load_effects(Path(effects))
    chosen = tuple(effects) if isinstance(effects, Iterable) else (effects,)
    if not all(hasattr(effect, 'apply') and not isinstance(effect, type) for effect in chosen):
        raise InputError(
            'effects: must be a sequence of effects, a table of their parameters or the path '
            f'of a file, got {shown(effects)}'
        )
    return chosen


def as_array(name: str, value: Any) -> np.ndarray:
    """Return an argument as an array of real numbers; raise `InputError` if it is not one."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(f'{name}: not an array of numbers: {error}') from error
    if array.dtype.kind not in 'fiu':
        raise InputError(f'{name}: must be real numbers, got dtype {array.dtype}')
    return array


def as_images(name: str, value: Any) -> np.ndarray:
    """Return an argument as (..., H, W) float32; raise `InputError` if it has no images."""
    array = as_array(name, value)
    if array.ndim < 2 or 0 in array.shape[-2:]:
        raise InputError(f'{name}: must have shape (..., H, W), not empty, got {array.shape}')
    # Values that float32 cannot hold become infinite: no return.
    with np.errstate(over='ignore'):
        return array.astype(np.float32, copy=False)


def as_nanoseconds(stamp: Any) -> np.ndarray:
    """Return stamps as int64 nanoseconds; raise `InputError` for values that are no times."""
    stamps = as_array('stamp', stamp)
    if stamps.dtype.kind == 'f':
        if not np.isfinite(stamps).all():
            raise InputError('stamp: must be seconds, got a value that is not finite')
        stamps = np.rint(stamps.astype(np.float64) * 1e9)
        if np.abs(stamps).max(initial=0) > 2**62:
            raise InputError('stamp: must be seconds, got a value beyond 146 years')
    return stamps.astype(np.int64)
