"""One furnished room seen from many places: recordings that share a mesh."""

from collections.abc import Mapping
import math
from pathlib import Path as File

import numpy as np
from study.blind.campaign import BlindCamera, Case
from study.blind.meshes import mesh_pose
from study.blind.rooms import Path, Scene
from study.blind.scene_set import SceneKey, SceneSet
from study.blind.shapes import BALL, BOX, MOTTLE, pack, ROOM, rotation, Shape, Solids

_FURNITURE = 30
_CEILING, _FLOOR = -1.5, 1.2  # y of a camera's world, downwards, metres


def furnished_room(seed: int) -> Solids:
    """Return a room of about 5 x 4 x 2.7 m with boxes and a ball along its walls."""
    rng = np.random.default_rng([seed, 7])
    half = np.array([rng.uniform(1.8, 2.4), (_FLOOR - _CEILING) / 2, rng.uniform(2.3, 2.9)])
    shapes = [
        Shape(
            ROOM,
            (0.0, (_FLOOR + _CEILING) / 2, 0.0),
            (float(half[0]), float(half[1]), float(half[2])),
            light=0.7,
            dark=0.4,
            texture=MOTTLE,
            period=0.9,
        )
    ]
    for number in range(_FURNITURE):
        size = rng.uniform((0.12, 0.12, 0.12), (0.4, 0.6, 0.4))
        # Along the walls, so that the middle stays free for the camera.
        angle = rng.uniform(0, 2 * math.pi)
        x = float(np.clip(1.3 * half[0] * math.cos(angle), -half[0] + 0.3, half[0] - 0.3))
        z = float(np.clip(1.3 * half[2] * math.sin(angle), -half[2] + 0.3, half[2] - 0.3))
        # Half of the boxes stand on the floor, the other half hang on the walls.
        height = _FLOOR - float(size[1]) if number % 2 else float(rng.uniform(-1.1, 0.5))
        place = (x, height, z)
        extent = (float(size[0]), float(size[1]), float(size[2]))
        turn = float(rng.uniform(-0.6, 0.6))
        shapes.append(Shape(BOX, place, extent, yaw=turn, light=float(rng.uniform(0.3, 0.8))))
    shapes.append(Shape(BALL, (0.9, _FLOOR - 0.3, half[2] - 0.6), (0.3, 0.3, 0.3)))
    return pack(shapes)


class ScannedCamera:
    """
    A blind camera that records one room from many places.

    * `seed`: seed of the room, the poses and the noise
    * `effects`: as in `Case`
    * `recordings`, `frames`, `width`, `height`: as in `SceneKey`
    * `moving`: whether the camera walks and turns in every recording
    """

    def __init__(
        self,
        seed: int,
        effects: Mapping[str, float],
        recordings: int = 8,
        frames: int = 10,
        width: int = 224,
        height: int = 172,
        usecase: str = 'Mode_9_30fps',
        moving: bool = False,
    ) -> None:
        """Draw the poses; record nothing yet."""
        self.solids = furnished_room(seed)
        rng = np.random.default_rng([seed, 8])
        key = SceneKey(usecase, seed, 0.0, width, height, recordings, frames)
        scenes = SceneSet(key)
        turns = (np.arange(recordings) + rng.uniform(0, 0.5)) * 2 * math.pi / recordings
        scenes.scenes = tuple(
            Scene('room', self.solids, _path(rng, float(turn), moving)) for turn in turns
        )
        self.camera = BlindCamera(Case(key, effects, seed), scenes)

    def poses(self, recording: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return rotation and position of each frame's camera, in the mesh's frame."""
        path = self.camera.scenes.scenes[recording].path
        return [mesh_pose(path.pose(float(time))) for time in self.camera.scenes.times()]

    def record(self, folder: File, told: bool = False) -> None:
        """
        Write the recordings.

        * `folder`: must exist
        * `told`: whether the recordings contain ground truth (`clean_depth`, `reflectivity`), as
          those of a real camera do not
        """
        self.camera.record(folder)
        if not told:
            for file in folder.glob('*.npz'):
                with np.load(file, allow_pickle=False) as archive:
                    left = set(archive) - {'clean_depth', 'reflectivity'}
                    arrays = {key: archive[key] for key in left}
                np.savez(file, **arrays)


def _path(rng: np.random.Generator, turn: float, moving: bool) -> Path:
    x, y, z = rng.uniform((-0.7, -0.4, -0.9), (0.7, 0.5, 0.9))
    velocity = rng.uniform(-0.4, 0.4, 3) * (1, 0.3, 1) if moving else np.zeros(3)
    return Path(
        (float(x), float(y), float(z)),
        (float(velocity[0]), float(velocity[1]), float(velocity[2])),
        yaw=turn,
        pitch=float(rng.uniform(-0.5, 0.25)),
        roll=float(rng.uniform(-0.1, 0.1)),
        yaw_rate=0.4 if moving else 0.0,
    )


def off(
    pose: tuple[np.ndarray, np.ndarray], metres: float, degrees: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return a pose with an error of a given distance and angle in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    R, place = pose
    pitch, yaw, roll = axis / np.linalg.norm(axis) * math.radians(degrees)
    return R @ rotation(yaw, pitch, roll), place + metres * shift / np.linalg.norm(shift)
