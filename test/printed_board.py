"""A printed board in front of a camera, ray traced; shares no code with the package."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from study.blind.sensor import demodulate, expose, split_noise, unwrap, wavenumbers

WIDTH, HEIGHT, FOCAL = 224, 172, 186.0
K = np.array([[FOCAL, 0, 111.2], [0, FOCAL, 86.1], [0, 0, 1]])
# Width and height of the sheet, side of a tag and gap between tags, metres.
SHEETS = {'A3': (0.420, 0.297, 0.115, 0.025), 'A2': (0.594, 0.420, 0.165, 0.030)}
TAG_36H11 = [255, 255, 0, 255, 0, 255]  # the first row of its first tag, as AprilTag draws it
_FINE = 2000  # pixels per metre of the drawing
_RAYS = 8  # rays per pixel and axis
_WALL = 0.4  # metres behind the board


def sheet(name):
    """Return a sheet with 3 x 2 tags as an image, 1 for white."""
    width, height, tag, gap = (round(side * _FINE) for side in SHEETS[name])
    image = np.ones((height, width), np.float32)
    side, step = tag, tag + gap
    left, top = (width - 2 * step - side) // 2, (height - step - side) // 2
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number in range(6):
        x, y = left + number % 3 * step, top + number // 3 * step
        image[y : y + side, x : x + side] = codes.generateImageMarker(number, side) / 255
    return image


def chessboard():
    """Return a chessboard of 9 x 6 inner corners, 30 mm squares; the upper left one is white."""
    squares = np.add.outer(np.arange(7), np.arange(10)) % 2 == 0
    return np.kron(squares, np.ones((60, 60))).astype(np.float32)


def charuco():
    """Return OpenCV's board of 5 x 7 squares of 40 mm with markers of 30 mm."""
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((5, 7), 0.04, 0.03, codes)
    return np.asarray(board.generateImage((400, 560)), np.float32) / 255


