"""
Formulas, and loops over images that use them, compiled for the CPU.

numba is imported at the first call of any of them: a batch on a GPU does without it.
"""

from collections.abc import Callable
from functools import cached_property
import math
from types import CodeType, FunctionType
from typing import Any

from flexx2_sim_ros.formulas import Backend
import numpy as np


class Lazy:
    """
    A function, in the language of numba, that is compiled at its first call, with those it calls.

    ``make`` compiles it; it is called once.
    """

    def __init__(self, function: Any, make: Callable[[Any], Any]) -> None:
        """Compile nothing yet."""
        self.__doc__ = function.__doc__
        self._function, self._make = function, make

    @cached_property
    def made(self) -> Any:
        """Return the compiled function."""
        _make_names(self._function)
        return self._make(self._function)

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function."""
        return self.made(*args)

    def __getattr__(self, name: str) -> Any:
        """Return what numba says of it."""
        if name.startswith('_'):
            raise AttributeError(name)
        return getattr(self.made, name)


def _make_names(function: Any) -> None:
    # numba looks functions up in the globals of those that call them.
    names, codes = function.__globals__, [function.__code__]
    while codes:
        code = codes.pop()
        codes += [one for one in code.co_consts if isinstance(one, CodeType)]
        for name in code.co_names:
            value = names.get(name)
            if isinstance(value, Lazy):
                names[name] = value.made
            elif isinstance(called := getattr(value, 'py_func', None), FunctionType):
                _make_names(called)


def _inlined(function: Any) -> Any:
    from numba import njit

    return njit(inline='always')(function)


def inlined(function: Any) -> Lazy:
    """Compile a function into those that call it: their loops become vector instructions."""
    return Lazy(function, _inlined)


@inlined
def _where(condition, first, second):  # type: ignore[no-untyped-def]
    return first if condition else second


@inlined
def _both(first, second):  # type: ignore[no-untyped-def]
    return first & second


@inlined
def _at(image, i):  # type: ignore[no-untyped-def]
    return image[i]


@inlined
def _bits_of(x):  # type: ignore[no-untyped-def]
    return np.float32(x).view(np.int32)


@inlined
def _float_of(bits):  # type: ignore[no-untyped-def]
    return np.int32(bits).view(np.float32)


_NAMES: dict[str, Any] = {
    'where': _where,
    'both': _both,
    'least': min,
    'most': max,
    'size': abs,
    'root': math.sqrt,
    'floor': np.floor,
    'ceiling': np.ceil,
    'nearest': np.rint,
    'f32': np.float32,
    'f64': np.float64,
    'i32': np.int32,
    'u32': np.uint32,
    'u64': np.uint64,
    'at': _at,
    'bits_of': _bits_of,
    'float_of': _float_of,
}

compiled = Backend(_NAMES, lambda value: value, inlined)


def loop(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """
    Compile a loop over images, to be kept on disk until its code or that of a formula changes.

    It returns a decorator of a function; the options are those of `numba.njit`. numba itself
    compares the file of the loop alone. So the name under which it keeps the loop gets a digest of
    all that the loop calls. A loop that cannot be kept is compiled in each process.
    """

    def compile_loop(function: Callable[..., Any]) -> Lazy:
        def make(one: Callable[..., Any]) -> Any:
            from flexx2_sim_ros.physics.kept import kept_loop

            return kept_loop(one, options)

        return Lazy(function, make)

    return compile_loop
