"""The rooms as triangle meshes, as from a scanner."""

from pathlib import Path

import numpy as np
from study.blind.shapes import BALL, BOX, ROOM, Solids
import trimesh

# From the blind camera's world (y down, z forward) to the mesh's: x right, y forward, z up.
TO_MESH = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_BALL_FINENESS = 5  # subdivisions of an icosahedron: 0.03 % of the radius


def write_mesh(solids: Solids, path: Path, longest: float | None = None) -> None:
    """
    Write a scene as a mesh, z up, metres.

    * `path`: file; its suffix gives the format
    * `longest`: longest side of a triangle, metres, for a mesh as fine as a scan
    """
    parts = []
    for kind, place in zip(solids.kinds, solids.placement, strict=True):
        centre, half, turn = place[:3], place[3:6], place[6:].reshape(3, 3)
        if kind == BALL:
            part = trimesh.creation.icosphere(_BALL_FINENESS, radius=half[0])
        else:
            assert kind in (BOX, ROOM)
            part = trimesh.creation.box(2 * half)
        vertices, faces = np.array(part.vertices), np.array(part.faces)
        if longest is not None:
            vertices, faces = trimesh.remesh.subdivide_to_size(vertices, faces, longest, 30)
        world = vertices @ turn.T + centre
        parts.append(trimesh.Trimesh(world @ TO_MESH.T, faces, process=False))
    trimesh.util.concatenate(parts).export(path)


def mesh_pose(pose: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera's rotation and position in the mesh's frame."""
    R, origin = pose
    return TO_MESH @ R, TO_MESH @ origin
