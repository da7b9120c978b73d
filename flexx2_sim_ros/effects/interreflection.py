"""
One diffuse bounce between the patches of a depth image.

Formulas on single numbers first; the loops over images are this module's, and those of
`batch.bounce`.
"""

from collections.abc import Sequence
import math

from flexx2_sim_ros.formulas.fastmath import arctan2, direction
from flexx2_sim_ros.formulas.scalars import f32, floor, i32, least, most, root, size, where
from flexx2_sim_ros.formulas.surfaces import plane_normal, ray_length
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.physics.surface import PAD, slope
import numpy as np

SENDER = 16  # Pixels a side of the patches that light others,
RECEIVER = 4  # and of those that are lit: the bounce is smooth.
PATCH_FIELDS = 11  # what `patch` returns
_RECEIVER_PIXELS = f32(RECEIVER)
_RECEIVER_MIDDLE = f32(RECEIVER // 2)
_ALIKE = f32(0.03)  # Receivers within this fraction in inverse depth share a surface.
_LEAST_COSINE = f32(0.02)
_LEAST_WEIGHT = f32(1e-3)
_NEAREST_SQUARED = f32(1e-12)
_PI = f32(math.pi)
_ZERO = f32(0.0)
_ONE = f32(1.0)


def patch(
    here: float,
    du: float,
    dv: float,
    u: float,
    v: float,
    fx: float,
    fy: float,
    pixels: float,
    reflectivity: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """
    Describe a patch of so many `pixels` by the pixel in its middle.

    ``here`` (above 0) to ``fy`` are as for `plane_normal`. Returned are the position (x, y, z,
    metres), the normal towards the camera (x, y, z), the range (metres), the radiosity
    (reflectivity times irradiance times area), the inverse depth, the area (m^2) and the
    irradiance.
    """
    rx = u / fx
    ry = v / fy
    nx, ny, nz = plane_normal(here, du, dv, u, v, fx, fy)
    norm = root(nx * nx + ny * ny + nz * nz)
    z = _ONE / here
    ray = ray_length(rx, ry)
    reach = z * ray
    cosine = most(here / (norm * ray), _LEAST_COSINE)
    area = pixels * z * z / (fx * fy * ray * cosine)
    irradiance = cosine / (reach * reach)
    radiosity = reflectivity * irradiance * area
    return (
        rx * z,
        ry * z,
        z,
        -nx / norm,
        -ny / norm,
        -nz / norm,
        reach,
        radiosity,
        here,
        area,
        irradiance,
    )


def light_from(
    dx: float,
    dy: float,
    dz: float,
    sender_x: float,
    sender_y: float,
    sender_z: float,
    radiosity: float,
    area: float,
    sender_reach: float,
    normal_x: float,
    normal_y: float,
    normal_z: float,
    reach: float,
) -> tuple[float, float]:
    """
    Return the light that a receiver gets from a sender, and how much longer its path is, metres.

    ``dx``, ``dy``, ``dz`` are from the receiver to the sender, metres. The next six are the
    sender's normal, radiosity, area and range, the last four the receiver's normal and range.
    """
    d2 = dx * dx + dy * dy + dz * dz
    d = root(most(d2, _NEAREST_SQUARED))
    arrives = most(normal_x * dx + normal_y * dy + normal_z * dz, _ZERO) / d
    leaves = most(-(sender_x * dx + sender_y * dy + sender_z * dz), _ZERO) / d
    # A patch is not a point: up close it fills no more than the half-space.
    light = radiosity * arrives * leaves / (_PI * d2 + area)
    return light, sender_reach + d - reach


def receiver_before(pixel: int, receivers: int) -> tuple[int, float]:
    """Return the receiver before a pixel of a line, and the pixel's way to the next one, 0..1."""
    place = (f32(pixel) - _RECEIVER_MIDDLE) / _RECEIVER_PIXELS
    before = least(most(i32(floor(place)), i32(0)), most(receivers - i32(2), i32(0)))
    return before, least(most(place - f32(before), _ZERO), _ONE)


def receiver_weight(share: float, here: float, other: float) -> float:
    """
    Return a receiver's weight for a pixel, from its bilinear weight `share`.

    ``here`` and ``other`` are the inverse depths of the pixel and of the receiver; 0 for nothing.
    """
    alike = _ALIKE * here / (size(other - here) + _ALIKE * here)
    return where(other > _ZERO, (share + _LEAST_WEIGHT) * alike * alike * alike, _ZERO)


def receiver_weights(
    here: float,
    right: float,
    down: float,
    above_left: float,
    above_right: float,
    below_left: float,
    below_right: float,
) -> tuple[float, float, float, float]:
    """
    Return the weights of the four receivers around a pixel, in this order; their sum is 1 or 0.

    ``here`` is the pixel's inverse depth; 0 for no return. ``right`` and ``down`` are its way from
    the receivers above and left to the others, 0..1. The receivers' inverse depths are 0 for no
    return, and where there is no receiver.
    """
    w0 = receiver_weight((_ONE - right) * (_ONE - down), here, above_left)
    w1 = receiver_weight(right * (_ONE - down), here, above_right)
    w2 = receiver_weight((_ONE - right) * down, here, below_left)
    w3 = receiver_weight(right * down, here, below_right)
    total = w0 + w1 + w2 + w3
    scale = where(total > _ZERO, _ONE / where(total > _ZERO, total, _ONE), _ZERO)
    return scale * w0, scale * w1, scale * w2, scale * w3


def with_bounce(
    factor: float, real: float, imaginary: float, wave_number: float, ray: float
) -> tuple[float, float]:
    """
    Return the shift, metres, by indirect light, and all light over the direct one.

    ``factor`` is on the indirect light, which is ``real`` + i ``imaginary`` over the direct one.
    ``wave_number`` is in radians of phase a metre. ``ray`` is the pixel's range over its depth:
    the longer path is along the ray.
    """
    both = _ONE + factor * real
    across = factor * imaginary
    return arctan2(across, both) / (wave_number * ray), root(both * both + across * across)


_patch = compiled(patch)
_light_from = compiled(light_from)
_direction = compiled(direction)
_receiver_before = compiled(receiver_before)
_receiver_weights = compiled(receiver_weights)


def bounce(state: FrameState, wave_numbers: Sequence[float]) -> list[np.ndarray]:
    """
    Return the indirect light relative to the direct one, (H, W) complex64 of each frequency.

    Every patch of the image scatters the camera's own light diffusely on all others that face it;
    occlusion between them is left out, and so is what lies outside the image. `state` has surface
    and reflectivity; ``wave_numbers`` are radians of phase a metre. The phase is as seen in depth.
    0 where there is no return.
    """
    inverse = state.surface.inverse_depth
    height, width = state.depth.shape
    camera, sensor = state.intrinsics, state.mode.sensor
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    reflectivity = np.array(np.broadcast_to(state.reflectivity, (height, width)))
    shares = np.float32(sensor.jump_share), np.float32(sensor.steep_share)
    senders = _patches(inverse, reflectivity, lens, *shares, SENDER)
    receivers = _patches(inverse, reflectivity, lens, *shares, RECEIVER)
    rows, columns = -(-height // RECEIVER), -(-width // RECEIVER)
    turns = np.array([k / (4.0 * math.pi) for k in wave_numbers], np.float32)
    gamma = np.zeros((len(turns), rows * columns, 2), np.float32)
    _gather(senders, receivers, turns, gamma)
    out = np.empty((len(turns), height, width, 2), np.float32)
    depths = receivers[:, 8].copy().reshape(rows, columns)
    _spread(inverse, depths, gamma.reshape(-1, rows, columns, 2), out)
    return list(out.view(np.complex64)[..., 0])


@loop(error_model='numpy', fastmath=FAST)
def _patches(p, reflectivity, lens, jump_share, steep_share, size):
    # A row a block, see `patch`; 0 for nothing.
    height, width = reflectivity.shape
    rows, columns = -(-height // size), -(-width // size)
    out = np.zeros((rows * columns, PATCH_FIELDS), np.float32)
    fx, fy, cx, cy = lens
    for row in range(rows):
        for column in range(columns):
            y = min(row * size + size // 2, height - 1)
            x = min(column * size + size // 2, width - 1)
            j, i = y + PAD, x + PAD
            here = p[j, i]
            if here <= _ZERO:
                continue
            du = slope(
                p[j, i - 2], p[j, i - 1], here, p[j, i + 1], p[j, i + 2], jump_share, steep_share
            )
            dv = slope(
                p[j - 2, i], p[j - 1, i], here, p[j + 1, i], p[j + 2, i], jump_share, steep_share
            )
            pixels = np.float32(min(size, height - row * size) * min(size, width - column * size))
            u, v = np.float32(x) - cx, np.float32(y) - cy
            fields = _patch(here, du, dv, u, v, fx, fy, pixels, reflectivity[y, x])
            for k in range(PATCH_FIELDS):
                out[row * columns + column, k] = fields[k]
    return out


@loop(error_model='numpy', fastmath=FAST)
def _gather(senders, receivers, turns, out):
    # turns: of phase a metre of light path, for each frequency.
    s = senders.T.copy()
    light = np.empty(s.shape[1], np.float32)
    path = np.empty(s.shape[1], np.float32)
    for r in range(receivers.shape[0]):
        x, y, z, nx, ny, nz, reach, _, here, _, irradiance = receivers[r]
        if here <= _ZERO:
            continue
        for i in range(s.shape[1]):
            light[i], path[i] = _light_from(
                s[0, i] - x,
                s[1, i] - y,
                s[2, i] - z,
                s[3, i],
                s[4, i],
                s[5, i],
                s[7, i],
                s[9, i],
                s[6, i],
                nx,
                ny,
                nz,
                reach,
            )
        for f in range(turns.size):
            real = _ZERO
            imaginary = _ZERO
            for i in range(s.shape[1]):
                cosine, sine = _direction(turns[f] * path[i])
                real += light[i] * cosine
                imaginary += light[i] * sine
            out[f, r, 0] = real / irradiance
            out[f, r, 1] = imaginary / irradiance


@loop(error_model='numpy', fastmath=FAST)
def _spread(p, receivers, gamma, out):
    # From receivers to pixels, at all frequencies: bilinear, among receivers of a like depth.
    height, width = out.shape[1:3]
    rows, columns = receivers.shape
    for y in range(height):
        row, down = _receiver_before(np.int32(y), np.int32(rows))
        below = min(row + 1, rows - 1)
        for x in range(width):
            column, right = _receiver_before(np.int32(x), np.int32(columns))
            beside = min(column + 1, columns - 1)
            w0, w1, w2, w3 = _receiver_weights(
                p[y + PAD, x + PAD],
                right,
                down,
                receivers[row, column],
                receivers[row, beside] if beside > column else _ZERO,
                receivers[below, column] if below > row else _ZERO,
                receivers[below, beside] if below > row and beside > column else _ZERO,
            )
            for f in range(gamma.shape[0]):
                for part in range(2):
                    above = w0 * gamma[f, row, column, part] + w1 * gamma[f, row, beside, part]
                    under = w2 * gamma[f, below, column, part] + w3 * gamma[f, below, beside, part]
                    out[f, y, x, part] = above + under
