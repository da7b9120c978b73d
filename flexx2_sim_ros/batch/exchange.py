"""Arrays of NumPy, torch, JAX and Warp as Warp arrays and back, without a copy."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError
import numpy as np
import warp as wp

KINDS = 'a torch tensor, a JAX array, a NumPy array or a Warp array'


def kind_of(name: str, value: Any) -> str:
    """
    Return which library an array is of: ``numpy``, ``torch``, ``jax`` or ``warp``.

    Raises InputError, which names `name`, when it is none of theirs.
    """
    if isinstance(value, wp.array):
        return 'warp'
    if isinstance(value, np.ndarray):
        return 'numpy'
    # Whoever holds such an array has imported its library.
    for library, class_name in (('torch', 'Tensor'), ('jax', 'Array')):
        if library in sys.modules and isinstance(value, getattr(sys.modules[library], class_name)):
            return library
    raise InputError(f'{name}: must be {KINDS}, got {type(value).__name__}')


def checked(name: str, value: Any, shape: tuple[int | None, ...], dtype: type, device: Any) -> str:
    """
    Return the kind of an array, as `kind_of`.

    In `shape`, None is any length but 0; `dtype` is NumPy's. Raises InputError, which names
    `name`, for another kind, shape, dtype or device.
    """
    kind = kind_of(name, value)
    found = tuple(int(length) for length in value.shape)
    if len(found) != len(shape) or any(
        here != length if length else here < 1 for here, length in zip(found, shape, strict=True)
    ):
        wanted = ', '.join(str(length or 'any') for length in shape)
        raise InputError(f'{name}: must have shape ({wanted}), got {found}')
    own = (value.dtype.__name__ if kind == 'warp' else str(value.dtype)).removeprefix('torch.')
    if own != np.dtype(dtype).name:
        raise InputError(f'{name}: must be {np.dtype(dtype).name}, got {own}')
    place = device_of(kind, value)
    if place != device:
        raise InputError(f'{name}: must be on {device}, where the camera is, got on {place}')
    return kind


def _without_channel(image: Any) -> Any:
    shape = tuple(getattr(image, 'shape', ()))
    if len(shape) == 4 and shape[3] == 1:
        return image[:, :, :, 0]
    return image[:, 0] if len(shape) == 4 and shape[1] == 1 else image


def given_images(
    num_envs: int, depth: Any, reflectivity: Any, out: Any, device: Any
) -> tuple[str, tuple[Any, Any, Any]]:
    """
    Check the images that a batch of N cameras is called with; return their kind and views.

    The kind is as `kind_of`. Each image is (N, H, W) float32 on `device`, of any of the four
    libraries, or has one channel, first or last; ``reflectivity`` and ``out`` are like ``depth``
    or None, ``out`` contiguous and writable. The views are (N, H, W), in the same memory where the
    library can. Raises InputError for another kind, shape, dtype or device.
    """
    depth, reflectivity, out = map(_without_channel, (depth, reflectivity, out))
    kind = checked('depth', depth, (num_envs, None, None), np.float32, device)
    for name, more in (('reflectivity', reflectivity), ('out', out)):
        if more is not None and kind != checked(
            name, more, tuple(depth.shape), np.float32, device
        ):
            raise InputError(
                f'{name}: must be {type(depth).__name__}, as depth is, got {type(more).__name__}'
            )
    if out is not None and not (is_contiguous(kind, out) and is_writable(kind, out)):
        raise InputError('out: must be contiguous and writable, got an array that is not')
    return kind, (depth, reflectivity, out)


def device_of(kind: str, value: Any) -> Any:
    """Return the Warp device of an array of this kind."""
    if kind == 'numpy':
        return wp.get_device('cpu')
    if kind == 'torch':
        return wp.device_from_torch(value.device)
    return wp.device_from_jax(value.device) if kind == 'jax' else value.device


def is_contiguous(kind: str, value: Any) -> bool:
    """Say whether Warp can use an array of this kind without a copy."""
    if kind == 'numpy':
        return bool(value.flags.c_contiguous and value.flags.aligned)
    if kind == 'torch':
        return bool(value.is_contiguous())
    return kind == 'jax' or bool(value.is_contiguous)


def is_writable(kind: str, value: Any) -> bool:
    """Say whether an array of this kind may be written to: not JAX's, nor read-only memory."""
    return kind != 'jax' and (kind != 'numpy' or bool(value.flags.writeable))


def flat(kind: str, value: Any, staging: Callable[[], wp.array]) -> wp.array:
    """
    Return an array on Warp's device as a flat Warp array: its own memory if that is contiguous.

    Otherwise it is a copy in the memory that `staging` returns, of the same shape, dtype and
    device.
    """
    if is_contiguous(kind, value):
        if kind == 'numpy':
            # numpy.newaxis makes an axis of stride 0, which Warp takes for a gap.
            value = wp.array(value.reshape(-1), device='cpu', copy=False)
        elif kind == 'torch':
            value = wp.from_torch(value.detach())
        elif kind == 'jax':
            value = wp.from_jax(value)
        return value.flatten()
    copy = staging()
    if kind == 'numpy':
        np.copyto(copy.numpy(), value)
    elif kind == 'torch':
        wp.to_torch(copy).copy_(value.detach())
    else:
        wp.copy(copy, value)
    return copy.flatten()


def from_warp(kind: str, array: wp.array) -> Any:
    """Return a Warp array as one of another library that shares its memory."""
    if kind == 'numpy':
        return array.numpy()
    if kind == 'torch':
        return wp.to_torch(array)
    return wp.to_jax(array) if kind == 'jax' else array


@contextmanager
def stream_of(kind: str, device: Any) -> Iterator[None]:
    """
    Work on the stream that an array's library works on, in the order of its own work.

    JAX does not say which stream that is: there all of the device's work is waited for.
    """
    if not device.is_cuda or kind in ('numpy', 'warp'):
        yield
    elif kind == 'torch':
        with wp.ScopedStream(wp.stream_from_torch(wp.device_to_torch(device))):
            yield
    else:
        wp.synchronize_device(device)
        yield
        wp.synchronize_device(device)
