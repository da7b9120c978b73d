"""What `BatchCamera` is called with, for all environments or for each: checked and converted."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
import numpy as np
import warp as wp


def environments(num_envs: Any) -> int:
    """Return a number of environments; raise `InputError` if it is not one."""
    if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
        raise InputError(f'num_envs: must be a whole number from 1, got {shown(num_envs)}')
    return int(num_envs)


def device_named(name: str | None) -> Any:
    """Return the device of a name, or the preferred one; raise `InputError` for others."""
    try:
        return wp.get_preferred_device() if name is None else wp.get_device(name)
    except (RuntimeError, ValueError) as error:
        known = ', '.join(device.alias for device in wp.get_devices())
        raise InputError(f'device: must be one of {known}, got {shown(name)}') from error


def one_for_each(name: str, value: Any, kind: Any, num_envs: int) -> list[Any]:
    """
    Return an argument, one of a `kind` for all environments or a sequence of one for each, as N.

    Raises InputError, which names `name`, when it is neither.
    """
    if isinstance(value, kind):
        return [value] * num_envs
    if (
        not isinstance(value, Sequence | np.ndarray)
        or len(value) != num_envs
        or not all(isinstance(one, kind) for one in value)
    ):
        raise InputError(
            f'{name}: must be one, or one for each of the {num_envs} environments, got '
            f'{shown(value)}'
        )
    return list(value)


def seeds(seed: Any, num_envs: int) -> list[int]:
    """Return the seed of each environment, ``seed + i`` or ``seed[i]``, or raise `InputError`."""
    one = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    values = (
        [int(seed) + i for i in range(num_envs)]
        if one
        else one_for_each('seed', seed, int | np.integer, num_envs)
    )
    for value in values:
        if isinstance(value, bool) or not -(2**63) <= value < 2**63:
            raise InputError(f'seed: must be a whole number of 64 bits, got {shown(value)}')
    return values


def mask_of(env_mask: Any, num_envs: int) -> np.ndarray:
    """Return a mask of any library as (N,) bool, all when left out, or raise `InputError`."""
    if env_mask is None:
        return np.ones(num_envs, bool)
    mask = env_mask.numpy() if isinstance(env_mask, wp.array) else env_mask
    mask = np.asarray(mask.cpu() if hasattr(mask, 'cpu') else mask)
    if mask.dtype != bool or mask.shape != (num_envs,):
        raise InputError(
            f'env_mask: must be bool of shape ({num_envs},), got {mask.dtype} of shape '
            f'{mask.shape}'
        )
    return mask
