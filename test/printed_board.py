"""A printed board before a camera, drawn by tracing many rays: shares no code with the package."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT, FOCAL = 224, 172, 186.0
K = np.array([[FOCAL, 0, 111.2], [0, FOCAL, 86.1], [0, 0, 1]])
SHEET = 0.420, 0.297
TAG, GAP = 0.115, 0.025
_FINE = 2000  # pixels a metre of the drawing


def sheet() -> np.ndarray:
    """Return the A3 sheet with 3 x 2 tags as an image, 1 for white."""
    width, height = (round(side * _FINE) for side in SHEET)
    image = np.ones((height, width), np.float32)
    side, step = round(TAG * _FINE), round((TAG + GAP) * _FINE)
    left, top = (width - 2 * step - side) // 2, (height - step - side) // 2
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number in range(6):
        x, y = left + number % 3 * step, top + number // 3 * step
        tag = codes.generateImageMarker(number, side)
        image[y : y + side, x : x + side] = tag / 255
    return image


def placed(distance: float, tilt: float, turn: float, roll: float = 0.0) -> tuple:
    """Return rotation and place of the board in the camera's frame; degrees and metres."""
    R = Rotation.from_euler('zxy', [roll, tilt, turn], degrees=True).as_matrix()
    return R, np.array([0.03, -0.02, distance])


def distorted_rays(lens: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return rays of points in the image."""
    points = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
    if lens.any():
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        points = cv2.undistortPoints(points[:, None], K, lens, None, None, None, criteria)[:, 0]
    else:
        points = (points - K[:2, 2]) / FOCAL
    return points.reshape(*u.shape, 2)


def look(
    R: np.ndarray,
    t: np.ndarray,
    rng: np.random.Generator,
    blur: float = 0.6,
    root: bool = False,
    noise: float = 0.01,
    scale: float = 1.0,
    lens: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return gray image and clean depth (a wall at 0.4 m behind the board), (H, W) each."""
    picture = sheet()
    lens = np.zeros(5) if lens is None else lens
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    total = np.zeros((HEIGHT, WIDTH))
    rays_count = 12
    for a in range(rays_count):
        for b in range(rays_count):
            # Stratified over the pixel, then moved by the blur.
            du, dv = (
                (np.array([a, b])[:, None, None] + rng.random((2, HEIGHT, WIDTH))) / rays_count
                - 0.5
                + blur * rng.standard_normal((2, HEIGHT, WIDTH))
            )
            bright, _ = _trace(distorted_rays(np.zeros(5), u + du, v + dv)
                               if not lens.any() else
                               _shifted(lens, u, v, du, dv), R, t, picture, scale)
            total += bright
    total /= rays_count**2
    _, depth = _trace(distorted_rays(lens, u, v), R, t, picture, scale)
    total *= 1 + noise * rng.standard_normal(total.shape)
    total += 0.002 * rng.standard_normal(total.shape)
    total = np.clip(total, 0, None)
    if root:
        return np.round(np.clip(np.sqrt(total) * 180, 0, 255)).astype(np.float32), depth
    return (total * 1000).astype(np.float32), depth


def _shifted(lens, u, v, du, dv):
    # Rays bend little within a pixel: linear between them.
    r = distorted_rays(lens, u, v)
    ru = distorted_rays(lens, u + 1, v) - r
    rv = distorted_rays(lens, u, v + 1) - r
    return r + du[..., None] * ru + dv[..., None] * rv


def _trace(rays, R, t, picture, scale):
    d = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    n = R[:, 2]
    z = (n @ t) / (d @ n)
    on_board = (d * z[..., None] - t) @ R / scale
    x, y = on_board[..., 0], on_board[..., 1]
    inside = (np.abs(x) < SHEET[0] / 2) & (np.abs(y) < SHEET[1] / 2) & (z > 0)
    i = np.clip(((y + SHEET[1] / 2) * _FINE).astype(int), 0, picture.shape[0] - 1)
    j = np.clip(((x + SHEET[0] / 2) * _FINE).astype(int), 0, picture.shape[1] - 1)
    wall = t[2] + 0.4
    depth = np.where(inside, z, wall)
    colour = np.where(inside, 0.06 + 0.76 * picture[i, j], 0.3)
    length = np.sqrt((d**2).sum(axis=-1))
    cosine = np.where(inside, np.abs(d @ n), 1.0) / length
    # Falls off with the square of distance, and towards the image's corners.
    bright = colour * cosine / (depth * length) ** 2 * (1.2 - 0.9 * (rays[..., 0] ** 2 + rays[..., 1] ** 2))
    return bright * (1 + 0.2 * rays[..., 0]), depth
