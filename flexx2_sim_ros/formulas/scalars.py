"""
What formulas may use beside arithmetic.

These are the definitions for NumPy numbers and arrays. Other backends have definitions of their
own for the same names, so a formula calls them by these names. Constants are made with the types
below: a plain 0.5 would be float64 to one of the backends.
"""

from typing import Any

import numpy as np

where: Any = np.where
both: Any = np.logical_and
least: Any = np.minimum
most: Any = np.maximum
size: Any = np.abs
root: Any = np.sqrt
floor: Any = np.floor
ceiling: Any = np.ceil
nearest: Any = np.rint
f32: Any = np.float32
f64: Any = np.float64
i32: Any = np.int32
u32: Any = np.uint32
u64: Any = np.uint64


def at(image: Any, i: Any) -> Any:
    """Return element ``i``, counted from 0, of a flat array."""
    return image[i]


def bits_of(x: Any) -> Any:
    """Return the bits of float32 as int32."""
    return np.asarray(x, np.float32).view(np.int32)[()]


def float_of(bits: Any) -> Any:
    """Return the float32 of these bits."""
    return np.asarray(bits, np.int32).view(np.float32)[()]
