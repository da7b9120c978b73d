"""Simulated campaigns for the development of the diagnosis: rooms of boxes, with wrong poses."""

from dataclasses import dataclass, replace
from functools import lru_cache
import math

from flexx2_sim_ros.camera import Camera, flexx2, Intrinsics
from flexx2_sim_ros.effects import ageing, registry
from flexx2_sim_ros.physics.geometry import pixel_rays
import numpy as np


@dataclass(frozen=True)
class BoxRoom:
    """
    Axis-aligned boxes inside a room, each with an albedo and a checked pattern.

    * `boxes`: (N, 6) low and high corners, metres, world axes: x forward, y left, z up. The first
      one is the room itself, seen from inside.
    * `albedo`: (N, 2) of the light and the dark squares
    * `squares`: (N,) their width, metres
    """

    boxes: np.ndarray
    albedo: np.ndarray
    squares: np.ndarray


def make_room(rng):
    """Draw a room with some boxes in front of the camera at its origin."""
    near = rng.uniform(1.2, 4.5)
    room = [-1.5, -rng.uniform(0.8, 2.5), 0.0, near, rng.uniform(0.8, 2.5), 2.6]
    boxes = [room]
    for _ in range(int(rng.integers(2, 6))):
        x = rng.uniform(0.5, near - 0.1)
        y = rng.uniform(-0.5, 0.5) * x
        size = rng.uniform(0.06, 0.35, 3)
        low = 0.0 if rng.random() < 0.7 else rng.uniform(0.0, 0.5)
        boxes.append([x, y - size[1], low, x + size[0], y + size[1], low + 2 * size[2]])
    count = len(boxes)
    albedo = rng.uniform(0.08, 0.95, (count, 1)) * rng.uniform(0.35, 1.0, (count, 2))
    return BoxRoom(np.array(boxes), albedo, rng.uniform(0.08, 0.4, count))


def look(
    room,
    K,
    size,  # noqa: N803
    rotation,
    position,
    distortion=(0.0,) * 5,
):
    """
    Render depth and reflectivity.

    * `K`: (3, 3) camera matrix
    * `size`: height and width
    * `rotation`: (3, 3) from the optical frame to the world
    * `position`: (3,) of the camera, metres
    * `distortion`: coefficients of the lens, plumb_bob

    Returns (H, W) float32 each: metres along the optical axis, and albedo.
    """
    lens = replace(Intrinsics.from_matrix(K, size[1], size[0]), distortion=distortion)
    rays = np.stack([*pixel_rays(lens), np.ones(size)], -1)
    rays = rays.reshape(-1, 3) @ rotation.T
    rays[np.abs(rays) < 1e-9] = 1e-9
    best = np.full(len(rays), np.inf)
    albedo = np.zeros(len(rays))
    for index, box in enumerate(room.boxes):
        to_low, to_high = (box[:3] - position) / rays, (box[3:] - position) / rays
        enter = np.minimum(to_low, to_high).max(axis=1)
        leave = np.maximum(to_low, to_high).min(axis=1)
        hit = leave if index == 0 else np.where((enter < leave) & (enter > 0), enter, np.inf)
        closer = hit < best
        best[closer] = hit[closer]
        points = position + rays[closer] * hit[closer, None]
        parity = np.floor(points / room.squares[index] + 1e-6).sum(axis=1).astype(int) % 2
        albedo[closer] = room.albedo[index][parity]
    return (best.reshape(size).astype(np.float32), albedo.reshape(size).astype(np.float32))


def optical(yaw, pitch, roll):
    """Return the rotation from the optical frame to the world; angles in radians."""
    base = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    tilt = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    lean = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return turn @ tilt @ lean @ base


