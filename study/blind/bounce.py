"""
Light that is reflected twice: by a lit patch, and by the surface that a pixel sees.

The image is divided into patches that reflect the camera's light diffusely. A coarser grid of
receivers sums the light of all patches that are in sight, with the true path length. It is then
interpolated to full resolution along surfaces.
"""

import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np
from study.blind.shapes import in_sight
from study.blind.views import cast_rays, phasors, View

_PATCH, _RECEIVER = 10, 6  # pixels of the 224 x 172 image
_CLOSEST = 0.05  # metres; nearer patches belong to the same surface


def bounced_light(view: View) -> np.ndarray:
    """
    Return the indirect light of a view.

    `view`: the scene as the camera sees it. Returns (J, H, W) complex64, in the unit of the direct
    light.
    """
    arriving = irradiance(view) if view.irradiance is None else view.irradiance
    step = _pixels(view, _RECEIVER)
    points, normals, _, _, _ = _points(view, step)
    return _carry(
        view,
        arriving,
        points.reshape(*arriving.shape[1:], 3),
        normals.reshape(*arriving.shape[1:], 3),
        step,
    )


def irradiance(view: View) -> np.ndarray:
    """
    Sum the light that all patches reflect to the receivers of a view.

    Returns (J, h, w) complex64: phasors of irradiance, phase up to the receiver.
    """
    optics, K = view.optics, view.optics.wavenumbers
    patch, step = _pixels(view, _PATCH), _pixels(view, _RECEIVER)
    lit, lit_normal, reflectivity, path, slant = _points(view, patch)
    hit, hit_normal, _, _, _ = _points(view, step)
    # irradiance cos(theta) / z^2 times area z^2 pixels^2 / (f^2 slant cos(theta))
    radiant = reflectivity * patch**2 / (optics.intrinsics.fx * optics.intrinsics.fy) / slant
    out = np.zeros((len(K), len(hit)), np.complex128)
    _gather(
        view.solids.kinds,
        view.solids.placement,
        lit,
        lit_normal,
        radiant,
        path,
        hit,
        hit_normal,
        K,
        out,
    )
    height, width = optics.shape
    return out.astype(np.complex64).reshape(
        -1, len(range(step // 2, height, step)), len(range(step // 2, width, step))
    )


def _pixels(view: View, size: int) -> int:
    return max(2, round(size * view.optics.intrinsics.width / 224))


def _points(view: View, step: int) -> tuple[np.ndarray, ...]:
    # World points (NaN for no return), normals, reflectivity, range and range over depth of a
    # grid of pixels.
    height, width = view.optics.shape
    index = np.arange(height * width).reshape(height, width)
    rays = view.rays[index[step // 2 :: step, step // 2 :: step].ravel()]
    depth, reflectivity, normal = cast_rays(view.solids, view.R, view.origin, rays)
    toward = np.column_stack([rays, np.ones(len(rays))])
    points = view.origin + depth[:, None] * (toward @ view.R.T)
    slant = np.sqrt((toward**2).sum(-1))
    return (
        points,
        normal.astype(np.float64),
        reflectivity.astype(np.float64),
        depth * slant,
        slant,
    )


@loop()
def _gather(kinds, placement, lit, lit_normal, radiant, lit_range, hit, hit_normal, K, out):
    for i in range(len(hit)):
        if math.isnan(hit[i, 0]):
            continue
        for p in range(len(lit)):
            if math.isnan(lit[p, 0]):
                continue
            dx, dy, dz = hit[i, 0] - lit[p, 0], hit[i, 1] - lit[p, 1], hit[i, 2] - lit[p, 2]
            square = dx * dx + dy * dy + dz * dz
            leaves = dx * lit_normal[p, 0] + dy * lit_normal[p, 1] + dz * lit_normal[p, 2]
            comes = -(dx * hit_normal[i, 0] + dy * hit_normal[i, 1] + dz * hit_normal[i, 2])
            if leaves <= 1e-6 or comes <= 1e-6:
                continue
            if not in_sight(kinds, placement, lit[p], hit[i]):
                continue
            limited = max(square, _CLOSEST * _CLOSEST)
            transfer = radiant[p] * leaves * comes / (math.pi * limited * square)
            path = 0.5 * (lit_range[p] + math.sqrt(square))
            for j in range(len(K)):
                angle = K[j] * path
                out[j, i] += transfer * complex(math.cos(angle), math.sin(angle))


def _carry(
    view: View, arriving: np.ndarray, points: np.ndarray, normals: np.ndarray, step: int
) -> np.ndarray:
    # Interpolates to full resolution between the receivers around a pixel. Receivers on the
    # pixel's surface weigh more. Then the light follows the pixel's own path to the camera.
    K = view.optics.wavenumbers
    height, width = view.optics.shape
    depth, _, normal = cast_rays(view.solids, view.R, view.origin, view.rays)
    toward = np.column_stack([view.rays, np.ones(len(view.rays))]) @ view.R.T
    place = (view.origin + depth[:, None] * toward).astype(np.float32)
    out = np.zeros((len(K), height * width), np.complex64)
    _spread(
        arriving,
        points.astype(np.float32),
        normals.astype(np.float32),
        place,
        normal,
        width,
        step,
        out,
    )
    half = phasors(view.reflectivity, view.path / 2, K)
    return np.nan_to_num(out.reshape(-1, height, width)) * half


@loop()
def _spread(arriving, points, normals, place, normal, width, step, out):
    rows, columns = points.shape[0], points.shape[1]
    for i in range(len(place)):
        y, x = (i // width - step // 2) / step, (i % width - step // 2) / step
        y0, x0 = int(math.floor(y)), int(math.floor(x))
        total = 0.0
        for dy in range(-1, 3):
            for dx in range(-1, 3):
                yy, xx = y0 + dy, x0 + dx
                if yy < 0 or xx < 0 or yy >= rows or xx >= columns:
                    continue
                facing, off = 0.0, 0.0
                for axis in range(3):
                    facing += normal[i, axis] * normals[yy, xx, axis]
                    off += normal[i, axis] * (points[yy, xx, axis] - place[i, axis])
                if not facing > 0.5:
                    continue
                near = math.exp(-0.5 * ((yy - y) ** 2 + (xx - x) ** 2) / 0.49)
                weight = near * facing**8 * math.exp(-((off / 0.03) ** 2)) + 1e-12
                total += weight
                for j in range(len(out)):
                    out[j, i] += weight * arriving[j, yy, xx]
        if total > 0:
            for j in range(len(out)):
                out[j, i] /= total
