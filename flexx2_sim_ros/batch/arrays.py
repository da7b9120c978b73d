"""
Element access for loops that the CPU compiler turns into vector instructions.

Warp's own ``a[i]`` takes negative indices and any stride, which keeps loops over it scalar on
the CPU (eight times slower, measured). These take contiguous one-dimensional arrays and indices
from 0. In Warp's debug mode both check their bounds.
"""

import warp as wp

_GET = 'assert(i >= 0 && i < a.shape[0]); return a.data[i];'
_PUT = 'assert(i >= 0 && i < a.shape[0]); a.data[i] = v;'


@wp.func_native(_GET)
def at(a: wp.array(dtype=wp.float32), i: wp.int32) -> wp.float32:
    """Return an element."""
    ...


@wp.func_native(_GET)
def at_byte(a: wp.array(dtype=wp.uint8), i: wp.int32) -> wp.uint8:
    """Return an element."""
    ...


@wp.func_native(_GET)
def at_word(a: wp.array(dtype=wp.uint16), i: wp.int32) -> wp.uint16:
    """Return an element."""
    ...


@wp.func_native(_PUT)
def put(a: wp.array(dtype=wp.float32), i: wp.int32, v: wp.float32) -> None:
    """Write an element."""
    ...


@wp.func_native(_PUT)
def put_byte(a: wp.array(dtype=wp.uint8), i: wp.int32, v: wp.uint8) -> None:
    """Write an element."""
    ...


@wp.func_native(_PUT)
def put_word(a: wp.array(dtype=wp.uint16), i: wp.int32, v: wp.uint16) -> None:
    """Write an element."""
    ...