def write_campaign(
    folder,
    *,
    effects=None,
    seed=0,
    recordings=8,
    frames=20,
    usecase='Mode_9_30fps',
    pose=(0.002, 0.125),
    reflectivity=0.2,
    sigma=0.05,
    scale=1.0,
    novel=None,
    moving=3,
    distortion=(0.0,) * 5,
):
    """
    Write recordings of a camera with effects; the user knows pose, noise and albedo inexactly.

    * `folder`: folder of the recordings; created if it does not exist
    * `effects`: parameters of the real camera's effects, by name
    * `seed`: seed of all random numbers
    * `recordings`, `frames`: number of recordings, and of frames in each
    * `pose`: standard deviation of each recording's pose error, metres and degrees along each axis
    * `reflectivity`, `sigma`: relative standard deviation of the error of each recording's
      reflectivity, and of that of sigma_z
    * `scale`: factor on the width and height of the image
    * `novel`: an effect outside the catalogue: changes the measured depth (T, H, W), given the
      arrays of the recording
    * `moving`: number of recordings with a moving camera
    * `distortion`: coefficients of the camera's lens, plumb_bob; the user knows them
    """
    folder.mkdir(parents=True, exist_ok=True)
    views = render_views(seed, recordings, frames, usecase, pose, scale, moving, distortion)
    rng = np.random.default_rng([seed, 1])
    profile = flexx2().noisier(1 + sigma * rng.standard_normal())
    for index, (content, true, albedo_true) in enumerate(views):
        stamps, uptime = content['stamp'], float(content['uptime'][0])
        table = {name: dict(values) for name, values in (effects or {}).items()}
        for name in ageing(table):
            table[name]['uptime'] = uptime
        own = tuple(registry()[name].from_mapping(values) for name, values in table.items())
        device = Camera(usecase, profile=profile, effects=own, seed=seed + 1_000_003, name='real')
        depth = device.capture(true, content['K'], stamps, albedo_true).depth
        wrong = np.clip(
            math.exp(reflectivity * rng.standard_normal()) * content['reflectivity'], 0.01, 1
        ).astype(np.float32)
        content = {**content, 'reflectivity': wrong, 'usecase': np.array(usecase)}
        if novel is not None:
            depth = novel(depth, {**content, 'rng': rng, 'index': index})
        np.savez(folder / f'scene_{index:02d}.npz', depth=depth.astype(np.float32), **content)


@dataclass(frozen=True)
class _CameraPath:
    # Where a recording's camera is, and by how much the user is wrong about it.
    start: np.ndarray  # metres
    speed: np.ndarray  # metres per second
    yaw: float  # radians
    pitch: float
    turning: float  # radians per second, about the vertical
    shift: np.ndarray  # error of the pose, metres
    turn: np.ndarray  # radians

    @classmethod
    def draw(cls, rng, moving, pose):
        speed, turning = np.zeros(3), 0.0
        if moving:
            speed = np.array(
                [rng.uniform(0.2, 1.0) * rng.choice([-1, 1]), rng.uniform(-0.3, 0.3), 0.0]
            )
            turning = rng.uniform(-0.4, 0.4)
        start = np.array([0.0, rng.uniform(-0.2, 0.2), rng.uniform(0.25, 0.9)])
        yaw, pitch = rng.uniform(-0.3, 0.3), rng.uniform(-0.05, 0.5)
        shift = rng.standard_normal(3) * pose[0]
        turn = np.radians(rng.standard_normal(3) * pose[1])
        return cls(start, speed, yaw, pitch, turning, shift, turn)

    def poses(self, t):
        # Rotation and position at a time: those that the user believes, and the real ones.
        rotation = optical(self.yaw + self.turning * t, self.pitch, 0.0)
        position = self.start + self.speed * t
        x, y, z = self.turn
        small = np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])
        return (rotation, position), (rotation @ small, position + rotation @ self.shift)


@lru_cache(maxsize=8)
def render_views(seed, recordings, frames, usecase, pose, scale, moving, distortion=(0.0,) * 5):
    """Return each recording's arrays as the user has them, and the real depth and albedo."""
    rng = np.random.default_rng(seed)
    camera = flexx2().intrinsics
    size = (round(camera.height * scale), round(camera.width * scale))
    K = camera.matrix.copy()
    K[:2] *= scale
    K[:2, 2] += (scale - 1) / 2
    rate = flexx2().mode(usecase).rate_hz
    views = []
    for index in range(recordings):
        room = make_room(rng)
        stamps = 100.0 * index + np.rint(np.arange(frames) * 1e9 / rate) / 1e9
        path = _CameraPath.draw(rng, index >= recordings - moving, pose)
        images = []
        for t in stamps - stamps[0] if path.speed.any() else [0.0]:
            believed, real = path.poses(t)
            images.append(
                (
                    *look(room, K, size, *believed, distortion),
                    *look(room, K, size, *real, distortion),
                )
            )
        stacks = [
            np.stack(one) if len(images) > 1 else one[0] for one in zip(*images, strict=True)
        ]
        uptime = float(rng.choice([5.0, 60.0, 300.0, 900.0, 2400.0])) * rng.uniform(0.7, 1.3)
        content = {
            'clean_depth': stacks[0],
            'reflectivity': stacks[1],
            'K': K,
            'stamp': stamps,
            'uptime': uptime + stamps - stamps[0],
            'pose_error': np.array([*path.shift, *path.turn]),
            'distortion': np.array(distortion),
        }
        views.append((content, stacks[2], stacks[3]))
    return views
