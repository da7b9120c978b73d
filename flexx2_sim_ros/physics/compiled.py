"""Formulas, and loops over images that use them, compiled for the CPU."""

from collections.abc import Callable
from contextlib import suppress
import hashlib
import math
import pickle
from types import CodeType, FunctionType
from typing import Any

from flexx2_sim_ros.formulas import Backend
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
import numpy as np


@njit(inline='always')
def _where(condition, first, second):  # type: ignore[no-untyped-def]
    return first if condition else second


@njit(inline='always')
def _both(first, second):  # type: ignore[no-untyped-def]
    return first & second


@njit(inline='always')
def _at(image, i):  # type: ignore[no-untyped-def]
    return image[i]


@njit(inline='always')
def _bits_of(x):  # type: ignore[no-untyped-def]
    return np.float32(x).view(np.int32)


@njit(inline='always')
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

# Inlined where it is called: loops over images become vector instructions.
compiled = Backend(_NAMES, lambda value: value, njit(inline='always'))


class _Files(IndexDataCacheFile):
    """Files of numba's cache with a checksum: damaged machine code would run."""

    def _save_data(self, name: str, data: Any) -> None:
        packed = self._dump(data)  # type: ignore[no-untyped-call]
        checked = hashlib.sha256(packed).digest(), packed
        super()._save_data(name, checked)  # type: ignore[no-untyped-call]

    def _load_data(self, name: str) -> Any:
        digest, packed = super()._load_data(name)  # type: ignore[no-untyped-call]
        if digest != hashlib.sha256(packed).digest():
            raise ValueError('damaged')
        return pickle.loads(packed)  # noqa: S301 (as numba does)


class _Cache(FunctionCache):
    """What numba keeps of a loop on disk, where it can be written."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file.__class__ = _Files

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # Damaged files raise anything. They are written anew.
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        # A full disk stops no camera: the next process compiles again.
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def loop(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """
    Compile a loop over images, to be kept on disk until its code or that of a formula changes.

    numba itself compares the file of the loop alone. So the name under which it keeps the loop
    gets a digest of all that the loop calls. A loop that cannot be kept is compiled in each
    process.

    Parameters
    ----------
    **options
        Of `numba.njit`.

    Returns
    -------
    callable
        Decorator of a function.

    """

    def compile_loop(function: Callable[..., Any]) -> Any:
        function.__qualname__ += f'_{digest_of(function)}'
        compiled_loop = njit(**options)(function)
        with suppress(RuntimeError):  # No folder can be written.
            compiled_loop._cache = _Cache(function)
        return compiled_loop

    return compile_loop


def digest_of(function: Any) -> str:
    """Return eight characters that change with the code of a function or of what it calls."""
    digest, known, left = hashlib.sha256(), set(), [function]
    while left:
        code = left[-1].__code__
        names = left.pop().__globals__
        constants = [one for one in code.co_consts if not isinstance(one, CodeType)]
        digest.update(code.co_code + repr((code.co_names, constants)).encode())
        for name in code.co_names:
            value = names.get(name)
            called = getattr(value, 'py_func', None)
            if isinstance(called, FunctionType) and called not in known:
                known.add(called)
                left.append(called)
            elif isinstance(value, int | float | tuple | np.generic):
                digest.update(repr(value).encode())
    return digest.hexdigest()[:8]
