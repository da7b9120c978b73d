"""Limits: memory that a file may take when it is decompressed, time of a consumer, numbers."""

import os
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError, shown

CONSUMER_SECONDS = 120.0  # that a consumer may take for a recording, unless the user says more
_EXPANSION = 20  # times the size of a file; noisy depth compresses by a factor of 2


def limit_bytes(variable: str, default_mb: int) -> int:
    """
    Return a limit in bytes, which an environment variable sets in MB.

    ``default_mb`` holds where that is not set. Raises InputError when it is not a whole number of
    MB.
    """
    text = os.environ.get(variable, '')
    if not text:
        return default_mb << 20
    if not (text.isdecimal() and len(text) < 9 and int(text)):
        raise InputError(f'{variable}: must be a whole number of MB, got {shown(text)}')
    return int(text) << 20


def file_limit_bytes(variable: str, default_mb: int, packed: int) -> int:
    """Return `limit_bytes`, or 20 times the `packed` bytes of a whole file if that is more."""
    return max(limit_bytes(variable, default_mb), _EXPANSION * packed)


def is_finite(value: Any) -> bool:
    """Say whether a value is a number, no bool, that a float can hold and that is not infinite."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and -sys.float_info.max <= value <= sys.float_info.max  # never true of NaN


def check_whole(field: str, value: Any, low: int, high: int = 10**9) -> None:
    """Raise `InputError` if a value is no whole number from ``low`` to ``high``."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InputError(
            f'{field}: must be a whole number from {low} to {high}, got {shown(value)}'
        )
