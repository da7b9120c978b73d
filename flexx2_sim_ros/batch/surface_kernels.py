"""How sigma_z depends on reflectivity, as a Warp kernel: `formulas.surfaces.surface_factor`."""

from collections.abc import Sequence

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import reflectivity_at, Surfaces
from flexx2_sim_ros.batch.kernels import Lens, OPTIONS, padded
from flexx2_sim_ros.formulas import surfaces as formulas
from flexx2_sim_ros.profiles.modes import Mode
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)

_surface_factor = compiled(formulas.surface_factor)
_NO_DEPENDENCE = 1.0, 1.0, 0.0


@wp.kernel
def scale_by_surface(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    coefficients: wp.array(dtype=wp.vec3f),
    cosine: wp.array(dtype=wp.float32),
    sigma: wp.array(dtype=wp.float32),
):
    """Scale sigma_z by a factor that depends on each pixel's reflectivity."""
    n, y, c = wp.tid()
    own = coefficients[first + n]
    row = (n * lens.height + y) * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        factor = _surface_factor(
            reflectivity_at(surfaces, lens, n, y, x),
            at(cosine, row + x),
            at(surfaces.p, padded(lens, n, y, x)),
            own[0],
            own[1],
            own[2],
        )
        put(sigma, row + x, at(sigma, row + x) * factor)
        x += stride


def depends_on_surfaces(modes: Sequence[Mode]) -> bool:
    """Say whether the noise of any mode depends on reflectivity."""
    return any(mode.noise.surfaces is not None for mode in modes)


def surface_rows(modes: Sequence[Mode]) -> np.ndarray:
    """Return the coefficients of every environment's mode, (N, 3) float32."""
    rows = [
        _NO_DEPENDENCE if mode.noise.surfaces is None else mode.noise.surfaces.coefficients
        for mode in modes
    ]
    return np.array(rows, np.float32)
