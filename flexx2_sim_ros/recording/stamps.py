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
    Check the stamps of a file: return (T,) float64 seconds and (T,) int64 nanoseconds.

    ``arrays`` has ``stamp``, seconds, or ``stamp_ns``, nanoseconds, or both. Raises InputError,
    which names file and key, when they are no finite numbers (T,), or differ.
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


def in_time(stamp_ns: np.ndarray, path: str) -> tuple[np.ndarray | None, list[str]]:
    """
    Find the order of time of frames, each stamp once, from their (T,) stamps in a file.

    Returned are the numbers of frames by stamp, the first of each stamp, and notes on which frames
    repeat a stamp or come late. The order is None where nothing is to be changed: stamps rise, or
    begin again, as those of a simulation that was reset. ``path`` is for the notes.
    """
    if (np.diff(stamp_ns) > 0).all() or _begins_again(stamp_ns):
        return None, []
    _, order = np.unique(stamp_ns, return_index=True)
    repeated = np.setdiff1d(np.arange(len(stamp_ns)), order)
    kept = np.sort(order)
    late = kept[stamp_ns[kept] < np.maximum.accumulate(stamp_ns[kept])]
    whats = (
        (repeated, 'the stamp of another frame: left out'),
        (late, 'a stamp before that of an earlier frame: sorted by stamp'),
    )
    return order, [
        f'{path}: stamp: frames {_some(numbers)} ({len(numbers)} in all): {what}'
        for numbers, what in whats
        if len(numbers)
    ]


def _begins_again(stamps: np.ndarray) -> bool:
    # Goes back to the first stamp or before it, and rises again from there.
    first, last = stamps[0], stamps[0]
    for stamp, after in zip(stamps[1:-1].tolist(), stamps[2:].tolist(), strict=True):
        if stamp <= first and stamp < after < last:
            return True
        last = max(last, stamp)
    return False


def _some(numbers: np.ndarray) -> str:
    text = ', '.join(map(str, numbers[:8].tolist()))
    return f'{text}, ...' if len(numbers) > 8 else text
