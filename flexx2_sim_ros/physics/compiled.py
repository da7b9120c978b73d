"""Formulas compiled for loops over images on the CPU."""

import math
from typing import Any

from flexx2_sim_ros.formulas import Backend
from numba import njit
import numpy as np


@njit(inline='always')
def _where(condition, first, second):  # type: ignore[no-untyped-def]
    return first if condition else second


@njit(inline='always')
def _bits_of(x):  # type: ignore[no-untyped-def]
    return np.float32(x).view(np.int32)


@njit(inline='always')
def _float_of(bits):  # type: ignore[no-untyped-def]
    return np.int32(bits).view(np.float32)


_NAMES: dict[str, Any] = {
    'where': _where,
    'least': min,
    'most': max,
    'size': abs,
    'root': math.sqrt,
    'floor': np.floor,
    'nearest': np.rint,
    'f32': np.float32,
    'i32': np.int32,
    'u32': np.uint32,
    'u64': np.uint64,
    'bits_of': _bits_of,
    'float_of': _float_of,
}

# Inlined where it is called: loops over images become vector instructions.
compiled = Backend(_NAMES, lambda value: value, njit(inline='always'))
