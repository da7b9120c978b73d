"""What `Camera` is called with: effects, images, matrices and stamps, checked and converted."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from flexx2_sim_ros.effects import load_effects, parse_effects
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.physics.frame_state import EffectProtocol
import numpy as np

# Whole numbers with at least this median are millimetres: 100 m is too far for a depth camera.
_MILLIMETRES = 100
_CHANNEL = 16  # rows and columns: (H, W, 1), and not as many images one pixel wide


def as_effects(effects: Any) -> tuple[EffectProtocol, ...]:
    """
    Return effects, a table of their parameters by name, or the path of a YAML file, as effects.

    Raises InputError when it is none of these, or the table or file has errors.
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
    """
    Return an argument as (..., H, W) float32; masked values become NaN.

    Raises InputError if it has no images, or images with a channel axis.
    """
    array = as_array(name, value)
    if array.ndim < 2 or 0 in array.shape[-2:]:
        raise InputError(f'{name}: must have shape (..., H, W), not empty, got {array.shape}')
    # A few images one pixel wide are possible, many high ones are not.
    if array.ndim > 2 and array.shape[-1] == 1 and min(array.shape[-3:-1]) >= _CHANNEL:
        raise InputError(
            f'{name}: must have shape (..., H, W), without a channel axis, got {array.shape}'
        )
    if array.dtype != np.float32:
        # Values that float32 cannot hold become infinite: no return.
        with np.errstate(over='ignore'):
            array = array.astype(np.float32)
    if isinstance(value, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(value), np.float32(np.nan), array)
    return array


def as_clean_depth(value: Any) -> np.ndarray:
    """Return clean depth as `as_images` does; raise `InputError` for whole millimetres, too."""
    images = as_images('clean_depth', value)
    kind = np.asarray(value).dtype
    if kind.kind in 'iu' and (median := _median(images)) >= _MILLIMETRES:
        raise InputError(
            f'clean_depth: must be metres, got {kind} with a median of {median:.0f}, which looks '
            'like millimetres: divide by 1000'
        )
    return images


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


@dataclass(frozen=True)
class Views:
    """
    What one call of `Camera.capture` looks at, broadcast to common leading dimensions.

    Attributes
    ----------
    clean : numpy.ndarray
        (..., H, W) float32, metres.
    matrices : numpy.ndarray
        (..., 3, 3) camera matrices, pixels.
    stamps : numpy.ndarray
        (...) int64, nanoseconds.
    reflectivity : numpy.ndarray
        (..., H, W) float32, or (..., 1, 1) where none is given.
    matrices_given : numpy.ndarray
        The matrices with their own leading dimensions.
    environments : int
        How many of the leading dimensions are environments: all, or all but the last, which is
        time, if stamps were given with dimensions.

    """

    clean: np.ndarray
    matrices: np.ndarray
    stamps: np.ndarray
    reflectivity: np.ndarray
    matrices_given: np.ndarray
    environments: int


def as_views(clean_depth: Any, matrix: Any, stamp: Any, reflectivity: Any) -> Views:
    """Return the arguments of `Camera.capture`; raise `InputError` if they cannot be used."""
    clean = as_clean_depth(clean_depth)
    matrices = as_array('K', matrix)
    if matrices.ndim < 2 or matrices.shape[-2:] != (3, 3):
        raise InputError(f'K: must have shape (..., 3, 3), got {matrices.shape}')
    stamps = as_nanoseconds(stamp)
    if reflectivity is None:
        albedo = np.ones((1, 1), np.float32)
    else:
        albedo = as_images('reflectivity', reflectivity)
        if albedo.shape[-2:] != clean.shape[-2:]:
            raise InputError(
                f'reflectivity: must have the size of clean_depth, {clean.shape[-2:]}, got '
                f'{albedo.shape[-2:]}'
            )
    try:
        leading = np.broadcast_shapes(
            clean.shape[:-2], matrices.shape[:-2], stamps.shape, albedo.shape[:-2]
        )
    except ValueError as error:
        raise InputError(
            'leading dimensions do not broadcast: clean_depth '
            f'{clean.shape[:-2]}, K {matrices.shape[:-2]}, stamp {stamps.shape}, '
            f'reflectivity {albedo.shape[:-2]}'
        ) from error
    return Views(
        _broadcast(clean, leading + clean.shape[-2:]),
        _broadcast(matrices, leading + (3, 3)),
        _broadcast(stamps, leading),
        _broadcast(albedo, leading + albedo.shape[-2:]),
        matrices,
        len(leading) - (stamps.ndim > 0),
    )


def _broadcast(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    # np.broadcast_to takes longer than all the rest of `as_views`.
    return array if array.shape == shape else np.broadcast_to(array, shape)


def _median(depth: np.ndarray) -> float:
    # Of the pixels with depth; 0 if there are none.
    positive = depth[depth > 0]
    return float(np.median(positive)) if positive.size else 0.0
