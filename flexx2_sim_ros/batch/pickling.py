"""Copies and pickles of objects that hold Warp's arrays, which Warp itself does not make."""

import importlib
import io
import pickle
from typing import Any

from flexx2_sim_ros.batch.frame import Lens
import numpy as np
import warp as wp

_Struct: Any = type(Lens)  # what `wp.struct` makes; Warp does not name it


class _Pickler(pickle.Pickler):
    """Pickles what is on a device by its values and the device's name; it stays one object."""

    def reducer_override(self, value: Any) -> Any:
        """Say how to make an object again."""
        if isinstance(value, wp.array):
            return _array, (value.numpy(), value.dtype, value.device.alias)
        if isinstance(value, wp.Device):
            return wp.get_device, (value.alias,)
        if isinstance(value, wp.Kernel):
            return _named, (value.module.name, value.key)
        if isinstance(value, _Struct):
            return _named, (value.cls.__module__, value.cls.__name__)
        if isinstance(getattr(value, '_cls', None), _Struct):
            fields = {name: getattr(value, name) for name in value._cls.vars}
            return _struct, (value._cls, fields)
        return NotImplemented


def _array(values: np.ndarray, dtype: Any, device: str) -> wp.array:
    return wp.array(values, dtype=dtype, device=device)


def _named(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def _struct(struct: Any, fields: dict[str, Any]) -> Any:
    made = struct()
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def reduced(value: Any) -> tuple[Any, ...]:
    """
    Return what ``__reduce__`` returns of an object that holds arrays on a device.

    `pickle` must find its class by name. The copy has the same state on the same device.
    """
    wp.synchronize()  # Frames may be in the making, on any stream.
    packed = io.BytesIO()
    _Pickler(packed).dump(vars(value))
    return _restored, (type(value), packed.getvalue())


def _restored(kind: Any, packed: bytes) -> Any:
    made = kind.__new__(kind)
    vars(made).update(pickle.loads(packed))  # noqa: S301 (whoever unpickles this trusts it)
    return made
