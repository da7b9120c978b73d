"""
Align a printed target to a gray image.

The sheet is rendered from a pose, blurred and lit; pose, blur and light are fitted to the gray
values of all pixels inside it (Gauss-Newton, Huber loss). Blur moves the corners of dark squares
inwards, so that a pose from corners is too far; a fit with a free blur is not.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
from flexx2_sim_ros.physics.poses import Pose, ray_slopes, weighted_equations
from flexx2_sim_ros.truth.printed import Printed
from flexx2_sim_ros.truth.solver import damped_step, minimise, robust_sigma, tile_sums
import numpy as np

_FINER, _COARSER = 4, 2  # points per pixel and axis, for a small and for a large sheet
_LARGE = 6000  # pixels
_MARGIN = 3  # pixels around the sheet that blur affects
# Width of the seam along the edge, where unknown surroundings blur in: standard deviations.
_BLURS = 2.5
_BESIDE = 100.0  # metres from the middle of the sheet
_TILE = 4  # side in pixels of a tile whose errors count as one
_HUBER = 1.5  # times the scale
_CONVERGED = 1e-5
_LEAST_PIXELS = 150
_BLUR_RANGE = np.log([0.15, 4.0])  # pixels
_FIRST_CONTRAST = 0.1
_COST_LIMIT = 0.15  # fraction of white
_FITTED = 14  # pose 6, blur, contrast, light 6
# Exponent of gray values over light: linear, or a square root (the driver's 8-bit image).
POWERS = 1.0, 0.5


@dataclass(frozen=True)
class Gray:
    """A gray image to align to."""

    image: np.ndarray  # (H, W) float64, any unit
    rays: np.ndarray  # (H, W, 2), as of `Observation`


@dataclass(frozen=True)
class GrayFit:
    """An aligned sheet."""

    pose: Pose  # of the camera in the sheet's frame
    covariance: np.ndarray  # (6, 6) of a motion of the camera, see `Pose.moved`; from noise only
    scale_shift: np.ndarray  # (6,) motion of the camera per relative change of the focal length
    blur: float  # standard deviation of the blur, pixels
    contrast: float  # reflectivity of black as a fraction of that of white
    power: float  # one of `POWERS`
    cost: float  # mean Huber loss of gray values, as a fraction of white, without the square


class _View:
    # The part of an image around the sheet, and its subpixel points.
    def __init__(self, target: Printed, gray: Gray, pose: Pose) -> None:
        self.target = target
        height, width = gray.image.shape
        shown = inside(target, pose, gray.rays)
        rows, columns = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
        if len(rows) < 3 or len(columns) < 3:
            self.window = slice(0), slice(0)
            return
        self.window = _around(rows, height), _around(columns, width)
        self.image = gray.image[self.window]
        self.rays = gray.rays[self.window]
        self.finer = _FINER if shown.sum() < _LARGE else _COARSER
        self.fine = _finer(self.rays, self.finer)
        distance = float(np.linalg.norm(pose.t))
        pixel = float(np.nanmedian(np.abs(np.diff(self.rays[..., 0], axis=1)))) * distance
        self.step = max(pixel / self.finer, 1e-4)
        self.paint = target.paint(self.step)
        v, u = (2 * a / max(a.max(), 1) - 1 for a in np.indices(self.image.shape))
        self.light = np.stack([np.ones(u.shape), u, v, u * u, u * v, v * v], axis=-1)

    def blurred(self, pose: Pose, log_blur: float) -> np.ndarray:
        # The white fraction at all subpixel points; those without a ray are white, as those beside
        # the sheet.
        x, y = (np.nan_to_num(one, nan=_BESIDE) for one in _on_sheet(pose, self.fine))
        height, width = self.paint.shape
        seen = cv2.remap(
            self.paint,
            (x / self.step + (width / 2 - 0.5)).astype(np.float32),
            (y / self.step + (height / 2 - 0.5)).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=1.0,
        )
        return np.asarray(cv2.GaussianBlur(seen, (0, 0), float(np.exp(log_blur)) * self.finer))

    def pixels(self, fine: np.ndarray) -> np.ndarray:
        # (h, w) means over the area of each pixel.
        height, width = self.image.shape
        small = fine.reshape(height, self.finer, width, self.finer)
        return np.asarray(small.mean(axis=(1, 3)), np.float64)

    def flow(self, pose: Pose) -> np.ndarray:
        # (h, w, 2, 7): motion of the sheet in pixels, per camera motion and zoom.
        x, y = np.moveaxis(self.rays, -1, 0)
        depth = -pose.t[2] / (self.rays @ pose.R[2, :2] + pose.R[2, 2])
        motion = np.moveaxis(ray_slopes(x, y, depth), (0, 1), (-2, -1))
        ray = np.concatenate([motion, self.rays[..., None]], axis=-1)
        change = np.stack([np.gradient(self.rays, axis=axis) for axis in (1, 0)], axis=-1)
        return np.asarray(np.linalg.solve(change, ray))


def _around(places: np.ndarray, size: int) -> slice:
    return slice(max(int(places[0]) - _MARGIN, 0), min(int(places[-1]) + _MARGIN + 1, size))


def _finer(rays: np.ndarray, times: int) -> np.ndarray:
    # Rays of subpixel points, extrapolated beyond the outermost pixels.
    wide = np.pad(rays, ((1, 1), (1, 1), (0, 0)), mode='reflect', reflect_type='odd')
    height, width = rays.shape[:2]
    u, v = ((np.arange(n * times) + 0.5) / times + 0.5 for n in (width, height))
    maps = np.meshgrid(u, v)
    column, row = (np.floor(m).astype(int) for m in maps)
    a, b = ((m - np.floor(m))[..., None] for m in maps)
    top = wide[row, column] * (1 - a) + wide[row, column + 1] * a
    low = wide[row + 1, column] * (1 - a) + wide[row + 1, column + 1] * a
    return np.asarray(top * (1 - b) + low * b)


def _on_sheet(pose: Pose, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Points where rays meet the plane of the sheet, metres; NaN behind the camera.
    direction = rays @ pose.R[:, :2].T + pose.R[:, 2]
    with np.errstate(invalid='ignore', divide='ignore'):
        reach = -pose.t[2] / direction[..., 2]
        reach = np.where(reach > 0, reach, np.nan)
        return pose.t[0] + reach * direction[..., 0], pose.t[1] + reach * direction[..., 1]


def inside(target: Printed, pose: Pose, rays: np.ndarray, border: float = 0.0) -> np.ndarray:
    """Return (H, W) bool: the pixels that show the sheet within its border, metres."""
    x, y = _on_sheet(pose, rays)
    width, height = target.size
    return (np.abs(x) < width / 2 - border) & (np.abs(y) < height / 2 - border)


def align_gray(
    target: Printed, gray: Gray, start: Pose, power: float, blur: float, steps: int
) -> GrayFit | None:
    """
    Align a target to a gray image from a pose and blur nearby, in at most so many steps.

    From the pose, edges are within a few pixels. None if too little of the sheet is in the image.
    """
    view = _View(target, gray, start)
    if view.window[0].stop == 0:
        return None
    border = (1 + _BLURS * blur) * view.step * view.finer
    use = inside(target, start, view.rays, border) & (np.nan_to_num(view.image) > 0)
    # Next to pixels without a ray the motion of the sheet is unknown.
    use &= np.isfinite(view.flow(start)).all(axis=(2, 3))
    if use.sum() < _LEAST_PIXELS:
        return None
    level = view.image[use] ** (1 / power)
    level /= np.percentile(level, 90)
    first = _Lit(view, use, level, start, float(np.log(blur)), _FIRST_CONTRAST, np.zeros(6))
    found = minimise(first, steps, _CONVERGED)
    covariance, shift = _accuracy(found)
    # The cost uses gray values and a fixed limit, so that costs of different poses and powers are
    # comparable.
    left = level**power - np.clip(found.model[0], 0, None) ** power
    cost = float(np.sqrt(_loss(left, _COST_LIMIT)))
    blur = float(np.exp(found.log_blur))
    return GrayFit(found.pose, covariance, shift, blur, found.contrast, power, cost)


@dataclass(frozen=True)
class _Lit:
    # A sheet in a light, as a camera at a pose sees it; a `State`.
    view: _View
    use: np.ndarray  # (h, w) bool: the pixels that are fitted
    level: np.ndarray  # (N,) their light
    pose: Pose
    log_blur: float
    contrast: float
    light: np.ndarray  # (6,) of the logarithm of the light on white

    @cached_property
    def model(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # Expected gray values, (N,), their derivatives by the fitted parameters, (N, 14), and by
        # the focal length, (N,): a longer one than assumed shows the sheet larger.
        view, use = self.view, self.use
        fine = view.blurred(self.pose, self.log_blur)
        white = view.pixels(fine)[use]
        slopes = np.stack(
            [view.pixels(np.gradient(fine, axis=axis))[use] for axis in (1, 0)], axis=1
        )
        basis = view.light[use]
        light = np.exp(np.clip(basis @ self.light, -20, 20))
        mixed = self.contrast + (1 - self.contrast) * white
        span = light * (1 - self.contrast)
        flow = view.flow(self.pose)[use]
        moved = -span[:, None] * np.einsum('ni,nij->nj', slopes * view.finer, flow)
        J = np.empty((len(white), _FITTED))
        J[:, :6] = moved[:, :6]
        # Blur follows the heat equation: its derivative is the Laplacian.
        bend = view.pixels(cv2.Laplacian(fine, cv2.CV_32F))[use]
        J[:, 6] = span * bend * (np.exp(self.log_blur) * view.finer) ** 2
        J[:, 7] = light * (1 - white)
        J[:, 8:] = (light * mixed)[:, None] * basis
        return light * mixed, J, moved[:, 6]

    @property
    def residual(self) -> np.ndarray:
        return self.level - self.model[0]

    def step(self, damping: float) -> np.ndarray:
        weight, _ = _weights(self.residual)
        step = damped_step(self.model[1], weight, self.residual, damping)
        return step / max(np.linalg.norm(step[:3]) / 0.05, np.linalg.norm(step[3:6]) / 0.1, 1.0)

    def moved(self, step: np.ndarray) -> '_Lit':
        return replace(
            self,
            pose=self.pose.moved(step[:6]),
            log_blur=float(np.clip(self.log_blur + np.clip(step[6], -0.5, 0.5), *_BLUR_RANGE)),
            contrast=float(np.clip(self.contrast + step[7], 0.0, 0.95)),
            light=self.light + np.clip(step[8:], -1, 1),
        )

    def loss(self, other: '_Lit') -> float:
        return _loss(other.residual, _weights(self.residual)[1])


def _weights(residual: np.ndarray) -> tuple[np.ndarray, float]:
    # Of a Huber loss, and its limit.
    limit = _HUBER * max(float(robust_sigma(residual)), 1e-4)
    return limit / np.maximum(np.abs(residual), limit), limit


def _loss(residual: np.ndarray, limit: float) -> float:
    size = np.abs(residual)
    return float(np.where(size < limit, size**2, 2 * limit * size - limit**2).mean())


def _accuracy(found: _Lit) -> tuple[np.ndarray, np.ndarray]:
    # Covariance of the motion with errors that are correlated within tiles, and the motion that a
    # wrong focal length causes.
    (_, J, larger), residual = found.model, found.residual
    weight, _ = _weights(residual)
    normal, pulled = weighted_equations(J.T, weight, larger)
    inverse = np.linalg.pinv(normal, hermitian=True)
    row, column = np.nonzero(found.use)
    tile = np.unique((row // _TILE) * 10_000 + column // _TILE, return_inverse=True)[1]
    score = tile_sums(tile, J * (weight * residual)[:, None])
    few = len(score) / max(len(score) - _FITTED, 1)
    covariance = inverse @ (score.T @ score) @ inverse * few
    return covariance[:6, :6], -(inverse @ pulled)[:6]


def white_fraction(target: Printed, gray: Gray, pose: Pose, blur: float) -> np.ndarray:
    """Return (H, W) the white fraction of each pixel, blurred; NaN outside of the sheet."""
    out = np.full(gray.image.shape, np.nan)
    view = _View(target, gray, pose)
    if view.window[0].stop:
        shown = inside(target, pose, view.rays)
        white = view.pixels(view.blurred(pose, float(np.log(blur))))
        out[view.window] = np.where(shown, white, np.nan)
    return out
