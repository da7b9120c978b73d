"""
Solid shapes with textures, and the rays that hit them.

World frame: x right, y down, z forward, metres, as seen by an upright camera. Depth is analytic
for any pose and any rays, without meshes or interpolation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np

BOX, ROOM, BALL = 0, 1, 2
PLAIN, CHECKER, STRIPES, MOTTLE = 0, 1, 2, 3
_NEAR = 0.02


@dataclass(frozen=True)
class Shape:
    """
    A solid, or a room seen from inside.

    * `kind`: `BOX`, `ROOM` (a box seen from within) or `BALL`
    * `centre`: world coordinates, metres
    * `half`: half the extent along the axes of the shape, metres; the first value is the radius of
      a ball
    * `yaw`, `pitch`: turn about the vertical, then about the shape's own x axis, radians
    * `light`, `dark`: the two reflectivities of the texture; floor and ceiling of a room are all
      `dark`
    * `texture`: `PLAIN` (all `light`), `CHECKER`, `STRIPES` or `MOTTLE`
    * `period`: period of the texture, metres
    """

    kind: int
    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    yaw: float = 0.0
    pitch: float = 0.0
    light: float = 0.6
    dark: float = 0.3
    texture: int = PLAIN
    period: float = 0.2


@dataclass(frozen=True)
class Solids:
    """
    Shapes as arrays, for the compiled ray caster.

    * `kinds`: (N,) int64
    * `placement`: (N, 15) float64: centre, half extent, rotation from own axes to the world (row
      by row)
    * `looks`: (N, 4) float64: light, dark, texture, period
    """

    kinds: np.ndarray
    placement: np.ndarray
    looks: np.ndarray


def rotation(yaw: float, pitch: float, roll: float = 0.0) -> np.ndarray:
    """Return the (3, 3) rotation: yaw about y (to the right), pitch about x (up), roll about z."""
    cy, sy = math.cos(yaw), math.sin(yaw)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    return (
        np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        @ np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    )


def pack(shapes: Sequence[Shape]) -> Solids:
    """Turn shapes into arrays."""
    return Solids(
        np.array([shape.kind for shape in shapes], np.int64),
        np.array(
            [
                [*shape.centre, *shape.half, *rotation(shape.yaw, shape.pitch).ravel()]
                for shape in shapes
            ],
            np.float64,
        ),
        np.array(
            [[shape.light, shape.dark, shape.texture, shape.period] for shape in shapes],
            np.float64,
        ),
    )


@loop()
def _local(o, placement):
    # A world point in the shape's own axes.
    x, y, z = o[0] - placement[0], o[1] - placement[1], o[2] - placement[2]
    r = placement[6:]
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


@loop()
def _hit(kind, half, ox, oy, oz, dx, dy, dz):
    # Distance along the ray in units of its direction (inf for a miss), and the axis of the face.
    if kind == BALL:
        a = dx * dx + dy * dy + dz * dz
        b = ox * dx + oy * dy + oz * dz
        root = b * b - a * (ox * ox + oy * oy + oz * oz - half[0] * half[0])
        if root <= 0:
            return math.inf, 0
        t = (-b - math.sqrt(root)) / a
        return (t, 3) if t > _NEAR else (math.inf, 0)
    enter, leave = -math.inf, math.inf
    first, last = 0, 0
    for axis in range(3):
        o = ox if axis == 0 else (oy if axis == 1 else oz)
        d = dx if axis == 0 else (dy if axis == 1 else dz)
        if abs(d) < 1e-12:
            if abs(o) > half[axis]:
                return math.inf, 0
            continue
        one, two = (-half[axis] - o) / d, (half[axis] - o) / d
        low, high = min(one, two), max(one, two)
        if low > enter:
            enter, first = low, axis
        if high < leave:
            leave, last = high, axis
    if enter > leave:
        return math.inf, 0
    if kind == ROOM:
        return (leave, last) if leave > _NEAR else (math.inf, 0)
    return (enter, first) if enter > _NEAR else (math.inf, 0)


@loop()
def _reflectivity(kind, axis, x, y, z, looks):
    light, dark, texture, period = looks[0], looks[1], looks[2], looks[3]
    if kind == ROOM and axis == 1:
        return dark
    u, v = (y, z) if axis == 0 else ((x, z) if axis == 1 else (x, y))
    if texture == CHECKER:
        return light if (math.floor(u / period) + math.floor(v / period)) % 2 == 0 else dark
    if texture == STRIPES:
        return light if math.floor(u / period) % 2 == 0 else dark
    if texture == MOTTLE:
        mix = 0.5 + 0.5 * math.sin(6.2832 * u / period) * math.sin(6.2832 * v / period)
        return dark + (light - dark) * mix
    return light


@loop()
def cast(kinds, placement, looks, R, origin, rays, depth, reflectivity, normal):
    """
    Follow rays to the first surface.

    * `kinds`, `placement`, `looks`: from `Solids`
    * `R`: (3, 3) rotation from camera to world
    * `origin`: (3,) the camera in the world, metres
    * `rays`: (N, 2) x/z and y/z in the camera's optical frame
    * `depth`, `reflectivity`: (N,) float32 outputs: metres along the optical axis, NaN for no
      return; 0 to 1
    * `normal`: (N, 3) float32 output in the world, towards the camera
    """
    count = len(kinds)
    starts = np.empty((count, 3))
    for s in range(count):
        starts[s, 0], starts[s, 1], starts[s, 2] = _local(origin, placement[s])
    for i in range(len(rays)):
        a, b = rays[i, 0], rays[i, 1]
        wx = R[0, 0] * a + R[0, 1] * b + R[0, 2]
        wy = R[1, 0] * a + R[1, 1] * b + R[1, 2]
        wz = R[2, 0] * a + R[2, 1] * b + R[2, 2]
        best, which, face = math.inf, -1, 0
        bx, by, bz = 0.0, 0.0, 0.0
        for s in range(count):
            p = placement[s]
            if kinds[s] != ROOM:  # Skip shapes that are far from the ray.
                cx, cy, cz = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
                dot = cx * wx + cy * wy + cz * wz
                reach = p[3] * p[3]
                if kinds[s] == BOX:
                    reach += p[4] * p[4] + p[5] * p[5]
                ww = wx * wx + wy * wy + wz * wz
                if cx * cx + cy * cy + cz * cz - dot * dot / ww > reach:
                    continue
            r = p[6:]
            dx = r[0] * wx + r[3] * wy + r[6] * wz
            dy = r[1] * wx + r[4] * wy + r[7] * wz
            dz = r[2] * wx + r[5] * wy + r[8] * wz
            t, axis = _hit(kinds[s], p[3:6], starts[s, 0], starts[s, 1], starts[s, 2], dx, dy, dz)
            if t < best:
                best, which, face = t, s, axis
                bx, by, bz = dx, dy, dz
        if which < 0:
            depth[i], reflectivity[i] = np.nan, 0.0
            normal[i, 0] = normal[i, 1] = normal[i, 2] = 0.0
            continue
        x = starts[which, 0] + best * bx
        y = starts[which, 1] + best * by
        z = starts[which, 2] + best * bz
        depth[i] = best
        reflectivity[i] = _reflectivity(kinds[which], face, x, y, z, looks[which])
        nx, ny, nz = 0.0, 0.0, 0.0
        if face == 3:
            nx, ny, nz = x / placement[which, 3], y / placement[which, 3], z / placement[which, 3]
        elif face == 0:
            nx = -1.0 if bx > 0 else 1.0
        elif face == 1:
            ny = -1.0 if by > 0 else 1.0
        else:
            nz = -1.0 if bz > 0 else 1.0
        r = placement[which, 6:]
        normal[i, 0] = r[0] * nx + r[1] * ny + r[2] * nz
        normal[i, 1] = r[3] * nx + r[4] * ny + r[5] * nz
        normal[i, 2] = r[6] * nx + r[7] * ny + r[8] * nz


@loop()
def in_sight(kinds, placement, one, other):
    """Return whether no shape but the room is between two world points."""
    dx, dy, dz = other[0] - one[0], other[1] - one[1], other[2] - one[2]
    for s in range(len(kinds)):
        if kinds[s] == ROOM:
            continue
        p = placement[s]
        cx, cy, cz = p[0] - one[0], p[1] - one[1], p[2] - one[2]
        dot = cx * dx + cy * dy + cz * dz
        reach = p[3] * p[3]
        if kinds[s] == BOX:
            reach += p[4] * p[4] + p[5] * p[5]
        if cx * cx + cy * cy + cz * cz - dot * dot / (dx * dx + dy * dy + dz * dz) > reach:
            continue
        ox, oy, oz = _local(one, p)
        r = p[6:]
        t, _ = _hit(
            kinds[s],
            p[3:6],
            ox,
            oy,
            oz,
            r[0] * dx + r[3] * dy + r[6] * dz,
            r[1] * dx + r[4] * dy + r[7] * dz,
            r[2] * dx + r[5] * dy + r[8] * dz,
        )
        if t < 0.98:
            return False
    return True
