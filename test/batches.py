"""What the tests of many cameras at once share; skips them where there is no Warp."""

import pytest

wp = pytest.importorskip('warp', reason='warp-lang is not installed: no batch')
import numpy as np  # noqa: E402, I100

DEVICES = [
    'cpu',
    pytest.param('cuda', marks=pytest.mark.skipif(not wp.is_cuda_available(), reason='no GPU')),
]
# A device, and whether a thread gets a few pixels: on a GPU always.
WAYS = [('cpu', False), ('cpu', True), pytest.param('cuda', True, marks=DEVICES[1].marks)]
V, U = np.mgrid[:172, :224]


def scenes(count):
    """Return different scenes, each 172 x 224: slants, boxes, holes, what is no depth."""
    generator = np.random.default_rng(4)
    out = np.empty((count, 172, 224), np.float32)
    for scene in out:
        scene[:] = generator.uniform(1.2, 3) + generator.uniform(-4e-3, 4e-3) * (U - 111)
        for _ in range(9):
            x, y = generator.integers(0, 200), generator.integers(0, 150)
            size = generator.integers(2, 60)
            scene[y : y + size, x : x + size] = generator.uniform(0.4, 2.3)
        scene[np.hypot(U - 150, V - 90) < 20] = generator.uniform(0.5, 2)
        for row, nothing in enumerate((np.nan, -1, 0, np.inf)):
            scene[3 * row : 3 * row + 3, :20] = nothing
    return out


def arrays_of(library, values, device):
    """Return NumPy's values as an array of a library, on a device."""
    if library == 'torch':
        return pytest.importorskip('torch').from_numpy(values).to(device)
    if library == 'jax':
        return pytest.importorskip('jax').device_put(values, wp.device_to_jax(device))
    return wp.array(values, device=device, copy=False) if library == 'warp' else values


def look(device, camera, *images, **how):
    """Return a copy of what a batch of cameras sees of NumPy arrays, put on its device."""
    given = [wp.array(one, dtype=wp.float32, device=device) for one in images]
    return camera(*given, **how).numpy().copy()
