"""Where numba keeps compiled loops. Importing it imports numba; `physics.compiled` does not."""

from collections.abc import Callable
from contextlib import suppress
import gc
import hashlib
import pickle
from types import CodeType, FunctionType
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.event import Event, Listener, register
from numba.core.runtime.nrt import rtsys
import numpy as np


class _Collector(Listener):
    """Pauses Python's garbage collector, which takes a quarter of the time, during compilation."""

    def __init__(self) -> None:
        self._depth, self._paused = 0, False

    def on_start(self, event: Event) -> None:
        if not self._depth:
            self._paused = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if not self._depth and self._paused:
            gc.enable()


register('numba:compile', _Collector())  # type: ignore[no-untyped-call]


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
            # A loop that was kept needs only the memory of arrays. What else numba prepares here
            # is for compiling, and takes a quarter of a second and 27 MB.
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # Damaged files raise anything. They are written anew.
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        # A full disk stops no camera: the next process compiles again.
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def kept_loop(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return a loop compiled by numba; see `flexx2_sim_ros.physics.compiled.loop`."""
    # Other threads run meanwhile: a loop changes nothing but arrays that its caller gives it. What
    # was kept of loops that held the lock has the name without "_free".
    function.__qualname__ += f'_{digest_of(function)}_free'
    compiled_loop = njit(nogil=True, **options)(function)
    with suppress(RuntimeError):  # No folder can be written.
        compiled_loop._cache = _Cache(function)
    return compiled_loop


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
