"""Printed boards: which one it is, and where a gray image shows it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import cv2
from flexx2_sim_ros.config_file import read_mapping
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.physics.poses import Pose, rotation_of
from flexx2_sim_ros.recording.truth import plane_axes
from flexx2_sim_ros.truth.gray import align_gray, Gray, GrayFit, POWERS, white_fraction
from flexx2_sim_ros.truth.printed import AprilGrid, Charuco, Chessboard, CircleGrid, Printed
from flexx2_sim_ros.truth.target import read_target
import numpy as np
from scipy.ndimage import map_coordinates

_BRIGHT, _DARK = 99.0, 1.0  # percentiles
# Modules are only a few pixels wide and blurred, so the image is enlarged.
# Beyond 1.5 m tags are found by their contrast to their surroundings of this many pixels.
_NEAR_BY, _CONTRASTS = 12.0, 2.0
_LOST = 1.5  # times the cost of the frame before
_WORST_COST = 0.12  # as a fraction of white: a fit with a larger cost is not this board
_FIRST_BLUR = 0.5  # pixels
_ROUGH_STEPS, _STEPS = 10, 25
_TILT, _SAME = np.radians(15), np.radians(3)
_SMALL_TAG = 16  # pixels
_MOST_SQUARES, _LEAST, _LARGEST = 50, 0.002, 1.0  # metres. ASSUMED
_KALIBR = 'aprilgrid', 'checkerboard', 'circlegrid'
_FORMS = (
    'chessboard:9x6:0.03 (inner corners, metres), charuco:5x7:0.04:0.03:DICT_5X5_100, '
    'circles:7x6:0.03:0.015 or acircles:4x11:0.02:0.015 (circles, distance, diameter)'
)


def _find_tags(target: Printed, image: np.ndarray) -> dict[int, np.ndarray]:
    # The (C, 2) points of tags, or of the corners of a chessboard, in pixels, by their place in
    # `corners` of the board.
    best: dict[int, np.ndarray] = {}
    for picture, factor in _pictures(image):
        found = target.find(picture)
        if len(found) > len(best):
            # Pixel centres are whole numbers in both images.
            best = {place: (quad + 0.5) / factor - 0.5 for place, quad in found.items()}
        if len(best) == len(target.corners()):
            break
    return best


def _pictures(image: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    good = image[np.isfinite(image)]
    if not good.size:
        return
    low, high = np.percentile(good, [_DARK, _BRIGHT])
    even = np.clip((np.nan_to_num(image, nan=high) - low) / max(high - low, 1e-12), 0, 1)
    # Saturated pixels are bright.
    filled = np.nan_to_num(image, nan=high).astype(np.float32)
    mean = cv2.GaussianBlur(filled, (0, 0), _NEAR_BY)
    variance = cv2.GaussianBlur(filled**2, (0, 0), _NEAR_BY) - mean**2
    local = (filled - mean) / (2 * _CONTRASTS * np.sqrt(np.maximum(variance, 1e-12))) + 0.5
    for shade, factor in ((even, 4), (local, 6), (even, 2)):
        picture = (np.clip(shade, 0, 1) * 255).astype(np.uint8)
        size = picture.shape[1] * factor, picture.shape[0] * factor
        yield cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC), factor


def _poses_from(target: Printed, tags: dict[int, np.ndarray], rays: np.ndarray) -> list[Pose]:
    # The camera's poses in the target's frame that explain these points, the better one first: a
    # distant plane can be mistaken for its mirror image.
    if not tags:
        return []
    places = sorted(tags)
    on_board = target.corners()[places].reshape(-1, 3)
    pixels = np.concatenate([tags[place] for place in places])
    seen = np.stack(
        [
            map_coordinates(rays[..., k], pixels[:, ::-1].T, order=1, mode='nearest')
            for k in (0, 1)
        ],
        axis=1,
    )
    good = np.isfinite(seen).all(axis=1)
    if good.sum() < 4:
        return []
    _, turns, moves, _ = cv2.solvePnPGeneric(
        on_board[good], seen[good], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    out = []
    for turn, move in zip(turns, moves, strict=True):
        turn, move = cv2.solvePnPRefineLM(on_board[good], seen[good], np.eye(3), None, turn, move)
        R = cv2.Rodrigues(turn)[0]
        pose = Pose(R.T, -R.T @ move.ravel())
        if np.isfinite(pose.t).all() and pose.t[2] < 0:
            out.append(pose)
    return out


def likeness(kinds: Sequence[Printed], gray: Gray) -> tuple[float, ...]:
    """Return the correlation of an image with boards of the same corners; empty without these."""
    starts = _poses_from(kinds[0], _find_tags(kinds[0], gray.image), gray.rays)
    out = []
    for kind in kinds if starts else ():
        white = white_fraction(kind, gray, starts[0], _FIRST_BLUR)
        both = np.isfinite(white) & np.isfinite(gray.image)
        out.append(float(np.corrcoef(white[both], gray.image[both])[0, 1]) if both.any() else 0.0)
    return tuple(out)


def find_board(
    target: Printed, gray: Gray, scale_error: float, before: GrayFit | None = None
) -> GrayFit | str:
    """
    Find a board in a gray image, and align it; or return why it is not found.

    `scale_error` is that of the focal length, as a fraction; `before` the fit of the last frame.
    """
    powers: tuple[float, ...] = POWERS
    if before is not None:
        powers = (before.power,)
        best = align_gray(target, gray, before.pose, before.power, before.blur, _ROUGH_STEPS)
        if best is not None and best.cost < _LOST * before.cost:
            return _refined(target, gray, best, scale_error)
    tags = _find_tags(target, gray.image)
    starts = _poses_from(target, tags, gray.rays)
    if not starts:
        return 'the board is not found in its gray image'
    rough = [
        fit
        for pose, power in product(_starts(starts, tags, target.turns), powers)
        if (fit := align_gray(target, gray, pose, power, _FIRST_BLUR, _ROUGH_STEPS)) is not None
    ]
    if not rough:
        return 'too little of the board is in its gray image'
    return _refined(target, gray, min(rough, key=lambda fit: fit.cost), scale_error)


def _refined(target: Printed, gray: Gray, rough: GrayFit, scale_error: float) -> GrayFit | str:
    # Second round, with pixels and sheet for the pose that was found.
    fit = align_gray(target, gray, rough.pose, rough.power, rough.blur, _STEPS)
    if fit is None or fit.pose.t[2] > 0:
        return 'too little of the board is in its gray image'
    if fit.cost > _WORST_COST:
        return 'its gray image shows a board, but not as its description has it'
    shift = fit.scale_shift * np.hypot(scale_error, target.scale_error)
    return replace(fit, covariance=fit.covariance + np.outer(shift, shift))


def _starts(starts: list[Pose], tags: dict[int, np.ndarray], turns: int) -> list[Pose]:
    # Corners hardly determine the tilt of a board whose tags or squares are small.
    first, *others = starts
    side = np.median(
        [np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1) for quad in tags.values()]
    )
    out = [first, *(o for o in others if np.abs(first.motion_to(o)[3:]).max() > _SAME)]
    if side < _SMALL_TAG:
        out += [_tilted(first, axis, angle) for axis in (0, 1) for angle in (-_TILT, _TILT)]
    return [_tilted(one, 2, k * 2 * np.pi / turns) for one in out for k in range(turns)]


def _tilted(pose: Pose, axis: int, angle: float) -> Pose:
    # The pose is turned about the centre of the board.
    turn = rotation_of(np.eye(3)[axis] * angle)
    return Pose(turn @ pose.R, turn @ pose.t)


def plane_covariance(pose: Pose, covariance: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """
    Return the (3, 3) covariance of the board's plane, as in the key ``plane_covariance``.

    `pose` is that of the camera in the frame of the board, `covariance` (6, 6) of its motion;
    `middle` (3,) the mean of the plane's known points, optical frame, metres.
    """
    normal = pose.R[2] * (1.0 if pose.R[2] @ middle >= 0 else -1.0)
    first, second = plane_axes(normal)
    # A motion of the camera moves the board in the opposite direction.
    change = np.zeros((3, 6))
    change[0] = -np.concatenate([normal, np.cross(middle, normal)])
    change[1, 3:], change[2, 3:] = -first, -second
    return np.asarray(change @ covariance @ change.T)


def read_board(given: str | Path) -> Printed:
    """
    Return the board that a text (see --board), ``target.yaml`` or a file of Kalibr describes.

    Raises `InputError` when it is none of these, or impossible.
    """
    kind, *words = str(given).split(':')
    if kind in _MAKERS:
        try:
            return _MAKERS[kind](*words)
        except (TypeError, ValueError, AttributeError, cv2.error):
            raise InputError(f'--board: must be {_FORMS}, got {shown(str(given))}') from None
    path = Path(given)
    content = read_mapping(path) if path.suffix == '.yaml' else {}
    if 'target_type' not in content:
        return read_target(path)
    kind = content['target_type']
    if kind not in _KALIBR:
        raise InputError(
            f'{shown_path(path)}: target_type: must be one of {", ".join(_KALIBR)}, got '
            f'{shown(kind)}'
        )
    try:
        return _of_kalibr(kind, content)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f'{shown_path(path)}: must be a target of Kalibr, got {error}') from None


def _count(value: Any, least: int = 1) -> int:
    count = int(value)
    if not least <= count <= _MOST_SQUARES:
        raise ValueError(f'{shown(value)} squares or tags')
    return count


def _metres(value: Any) -> float:
    metres = float(value)
    if not _LEAST <= metres <= _LARGEST:
        raise ValueError(f'{shown(value)} metres')
    return metres


def _size(text: str, least: int) -> list[int]:
    return [_count(word, least) for word in text.split('x')]


def _chessboard(size: str, square: Any) -> Printed:
    columns, rows = _size(size, 3)  # of inner corners
    return Chessboard(columns + 1, rows + 1, _metres(square))


def _charuco(size: str, square: str, marker: str, dictionary: str) -> Printed:
    columns, rows = _size(size, 2)
    board = Charuco(columns, rows, _metres(square), marker=_metres(marker), dictionary=dictionary)
    board.corners()
    return board


def _circles(size: str, square: Any, diameter: str = '', asymmetric: bool = False) -> Printed:
    columns, rows = _size(size, 2)
    wide = _metres(diameter) if diameter else 0.0
    board = CircleGrid(columns, rows, _metres(square), asymmetric=asymmetric, diameter=wide)
    if wide >= board.pitch:
        raise ValueError(f'circles of {wide:g} m')
    return board


def _of_kalibr(kind: str, content: dict[str, Any]) -> Printed:
    if kind == 'aprilgrid':
        tag = _metres(content['tagSize'])
        columns, rows = _count(content['tagCols']), _count(content['tagRows'])
        return AprilGrid(columns, rows, tag, gap=_metres(tag * float(content['tagSpacing'])))
    size = f'{content["targetCols"]}x{content["targetRows"]}'
    if kind == 'circlegrid':  # Kalibr does not say how large its circles are.
        asymmetric = bool(content['asymmetricGrid'])
        return _circles(size, content['spacingMeters'], asymmetric=asymmetric)
    across, down = (_metres(content[f'{name}SpacingMeters']) for name in ('col', 'row'))
    if across != down:
        raise ValueError(f'squares of {across:g} x {down:g} m')
    return _chessboard(size, across)


_MAKERS: dict[str, Callable[..., Printed]] = {
    'chessboard': _chessboard,
    'charuco': _charuco,
    'circles': _circles,
    'acircles': partial(_circles, asymmetric=True),
}
