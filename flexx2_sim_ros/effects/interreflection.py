"""One diffuse bounce between the patches of a depth image."""

import math

from flexx2_sim_ros.physics.fastmath import cos_sin_turns
from flexx2_sim_ros.physics.frame_state import FrameState
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.physics.surface import PAD, slope
from numba import njit
import numpy as np

_SENDER = 16  # Pixels a side of the patches that light others,
_RECEIVER = 4  # and of those that are lit: the bounce is smooth.
_ALIKE = np.float32(0.03)  # Receivers within this share in inverse depth share a surface.
_PI = np.float32(math.pi)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


def bounce(state: FrameState) -> list[np.ndarray]:
    """
    Return the indirect light relative to the direct one.

    Every patch of the image scatters the camera's own light diffusely on all others that face it;
    occlusion between them is left out, and so is what lies outside the image.

    Parameters
    ----------
    state : FrameState
        With surface and reflectivity.

    Returns
    -------
    list of numpy.ndarray
        For each modulation frequency (H, W) complex64: amplitude relative to the direct light's,
        phase relative to its, as seen in depth. 0 where there is no return.

    """
    inverse = state.surface.inverse_depth
    height, width = state.depth.shape
    camera, sensor = state.intrinsics, state.mode.sensor
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    reflectivity = np.array(np.broadcast_to(state.reflectivity, (height, width)))
    shares = np.float32(sensor.jump_share), np.float32(sensor.steep_share)
    senders = _patches(inverse, reflectivity, lens, *shares, _SENDER)
    receivers = _patches(inverse, reflectivity, lens, *shares, _RECEIVER)
    rows, columns = -(-height // _RECEIVER), -(-width // _RECEIVER)
    turns = np.array([k / (4.0 * math.pi) for k in state.wave_numbers], np.float32)
    gamma = np.zeros((len(turns), rows * columns, 2), np.float32)
    _gather(senders, receivers, turns, gamma)
    out = []
    for one in gamma:
        image = np.empty((height, width, 2), np.float32)
        _spread(
            inverse,
            receivers[:, 8].copy().reshape(rows, columns),
            one.reshape(rows, columns, 2),
            image,
        )
        out.append(image.view(np.complex64)[..., 0])
    return out


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _patches(p, reflectivity, lens, jump_share, steep_share, size):
    # A row a block, from its middle pixel: position, normal (towards the camera), range, radiosity
    # (reflectivity times irradiance times area), inverse depth, area, irradiance; 0 for nothing.
    height, width = reflectivity.shape
    rows, columns = -(-height // size), -(-width // size)
    out = np.zeros((rows * columns, 11), np.float32)
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
            u, v = np.float32(x) - cx, np.float32(y) - cy
            rx, ry = u / fx, v / fy
            nx, ny, nz = fx * du, fy * dv, here - u * du - v * dv
            norm = math.sqrt(nx * nx + ny * ny + nz * nz)
            z = _ONE / here
            ray = math.sqrt(rx * rx + ry * ry + _ONE)
            reach = z * ray
            cosine = max(here / (norm * ray), np.float32(0.02))
            tall = min(size, height - row * size)
            wide = min(size, width - column * size)
            area = np.float32(tall * wide) * z * z / (fx * fy * ray * cosine)
            irradiance = cosine / (reach * reach)
            patch = out[row * columns + column]
            patch[0], patch[1], patch[2] = rx * z, ry * z, z
            patch[3], patch[4], patch[5] = -nx / norm, -ny / norm, -nz / norm
            patch[6] = reach
            patch[7] = reflectivity[y, x] * irradiance * area
            patch[8] = here
            patch[9] = area
            patch[10] = irradiance
    return out


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _gather(senders, receivers, turns, out):
    # turns: of phase a metre of light path, for each frequency. The path by way of a sender is
    # longer than the direct one by sender's range + distance - receiver's range.
    s = senders.T.copy()
    light = np.empty(s.shape[1], np.float32)
    path = np.empty(s.shape[1], np.float32)
    for r in range(receivers.shape[0]):
        x, y, z, nx, ny, nz, reach, _, here, _, irradiance = receivers[r]
        if here <= _ZERO:
            continue
        for i in range(s.shape[1]):
            dx, dy, dz = s[0, i] - x, s[1, i] - y, s[2, i] - z
            d2 = dx * dx + dy * dy + dz * dz
            d = math.sqrt(max(d2, np.float32(1e-12)))
            arrives = max(nx * dx + ny * dy + nz * dz, _ZERO) / d
            leaves = max(-(s[3, i] * dx + s[4, i] * dy + s[5, i] * dz), _ZERO) / d
            # A patch is not a point: up close it fills no more than the half-space.
            light[i] = s[7, i] * arrives * leaves / (_PI * d2 + s[9, i])
            path[i] = s[6, i] + d - reach
        for f in range(turns.size):
            real = _ZERO
            imaginary = _ZERO
            for i in range(s.shape[1]):
                turn = turns[f] * path[i]
                cosine, sine = cos_sin_turns(turn - np.floor(turn))
                real += light[i] * cosine
                imaginary += light[i] * sine
            out[f, r, 0] = real / irradiance
            out[f, r, 1] = imaginary / irradiance


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _spread(p, patches, gamma, out):
    # From receivers to pixels: bilinear, among those of a like depth.
    height, width = out.shape[:2]
    rows, columns = patches.shape
    for y in range(height):
        fy = (np.float32(y) - np.float32(_RECEIVER // 2)) / np.float32(_RECEIVER)
        row = min(max(int(np.floor(fy)), 0), max(rows - 2, 0))
        sy = min(max(fy - np.float32(row), _ZERO), _ONE)
        for x in range(width):
            here = p[y + PAD, x + PAD]
            out[y, x, 0] = _ZERO
            out[y, x, 1] = _ZERO
            if here <= _ZERO:
                continue
            fx = (np.float32(x) - np.float32(_RECEIVER // 2)) / np.float32(_RECEIVER)
            column = min(max(int(np.floor(fx)), 0), max(columns - 2, 0))
            sx = min(max(fx - np.float32(column), _ZERO), _ONE)
            total = _ZERO
            for b in range(min(2, rows)):
                for a in range(min(2, columns)):
                    wy = sy if b else _ONE - sy
                    wx = sx if a else _ONE - sx
                    other = patches[row + b, column + a]
                    alike = _ALIKE * here / (abs(other - here) + _ALIKE * here)
                    weight = (wx * wy + np.float32(1e-3)) * alike * alike * alike
                    weight = weight if other > _ZERO else _ZERO
                    total += weight
                    out[y, x, 0] += weight * gamma[row + b, column + a, 0]
                    out[y, x, 1] += weight * gamma[row + b, column + a, 1]
            if total > _ZERO:
                out[y, x, 0] /= total
                out[y, x, 1] /= total
