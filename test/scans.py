"""Recordings of a blind camera in a room that is known as a mesh."""

from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.rooms import load_room
import numpy as np
from scipy.spatial.transform import Rotation
from study.blind.meshes import write_mesh
from study.blind.scanned import ScannedCamera
import trimesh

SEED, WIDTH, HEIGHT, RECORDINGS = 2, 112, 86, 4
SMALL_K = np.array([[25.0, 0, 15.5], [0, 25, 11.5], [0, 0, 1]])
SMALL = {'frames': 8, 'width': WIDTH, 'height': HEIGHT}


def record(folder, effects, **changes):
    """Write `in/*.npz` and `room.ply`; return the camera."""
    camera = ScannedCamera(SEED, effects, **{'recordings': RECORDINGS, **SMALL, **changes})
    (folder / 'in').mkdir(parents=True)
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    return camera


def scaled(mesh, factor):
    """Return the mesh in another scale."""
    mesh.apply_scale(factor)
    return mesh


def box(folder):
    """Write `room.ply`, a bare box; return a pose in it, as for --pose, and 24 x 32 depths."""
    mesh = trimesh.creation.box((4.0, 3.0, 2.5))
    mesh.invert()
    mesh.export(folder / 'room.ply')
    turn = Rotation.from_euler('yxz', [35, -20, 3], degrees=True).as_quat()
    numbers = np.array([0.2, 0.1, -0.3, *turn])
    v, u = np.mgrid[:24, :32]
    rays = np.stack([(u - SMALL_K[0, 2]) / 25, (v - SMALL_K[1, 2]) / 25], axis=-1).reshape(-1, 2)
    seen = load_room(folder / 'room.ply').cast(Pose.from_numbers(numbers), rays)
    return ','.join(map(str, numbers)), seen.depth.reshape(24, 32).astype(np.float32)
