"""Formulas compiled for Warp's kernels."""

from types import FunctionType, GenericAlias
from typing import Any

from flexx2_sim_ros.batch.arrays import (
    at,
    on_cuda,
    quick_cosine,
    quick_exp2,
    quick_log2,
    quick_sine,
)
from flexx2_sim_ros.formulas import Backend, fastmath, random_numbers
from flexx2_sim_ros.physics import philox
import numpy as np
from numpy.typing import NDArray
import warp as wp

_TYPES: dict[Any, Any] = {
    bool: wp.bool,
    int: wp.int32,
    float: wp.float32,
    np.int32: wp.int32,
    np.int64: wp.int64,
    np.uint32: wp.uint32,
    np.uint64: wp.uint64,
    np.float32: wp.float32,
    np.float64: wp.float64,
    np.ndarray: wp.vec3f,  # e.g. one number for each modulation frequency
    NDArray[np.float32]: wp.array(dtype=wp.float32),
    NDArray[np.int64]: wp.array(dtype=wp.int64),
}


@wp.func
def _both(first: wp.bool, second: wp.bool) -> wp.bool:
    return first and second


@wp.func
def _bits_of(x: wp.float32) -> wp.int32:
    return wp.cast(x, wp.int32)


@wp.func
def _float_of(bits: wp.int32) -> wp.float32:
    return wp.cast(bits, wp.float32)


_NAMES: dict[str, Any] = {
    'where': wp.where,
    'both': _both,
    'least': wp.min,
    'most': wp.max,
    'size': wp.abs,
    'root': wp.sqrt,
    'floor': wp.floor,
    'ceiling': wp.ceil,
    'nearest': wp.rint,
    'f32': wp.float32,
    'f64': wp.float64,
    'i32': wp.int32,
    'u32': wp.uint32,
    'u64': wp.uint64,
    'at': at,
    'bits_of': _bits_of,
    'float_of': _float_of,
}


def _constant(value: Any) -> Any:
    if isinstance(value, tuple):
        return wp.constant(wp.types.vector(len(value), wp.float32)(*map(float, value)))
    # As Python's own numbers: Warp writes NumPy's NaN in a way that does not compile.
    plain = value.item() if isinstance(value, np.generic) else value
    return wp.constant(_TYPES[type(value)](plain))


def _finish(function: FunctionType) -> Any:
    function.__annotations__ = {
        name: _TYPES[kind]
        if kind in _TYPES
        else GenericAlias(tuple, tuple(_TYPES[one] for one in kind.__args__))
        for name, kind in function.__annotations__.items()
    }
    return wp.func(function)


compiled = Backend(_NAMES, _constant, _finish)


# A GPU computes some functions in one instruction, to about 2^-21: enough for phases and for
# sigma, not for the logarithm of a number close to 1, as in normals.
_series_exp2 = compiled(fastmath.exp2)
_series_log2 = compiled(fastmath.log2)
_series_cos_sin = compiled(fastmath.cos_sin_turns)


@wp.func
def _power(x: wp.float32, exponent: wp.float32) -> wp.float32:
    if on_cuda():
        return quick_exp2(exponent * quick_log2(x))
    return _series_exp2(exponent * _series_log2(x))


@wp.func
def _exp2(y: wp.float32) -> wp.float32:
    if on_cuda():
        return quick_exp2(y)
    return _series_exp2(y)


@wp.func
def _cos_sin_turns(turns: wp.float32) -> tuple[wp.float32, wp.float32]:
    cosine, sine = _series_cos_sin(turns)
    if on_cuda():
        cosine = quick_cosine(turns)
        sine = quick_sine(turns)
    return cosine, sine


compiled.replace(fastmath.power, _power)
compiled.replace(fastmath.exp2, _exp2)
compiled.replace(fastmath.cos_sin_turns, _cos_sin_turns)


arccos = compiled(fastmath.arccos)
log_from_zero = compiled(fastmath.log_from_zero)
uniform = compiled(random_numbers.uniform)
_philox4x32 = compiled(random_numbers.philox4x32)
_normal_pair = compiled(random_numbers.normal_pair)
_unit_draw = compiled(random_numbers.unit_draw)


@wp.func
def philox4x32(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Return four uint32 for a counter of four and a key of two uint32."""
    u0, u1, u2, u3 = _philox4x32(counter[0], counter[1], counter[2], counter[3], key[0], key[1])
    return wp.vec4ui(u0, u1, u2, u3)


@wp.func
def counter_of(index: wp.int32, stream: wp.uint32, stamp: wp.int64) -> wp.vec4ui:
    """Return the counter of block ``index`` of a stream at a stamp."""
    return wp.vec4ui(wp.uint32(index), stream, wp.uint32(stamp), wp.uint32(stamp >> wp.int64(32)))


@wp.func
def four_normals(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4f:
    """Return the four standard normals of one counter."""
    u = philox4x32(counter, key)
    a, b = _normal_pair(u[0], u[1])
    c, d = _normal_pair(u[2], u[3])
    return wp.vec4f(a, b, c, d)


@wp.func
def one_of(values: wp.vec4f, which: wp.int32) -> wp.float32:
    """Return an element; a plain index would put the vector into memory on CUDA."""
    return wp.where(
        which < 2,
        wp.where(which == 0, values[0], values[1]),
        wp.where(which == 2, values[2], values[3]),
    )


@wp.func
def edge_draw(counter: wp.vec4ui, key: wp.vec2ui, laplace: wp.float32) -> wp.float32:
    """Return a draw of unit variance: normal, or with probability ``laplace`` Laplacian."""
    u = philox4x32(counter, key)
    return _unit_draw(u[0], u[1], u[2], u[3], laplace)


# What the numbers are for, as in `physics.philox`.
AXIAL = wp.constant(wp.uint32(philox.STREAM_AXIAL))
ROW_EDGES = wp.constant(wp.uint32(philox.STREAM_ROW_EDGES))
COLUMN_EDGES = wp.constant(wp.uint32(philox.STREAM_COLUMN_EDGES))