def april_grid():
    """Return Kalibr's grid of 4 x 3 tags of 80 mm, numbered from below, 24 mm apart."""
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side, gap = 160, 48
    step = side + gap
    image = np.ones((3 * step + gap, 4 * step + gap), np.float32)
    for y in range(0, len(image), step):
        for x in range(0, image.shape[1], step):
            image[y : y + gap, x : x + gap] = 0
    upright = cv2.aruco.generateImageMarker(codes, 0, 8)[1, 1:7].tolist() == TAG_36H11
    for number in range(12):
        x, y = number % 4 * step + gap, (2 - number // 4) * step + gap
        tag = cv2.aruco.generateImageMarker(codes, number, side, borderBits=2) / 255
        image[y : y + side, x : x + side] = tag if upright else tag[::-1, ::-1]
    return image


def circles(columns, rows, step, wide, shifted):
    """Return OpenCV's grid of circles; metres between rows, and across a circle."""
    rim = step * (0.5**0.5 if shifted else 0.5)
    y, x = np.mgrid[:rows, :columns] * step + rim
    if shifted:
        x = (2 * x - rim) + step * (np.arange(rows)[:, None] % 2)
    size = np.rint((np.array([y.max(), x.max()]) + rim) * _FINE).astype(int)
    v, u = (np.mgrid[: size[0], : size[1]] + 0.5) / _FINE
    image = np.ones(size, np.float32)
    for a, b in zip(x.ravel(), y.ravel(), strict=True):
        image[(u - a) ** 2 + (v - b) ** 2 < wide**2 / 4] = 0
    return image


class Board:
    """
    A board at a place in the camera's frame.

    * `distance`: metres
    * `tilt`, `turn`: degrees about x and y
    * `size`: factor by which the print is too large
    * `name`: one of `SHEETS`
    * `picture`: what is printed instead, 2000 pixels a metre
    * `glued`: whether it is on a wall, and not before one
    """

    def __init__(self, distance, tilt, turn, size=1.0, name='A3', picture=None, glued=False):
        """Place the board."""
        self.R = Rotation.from_euler('zxy', [3, tilt, turn], degrees=True).as_matrix()
        self.t = np.array([0.03, -0.02, distance])
        self.size = size
        self._picture = sheet(name)
        self._sides = np.array(SHEETS[name][:2])
        self.glued = glued
        if picture is not None:
            self._picture = picture
            self._sides = np.array(picture.shape[::-1]) / _FINE

    def look(self, rng, blur=0.6, lens=None):
        """Return the light without noise and the depth, (H, W) each, of board and wall."""
        rays, across, down = _rays(np.zeros(5) if lens is None else lens)
        total = np.zeros((HEIGHT, WIDTH))
        for a in range(_RAYS):
            for b in range(_RAYS):
                # Stratified over the pixel, then moved by the blur.
                u, v = (
                    (k + rng.random((HEIGHT, WIDTH, 1))) / _RAYS
                    - 0.5
                    + blur * rng.standard_normal((HEIGHT, WIDTH, 1))
                    for k in (a, b)
                )
                total += self._trace(rays + u * across + v * down)[0]
        return total / _RAYS**2, self._trace(rays)[1]

    def _trace(self, rays):
        direction = np.concatenate([rays, np.ones((HEIGHT, WIDTH, 1))], axis=-1)
        normal = self.R[:, 2]
        depth = (normal @ self.t) / (direction @ normal)
        place = (direction * depth[..., None] - self.t) @ self.R[:, :2] / self.size
        inside = (np.abs(place) < self._sides / 2).all(axis=-1)
        index = ((place + self._sides / 2) * _FINE).astype(int)
        row = np.clip(index[..., 1], 0, self._picture.shape[0] - 1)
        column = np.clip(index[..., 0], 0, self._picture.shape[1] - 1)
        if not self.glued:
            depth = np.where(inside, depth, self.t[2] + _WALL)
        colour = np.where(inside, 0.06 + 0.76 * self._picture[row, column], 0.3)
        length = np.sqrt((direction**2).sum(axis=-1))
        cosine = np.where(inside, np.abs(direction @ normal), 1.0) / length
        # Light falls off with distance and towards the image's corners, and not evenly.
        lamp = (1.2 - 0.9 * (rays**2).sum(axis=-1)) * (1 + 0.2 * rays[..., 0])
        return colour * cosine * lamp / (depth * length) ** 2, depth


def gray_of(light, noise, rng):
    """Return the driver's gray image: 8 bit, a root of the light, saturated next to the camera."""
    light = light * (1 + noise * rng.standard_normal(light.shape))
    return np.clip(150 * np.sqrt(np.clip(light, 0, None)), 0, 255).astype(np.uint8)


def expose_blind(light, depth, frames, rng):
    """Return gray values of 16 bits and depth, (T, H, W), by the taps of the blind camera."""
    waves = wavenumbers((80.32e6, 60.24e6))
    length = np.sqrt(1 + (_rays(np.zeros(5))[0] ** 2).sum(axis=-1))
    reach = (depth * length).ravel().astype(np.float32)
    level = light.ravel().astype(np.float32)
    phasors = (level * np.exp(1j * waves[:, None] * reach)).astype(np.complex64)
    # The paper's noise at 1 m: 4 mm.
    phase, path = split_noise((0.004 * depth**2).ravel(), waves)
    same, gain, still = np.arange(reach.size, dtype=np.int32), np.ones_like(reach), 0 * reach
    gray, shown = [], []
    for _ in range(frames):
        taps, jitter = np.empty((2, 4, reach.size), np.float32), np.empty_like(reach)
        normals = rng.standard_normal((9, reach.size)).astype(np.float32)
        expose(phasors, same, level, phase, path, gain, still, waves, normals, jitter, taps)
        seen, out = demodulate(taps), np.empty_like(reach)
        unwrap(seen, waves, reach, still, 7.46, out)
        gray.append(np.abs(seen).mean(axis=0).reshape(depth.shape))
        shown.append(out.reshape(depth.shape) / length)
    bright = np.clip(np.stack(gray) * 6000, 0, 65535).astype(np.uint16)
    return bright, np.stack(shown).astype(np.float32)


def _rays(lens):
    # Rays of the pixel centres, and their differences to the next column and row.
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return (
        _ray(lens, u, v),
        _ray(lens, u + 0.5, v) - _ray(lens, u - 0.5, v),
        _ray(lens, u, v + 0.5) - _ray(lens, u, v - 0.5),
    )


def _ray(lens, u, v):
    if not lens.any():
        return (np.stack([u, v], axis=-1) - K[:2, 2]) / FOCAL
    enough = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = cv2.undistortPoints(pixels[:, None], K, lens, criteria=enough)
    return np.asarray(rays).reshape(*u.shape, 2)
