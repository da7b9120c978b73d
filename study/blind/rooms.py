"""Eight kinds of scene, drawn from a seed: boards, corners, stairs, corridors; still or moving."""

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from study.blind.shapes import (
    BALL,
    BOX,
    CHECKER,
    MOTTLE,
    pack,
    ROOM,
    rotation,
    Shape,
    Solids,
    STRIPES,
)

_BOB_HZ = 2.3  # a walking robot's step


@dataclass(frozen=True)
class Path:
    """
    The pose of the camera as a function of time.

    * `start`, `velocity`: world, metres and metres per second
    * `yaw`, `pitch`, `roll`: attitude at time 0, radians
    * `yaw_rate`: radians per second
    * `bob`: amplitude of the vertical motion by steps, metres
    """

    start: tuple[float, float, float]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    yaw_rate: float = 0.0
    bob: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether the pose changes with time."""
        return bool(any(self.velocity) or self.yaw_rate or self.bob)

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, 3) rotation camera to world and (3,) position at a time in seconds."""
        step = 2 * math.pi * _BOB_HZ * time
        position = np.array(self.start) + time * np.array(self.velocity)
        position[1] += self.bob * math.sin(step)
        return rotation(
            self.yaw + self.yaw_rate * time, self.pitch + self.bob * math.cos(step), self.roll
        ), position


@dataclass(frozen=True)
class Scene:
    """
    A scene and a camera in it.

    `kind`: one of `KINDS`.
    """

    kind: str
    solids: Solids
    path: Path


def make_scene(kind: str, reach: float, rng: np.random.Generator) -> Scene:
    """
    Draw a scene.

    * `kind`: one of `KINDS`
    * `reach`: longest range of the camera, metres; it determines the size of the scene
    """
    # Beyond four metres, sigma_z of the paper is too large for most effects to show.
    shapes, path = _MAKERS[kind](min(reach, 5.0), rng)
    return Scene(kind, pack(shapes), path)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _room(
    rng: np.random.Generator, far: float, side: float, height: float, yaw: float = 0.0
) -> Shape:
    # The camera is at the origin, `height` above the floor; the far wall `far` ahead.
    ceiling = _between(rng, 1.4, 1.8)
    turn = rotation(yaw, 0.0) @ np.array([0.0, 0.0, far / 2 - 1.0])
    return Shape(
        ROOM,
        (turn[0], (height - ceiling) / 2, turn[2]),
        (side, (height + ceiling) / 2, far / 2 + 1.0),
        yaw=yaw,
        light=_between(rng, 0.55, 0.85),
        dark=_between(rng, 0.3, 0.5),
        texture=MOTTLE,
        period=_between(rng, 0.6, 1.2),
    )


def _poster(
    rng: np.random.Generator, x: float, y: float, z: float, size: float, yaw: float = 0.0
) -> Shape:
    # Black and white patches on the wall, with negligible steps of depth.
    return Shape(
        BOX,
        (x, y, z),
        (size, size * 0.7, 0.001),
        yaw=yaw,
        light=0.9,
        dark=_between(rng, 0.04, 0.08),
        texture=CHECKER,
        period=size / 1.5,
    )


def _clutter(
    rng: np.random.Generator, low: float, high: float, floor: float, count: int
) -> list[Shape]:
    shapes = []
    looks = [(0.9, 0.9), (0.06, 0.06), (0.5, 0.5), (0.9, 0.08), (0.3, 0.3), (0.7, 0.2)]
    for i in range(count):
        z = _between(rng, low, high)
        x = z * _between(rng, -0.5, 0.5)
        light, dark = looks[(i + int(rng.integers(6))) % 6]
        pattern: dict[str, Any] = {
            'light': light,
            'dark': dark,
            'texture': STRIPES,
            'period': _between(rng, 0.06, 0.15),
        }
        if i % 3 == 2:
            size = _between(rng, 0.05, 0.09) * (1 + z / 2)
            shapes.append(
                Shape(BALL, (x, floor - size - _between(rng, 0, 0.5), z), (size, 0, 0), **pattern)
            )
        elif i % 3 == 1:
            shapes.append(
                Shape(
                    BOX,
                    (x, floor - 0.6, z),
                    (_between(rng, 0.02, 0.05), 0.6, 0.03),
                    yaw=_between(rng, -0.8, 0.8),
                    **pattern,
                )
            )
        else:
            tall = _between(rng, 0.15, 0.4)
            shapes.append(
                Shape(
                    BOX,
                    (x, floor - tall, z),
                    (_between(rng, 0.1, 0.25), tall, _between(rng, 0.08, 0.2)),
                    yaw=_between(rng, -0.8, 0.8),
                    **pattern,
                )
            )
    return shapes


