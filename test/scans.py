"""Recordings of a blind camera in a room that is known as a mesh."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.validation.blind.meshes import write_mesh
from flexx2_sim_ros.validation.blind.scanned import ScannedCamera
import trimesh

SEED, WIDTH, HEIGHT, RECORDINGS = 2, 112, 86, 4
SMALL = {'frames': 8, 'width': WIDTH, 'height': HEIGHT}


def record(folder: Path, effects: dict[str, float], **changes: Any) -> ScannedCamera:
    """Write `in/*.npz` and `room.ply`; return the camera."""
    camera = ScannedCamera(SEED, effects, **{'recordings': RECORDINGS, **SMALL, **changes})
    (folder / 'in').mkdir(parents=True)
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    return camera


def scaled(mesh: trimesh.Trimesh, factor: float) -> trimesh.Trimesh:
    """Return the mesh in another scale."""
    mesh.apply_scale(factor)
    return mesh
