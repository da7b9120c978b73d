"""Axial noise and what goes with it: sigma_z, amplitude, confidence, the mode's range."""

from flexx2_sim_ros.formulas import pixels, surfaces
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
from flexx2_sim_ros.physics.lateral import displaced_pixels, upright_edges
from flexx2_sim_ros.physics.philox import FAST, fill_normals, STREAM_AXIAL
from flexx2_sim_ros.physics.surface import PAD, Surface, surface_arrays
from flexx2_sim_ros.profiles.modes import NoiseModel
import numpy as np

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_NAN = np.float32(np.nan)

_sigma_of_surface = compiled(surfaces.sigma_of_surface)
_distance = compiled(surfaces.distance)
_returned_light = compiled(surfaces.returned_light)
_usable_reflectivity = compiled(surfaces.usable_reflectivity)
_surface_factor = compiled(surfaces.surface_factor)
_is_seen = compiled(pixels.is_seen)
_measured = compiled(pixels.measured)
_kept_within = compiled(pixels.kept_within)
_confidence = compiled(pixels.confidence)


@loop(error_model='numpy', fastmath=FAST)
def model_sigma(p, cosine, coefficients, cap, out):
    """
    Write sigma_z of every pixel of a surface.

    ``p`` is (H + 4, W + 4) float32 padded inverse depth, 0 for nothing, ``cosine`` (H, W) float32
    that of the incidence angle, ``coefficients`` (5,) float32 a, b, c, d, n, and ``cap`` the
    largest incidence angle, radians. ``out`` is (H, W) float32, metres; 0 without a return.
    """
    a, b, c, d, n = coefficients
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = _sigma_of_surface(p[y + PAD, x + PAD], cosine[y, x], a, b, c, d, n, cap)


@loop(error_model='numpy', fastmath=FAST)
def scale_by_surface(p, cosine, reflectivity, coefficients, sigma):
    """
    Scale sigma_z, (H, W) float32 metres, in place by a factor of each pixel's reflectivity.

    ``p`` and ``cosine`` are as for `model_sigma`, ``reflectivity`` is (H, W) float32 in 0..1.
    ``coefficients`` are (3,) float32: white, constant_share, read_share; see
    `formulas.surfaces.surface_factor`.
    """
    white, constant_share, read_share = coefficients
    for y in range(sigma.shape[0]):
        for x in range(sigma.shape[1]):
            sigma[y, x] *= _surface_factor(
                reflectivity[y, x],
                cosine[y, x],
                p[y + PAD, x + PAD],
                white,
                constant_share,
                read_share,
            )


def sigma_image(
    surface: Surface, noise: NoiseModel, reflectivity: np.ndarray | None = None
) -> np.ndarray:
    """
    Return sigma_z of the base model at every pixel of a surface, (H, W) float32 metres.

    It is 0 without a return. ``reflectivity`` is (H, W) in 0..1; without it, all surfaces have the
    noise of the white board.
    """
    p, cosine = surface.inverse_depth, surface.cos_incidence
    sigma = np.empty(cosine.shape, np.float32)
    model_sigma(p, cosine, noise.coefficients, np.float32(noise.incidence_cap), sigma)
    if noise.surfaces is not None and reflectivity is not None:
        rho = np.ascontiguousarray(reflectivity, np.float32)
        scale_by_surface(p, cosine, rho, noise.surfaces.coefficients, sigma)
    return sigma


@loop(error_model='numpy', fastmath=FAST)
def prepare(depth, constants, coefficients, cap):
    """
    Return what no stamp changes: padded inverse depth, cosine of incidence, sigma_z and edges.

    In one call: at the end of each, a thread waits until no other one holds Python's lock. Depth
    and constants are as in `surface.surface_arrays`, the others as in `model_sigma`.
    """
    p, row_jumps, column_jumps, cosine = surface_arrays(depth, constants)
    sigma = np.empty(cosine.shape, np.float32)
    model_sigma(p, cosine, coefficients, cap, sigma)
    return p, cosine, sigma, upright_edges(row_jumps, column_jumps)


