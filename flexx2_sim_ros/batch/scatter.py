"""The effect stray_light in a batch: scatter in the lens."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from flexx2_sim_ros.batch import scatter_kernels
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.effects.stray_light import BLOCK, spread_of
import numpy as np
import warp as wp

# Of the scattered light, where its kernel is a sum of few products: float32 holds no more.
_KERNEL_ERROR = 1e-6


class ScatteredLight:
    """
    How light spreads over the environments' images.

    Parameters
    ----------
    widths : sequence of float or None
        The kernel's width in each environment, see `StrayLight`; None where the effect is off.
    frequencies : int
        The most modulation frequencies of a mode.
    images : Images
    device : warp.Device

    """

    def __init__(
        self, widths: Sequence[float | None], frequencies: int, images: Images, device: Any
    ) -> None:
        """Put the kernels on the device, and allocate the images of a pass."""
        self._images, self._frequencies = images, frequencies
        rows, columns = -(-images.height // BLOCK), -(-images.width // BLOCK)
        different = sorted({width for width in widths if width is not None})
        kinds: dict[float | None, int] = {width: i for i, width in enumerate(different)}
        kernels = [products(rows, columns, width * images.width / BLOCK) for width in different]
        scatter = self._scatter = scatter_kernels.Scatter()
        scatter.rows, scatter.columns, scatter.envs = rows, columns, images.count
        scatter.kinds = wp.array(
            [kinds.get(width, -1) for width in widths], dtype=wp.int32, device=device
        )
        scatter.terms = terms = max(len(down) for down, _ in kernels)
        scatter.down, scatter.across = (
            wp.array(_both_ways(parts, terms).ravel(), dtype=wp.float32, device=device)
            for parts in zip(*kernels, strict=True)
        )
        pixels, blocks = images.height * images.width, rows * columns
        scatter.directions, scatter.wide, scatter.blocks, scatter.scattered, scatter.spread = (
            wp.zeros(2 * images.count * size, dtype=wp.float32, device=device)
            for size in (pixels, rows * images.width, blocks, blocks, terms * blocks)
        )
        wp.load_module(scatter_kernels, device=device)

    def add(
        self,
        surfaces: Any,
        first: int,
        count: int,
        effects: wp.array,
        lights: wp.array,
        phasors: Any,
    ) -> None:
        """Add the scattered light to the pixels of some environments; see `PixelLight.find`."""
        for f in range(self._frequencies):
            self._spread(surfaces, first, count, f, lights, phasors)
            grid, chunk = self._images.grid(count)
            launch(
                scatter_kernels.add_scattered,
                grid,
                self._images.lens,
                first,
                chunk,
                f,
                effects,
                lights,
                phasors,
                self._scatter,
            )

    def _spread(
        self, surfaces: Any, first: int, count: int, f: int, lights: wp.array, phasors: Any
    ) -> None:
        lens, scatter = self._images.lens, self._scatter
        grid, chunk = self._images.grid(count)
        blocks = (count, scatter.rows, scatter.columns)
        launch(
            scatter_kernels.find_directions,
            grid,
            surfaces.p,
            lens,
            first,
            chunk,
            f,
            lights,
            phasors,
            scatter,
        )
        launch(scatter_kernels.sum_blocks, blocks, lens, first, f, lights, phasors, scatter)
        launch(scatter_kernels.spread_across, blocks, first, f, lights, scatter)
        columns = (count, scatter.columns, scatter.rows)
        launch(scatter_kernels.spread_down, columns, first, f, lights, scatter)
        wide = (count, scatter.rows, grid[2])
        launch(scatter_kernels.widen, wide, lens, first, chunk, f, lights, scatter)


@lru_cache(maxsize=4096)
def products(rows: int, columns: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the kernel of stray light as a sum of products.

    Parameters
    ----------
    rows, columns, radius
        See `spread_of`.

    Returns
    -------
    tuple of numpy.ndarray
        (R, rows) and (R, columns) float64: functions of the distance along the column and along
        the row. Their products add up to the kernel, to 1e-6 of its sum. R is 3 to 13 for images
        of 224 x 172: the kernel is smooth.

    """
    wanted = spread_of(rows, columns, radius)[:rows, :columns]
    left, sizes, right = np.linalg.svd(wanted, full_matrices=False)
    down, across = left.T * sizes[:, None], right
    missing = wanted
    for terms in range(1, sizes.size + 1):
        missing = missing - np.outer(down[terms - 1], across[terms - 1])
        if 4 * np.abs(missing).sum() <= _KERNEL_ERROR:
            break
    return down[:terms], across[:terms]


def _both_ways(parts: Sequence[np.ndarray], terms: int) -> np.ndarray:
    # (kernels, terms, 2 * size - 1): distances from -(size - 1) to size - 1.
    size = parts[0].shape[1]
    out = np.zeros((len(parts), terms, 2 * size - 1), np.float32)
    distances = np.abs(np.arange(1 - size, size))
    for both, part in zip(out, parts, strict=True):
        both[: len(part)] = part[:, distances]
    return out