def _board(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, far = _between(rng, 0.5, 0.9), reach * _between(rng, 0.75, 0.9)
    near = far * _between(rng, 0.4, 0.6)
    size = near * _between(rng, 0.2, 0.28)
    shapes = [
        _room(rng, far, far, height),
        Shape(
            BOX,
            (near * _between(rng, -0.15, 0.15), 0, near),
            (size, size, 0.01),
            yaw=_sign(rng) * _between(rng, 0.1, 0.95),
            light=0.9,
            dark=0.9,
        ),
    ]
    shapes += [
        _poster(rng, side * far * 0.36, -0.1 * far, far - 0.001, far * 0.11) for side in (-1, 1)
    ]
    return shapes, Path((0, 0, 0), pitch=_between(rng, -0.06, 0.04))


def _corner(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, apex = _between(rng, 0.45, 0.75), reach * _between(rng, 0.5, 0.75)
    yaw = math.pi / 4 + _between(rng, -0.2, 0.2)
    wall = apex * math.cos(yaw)
    room = _room(rng, wall, apex * math.sin(yaw), height, yaw)
    # A rotated room: the far wall and the right wall meet in front of the camera.
    ball = _between(rng, 0.06, 0.1) * apex
    shapes = [
        room,
        Shape(
            BALL,
            (_sign(rng) * 0.25 * apex, height - ball, 0.6 * apex),
            (ball, 0, 0),
            light=0.7,
            dark=0.08,
            texture=CHECKER,
            period=ball,
        ),
    ]
    return shapes, Path((0, 0, 0), pitch=_between(rng, -0.16, -0.08))


def _stairs(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height = _between(rng, 0.4, 0.6)
    rise, tread = _between(rng, 0.13, 0.18), _between(rng, 0.26, 0.32) * max(1, reach / 3.5)
    first = reach * _between(rng, 0.3, 0.4)
    shapes = [_room(rng, first + 5 * tread, 2.0, height)]
    for step in range(4):
        top = height - (step + 1) * rise
        depth = (5 - step) * tread / 2
        shapes.append(
            Shape(
                BOX,
                (0, top + 0.5, first + step * tread + depth),
                (0.9, 0.5, depth),
                light=_between(rng, 0.3, 0.8),
            )
        )
    shapes += _clutter(rng, first * 1.1, first * 1.5, height, 2)
    return shapes, Path((0, 0, 0), pitch=_between(rng, -0.3, -0.2), yaw=_between(rng, -0.2, 0.2))


def _close(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, far = _between(rng, 0.5, 0.8), min(reach, 3.0) * _between(rng, 0.5, 0.7)
    near = _between(rng, 0.35, 0.55)
    side = _sign(rng)
    shapes = [
        _room(rng, far, 1.5, height),
        Shape(
            BOX,
            (side * near * 0.3, 0, near),
            (near * 0.34, near * 0.3, 0.01),
            yaw=_between(rng, -0.15, 0.15),
            light=0.9,
        ),
        Shape(
            BOX,
            (-side * near * 0.45, near * 0.15, near * 1.5),
            (near * 0.25, near * 0.4, 0.05),
            yaw=_between(rng, -0.5, 0.5),
            light=0.06,
        ),
    ]
    return shapes, Path((0, 0, 0), pitch=_between(rng, -0.08, 0.02))


def _far(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    # The end is beyond the range of the mode.
    height, far = _between(rng, 0.7, 1.0), (3.4 if reach < 3 else 6.4) * _between(rng, 0.9, 1.1)
    shapes = [
        _room(rng, far, 0.35 * far, height),
        _poster(rng, 0.1 * far, -0.05 * far, far - 0.001, far * 0.12),
        Shape(BOX, (-0.22 * far, height - 0.5, far * 0.6), (0.12, 0.5, 0.15), light=0.9),
        Shape(BOX, (0.2 * far, height - 0.4, far * 0.4), (0.1, 0.4, 0.1), light=0.06, yaw=0.6),
    ]
    return shapes, Path((0, 0, 0), pitch=_between(rng, 0.0, 0.08), yaw=_between(rng, -0.1, 0.1))


def _forward(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, far = _between(rng, 0.4, 0.6), reach * 0.9
    shapes = [
        _room(rng, far, 0.6 * far, height),
        *_clutter(rng, 0.45 * far, 0.85 * far, height, 6),
    ]
    speed = _between(rng, 0.5, 0.9) * _sign(rng)
    return shapes, Path(
        (0, 0, 0.0 if speed > 0 else 0.25 * far),
        (0.0, 0.0, speed),
        pitch=_between(rng, -0.12, -0.02),
        bob=0.008,
    )


def _sideways(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, far = _between(rng, 0.4, 0.7), reach * _between(rng, 0.7, 0.85)
    shapes = [
        _room(rng, far, far, height),
        *_clutter(rng, 0.4 * far, 0.8 * far, height, 6),
        _poster(rng, _sign(rng) * 0.2 * far, -0.1 * far, far - 0.001, far * 0.12),
    ]
    speed = _between(rng, 0.4, 0.8) * _sign(rng)
    return shapes, Path(
        (-0.3 * speed, 0, 0),
        (speed, 0.0, 0.0),
        yaw=_between(rng, -0.1, 0.1),
        pitch=_between(rng, -0.08, 0.02),
        bob=0.005,
    )


def _turning(reach: float, rng: np.random.Generator) -> tuple[list[Shape], Path]:
    height, far = _between(rng, 0.4, 0.7), reach * _between(rng, 0.6, 0.8)
    rate = _between(rng, 0.4, 0.8) * _sign(rng)
    shapes = [
        _room(rng, far, 0.8 * far, height, yaw=_between(rng, -0.5, 0.5)),
        *_clutter(rng, 0.4 * far, 0.75 * far, height, 5),
    ]
    return shapes, Path(
        (0, 0, 0),
        (0.15, 0.0, _between(rng, 0.2, 0.4)),
        yaw=-0.3 * rate,
        yaw_rate=rate,
        pitch=_between(rng, -0.1, 0.0),
    )


_MAKERS: dict[str, Callable[[float, np.random.Generator], tuple[list[Shape], Path]]] = {
    'board': _board,
    'forward': _forward,
    'corner': _corner,
    'close': _close,
    'sideways': _sideways,
    'stairs': _stairs,
    'far': _far,
    'turning': _turning,
}
KINDS = tuple(_MAKERS)
