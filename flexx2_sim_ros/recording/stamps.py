"""The times of a recording's frames: the keys ``stamp`` and ``stamp_ns`` of its file."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from flexx2_sim_ros.errors import InputError
import numpy as np

LONGEST = 9_000_000_000  # seconds that int64 nanoseconds can hold, rounded down
_SAME_NANOSECONDS = 1000


def read_stamps(path: str | Path, arrays: Mapping[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """
    Check the stamps of a file that has them.

    Parameters
    ----------
    path : str or pathlib.Path
        The file, for messages.
    arrays : mapping of str to numpy.ndarray
        Its arrays: ``stamp``, seconds, or ``stamp_ns``, nanoseconds, or both.

    Returns
    -------
    stamp : numpy.ndarray
        (T,) float64, seconds.
    stamp_ns : numpy.ndarray
        (T,) int64, nanoseconds.

    Raises
    ------
    InputError
        When they are no finite numbers (T,), or differ; the message names file and key.

    """
    given = {key: arrays[key] for key in ('stamp', 'stamp_ns') if key in arrays}
    for key, values in given.items():
        if values.dtype.kind not in 'fiu':
            raise InputError(
                f'{path}: {key}: must be numbers (T,), the times of frames, got dtype '
                f'{values.dtype}'
            )
        if values.ndim != 1:
            raise InputError(
                f'{path}: {key}: must be finite numbers (T,), got shape {values.shape}'
            )
        if not np.isfinite(values).all():
            raise InputError(f'{path}: {key}: must be finite, got NaN or infinity')
    if 'stamp_ns' not in given:
        seconds = given['stamp'].astype(np.float64)
        if (np.abs(seconds) > LONGEST).any():
            raise InputError(
                f'{path}: stamp: must be seconds, at most {LONGEST:g}, got '
                f'{np.abs(seconds).max():g}'
            )
        return seconds, np.rint(seconds * 1e9).astype(np.int64)
    exact = given['stamp_ns']
    if exact.dtype.kind not in 'iu':
        raise InputError(f'{path}: stamp_ns: must be whole numbers, got dtype {exact.dtype}')
    exact = exact.astype(np.int64)
    stamp = given.get('stamp', exact / 1e9).astype(np.float64)
    if stamp.shape != exact.shape or (np.abs(stamp * 1e9 - exact) > _SAME_NANOSECONDS).any():
        raise InputError(f'{path}: stamp: must be stamp_ns in seconds, got other times')
    return stamp, exact


def stamps_of(arrays: Mapping[str, np.ndarray | None]) -> list[int]:
    """Return the stamps of a recording as its messages have them; none where they cannot be."""
    for key, unit in (('stamp_ns', 1), ('stamp', 1e9)):
        array = arrays.get(key)
        if array is not None and array.dtype.kind in 'fiu':
            with suppress(OverflowError, ValueError):  # Not finite: refused later.
                return [round(stamp * unit) for stamp in array.ravel().tolist()]
    return []