@loop(error_model='numpy', fastmath=FAST)
def observe(
    p,
    cosine,
    model,
    reflectivity,
    edges,
    jitter,
    key,
    stamp_low,
    stamp_high,
    range_min,
    range_max,
    zero_confidence,
    depth,
    sigma,
    amplitude,
    confidence,
):
    """
    Write one frame: axial noise on what each pixel sees.

    Parameters
    ----------
    p, cosine, model
        Padded inverse depth, cosine of incidence and sigma_z of the surface, as above.
    reflectivity : numpy.ndarray
        (H, W) float32 in 0..1, or (1, 1) for one value everywhere.
    edges : tuple of numpy.ndarray
        Edges that move along the row and along the column, from `lateral.upright_edges`.
    jitter : tuple
        ``neighbourhood``, ``sigma``, ``limit`` and ``laplace`` of `lateral.displaced_pixels`.
    key, stamp_low, stamp_high
        The counter-based generator's key and stamp.
    range_min, range_max : float
        Depths outside are invalid, before the noise and after it.
    zero_confidence : float
        sigma_z at which confidence reaches 0, metres.
    depth, sigma, amplitude, confidence : numpy.ndarray
        (H, W) float32 outputs; NaN, NaN, 0 and 0 where invalid.

    """
    height, width = depth.shape
    normals = np.empty(height * width, np.float32)
    # As an integer of its callers in Python: of a constant, numba compiles it once more.
    fill_normals(key, stamp_low, stamp_high, np.int64(STREAM_AXIAL), normals)
    neighbourhood, edge_sigma, edge_limit, laplace = jitter
    moved, origin = displaced_pixels(
        edges[0],
        edges[1],
        height,
        width,
        neighbourhood,
        edge_sigma,
        edge_limit,
        key,
        stamp_low,
        stamp_high,
        laplace,
    )
    uniform = reflectivity.size == 1
    limits = range_min, range_max, zero_confidence
    for y in range(height):
        for x in range(width):
            rho = reflectivity[0, 0] if uniform else reflectivity[y, x]
            depth[y, x], sigma[y, x], amplitude[y, x], confidence[y, x] = _see(
                p[y + PAD, x + PAD], cosine[y, x], model[y, x], rho, normals[y * width + x], limits
            )
    # The few pixels that see something else, again.
    for i in range(moved.size):
        pixel, seen = moved[i], origin[i]
        y, x = pixel // width, pixel % width
        sy, sx = seen // width, seen % width
        rho = reflectivity[0, 0] if uniform else reflectivity[sy, sx]
        depth[y, x], sigma[y, x], amplitude[y, x], confidence[y, x] = _see(
            p[sy + PAD, sx + PAD], cosine[sy, sx], model[sy, sx], rho, normals[pixel], limits
        )


@inlined
def _see(inverse, cosine, spread, rho, normal, limits):
    # Depth, sigma, amplitude and confidence of what a pixel sees.
    range_min, range_max, zero_confidence = limits
    z = _distance(inverse, _ZERO)
    value = z + spread * normal
    valid = _is_seen(z, value, range_min, range_max)
    share = _confidence(spread, zero_confidence)
    light = _returned_light(_usable_reflectivity(rho), cosine, inverse)
    return (
        value if valid else _NAN,
        spread if valid else _NAN,
        light if valid else _ZERO,
        share if valid else _ZERO,
    )


@loop(error_model='numpy')
def hold_reflectivity(given, out):
    """Write reflectivity within 0..1, and 0 for NaN; both (H, W)."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = _usable_reflectivity(given[y, x])


@loop(error_model='numpy')
def shine(p, cosine, reflectivity, depth, amplitude):
    """Write the light that comes back, 1/m^2; depth becomes NaN where nothing returns."""
    uniform = reflectivity.size == 1
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            inverse = p[y + PAD, x + PAD]
            rho = reflectivity[0, 0] if uniform else reflectivity[y, x]
            amplitude[y, x] = _returned_light(rho, cosine[y, x], inverse)
            depth[y, x] = _NAN if inverse == _ZERO else depth[y, x]


@loop()
def add_noise(z, shift, sigma, normals, low, high, out):
    """Write z + shift + sigma * normal where z + shift is in low..high, else NaN; all (H, W)."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            here = z[y, x] + shift[y, x]
            out[y, x] = _measured(here, sigma[y, x], normals[y, x], low, high)


@loop()
def blank_outside(depth, low, high):
    """Set depths outside low..high to NaN, in place."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            depth[y, x] = _kept_within(depth[y, x], low, high)


@loop(error_model='numpy')
def blank_invalid(
    depth, sigma, amplitude, zero_confidence, out_sigma, out_amplitude, out_confidence
):
    """Write sigma, amplitude and confidence; NaN, 0 and 0 where depth is NaN."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            valid = depth[y, x] == depth[y, x]
            spread = sigma[y, x]
            out_sigma[y, x] = spread if valid else _NAN
            out_amplitude[y, x] = amplitude[y, x] if valid else _ZERO
            out_confidence[y, x] = _confidence(spread, zero_confidence) if valid else _ZERO
