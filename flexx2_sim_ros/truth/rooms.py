"""Rooms that rays are cast into, from files: triangle meshes and MuJoCo models."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, one_sentence, shown_path
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.rendering.model_cameras import VISIBLE_GROUPS
from flexx2_sim_ros.rendering.rays import exact_for_rays
from flexx2_sim_ros.rendering.scenes import read_model, reflectivity_table
import mujoco
import numpy as np
import trimesh

SUFFIXES = ('.ply', '.obj', '.glb', '.stl')
SCENE_SUFFIXES = ('.xml', '.mjcf', '.urdf')
# A triangle takes up to 4 us and 0.3 kB (bench/truth.py of aac5156).
MOST_TRIANGLES = 5_000_000
_MOST_BYTES = 4 << 30
# Metres. A ToF camera sees about 10 m; a scan in millimetres is 1000 times as large.
_SMALLEST, _LARGEST = 0.2, 200.0
_FARTHEST = 1e6
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709


@dataclass(frozen=True)
class Hits:
    """The first surfaces that rays hit."""

    depth: np.ndarray  # (N,) float64 metres along the optical axis, NaN without a hit
    normal: np.ndarray  # (N, 3) float64 unit normals in the optical frame, towards the camera
    reflectivity: np.ndarray | None  # (N,) float32, 0 to 1; None if the room has no colours
    border: np.ndarray  # (N,) bool: the hit triangle is at an open border of the mesh

    def slant(self, rays: np.ndarray) -> np.ndarray:
        """Return (N,) the product of normal and (x/z, y/z, 1), which is negative."""
        return np.einsum('ni,ni->n', self.normal[:, :2], rays) + self.normal[:, 2]


class Room:
    """Surfaces in front of a camera."""

    complete = False  # without a hit there is no surface; a scan may have a hole there
    bounds: np.ndarray  # (2, 3) least and greatest coordinates, metres

    def cast(self, pose: Pose, rays: np.ndarray) -> Hits:
        """Follow a camera's rays to the first surface, (N, 2) x/z and y/z in the optical frame."""
        found = self.hit(pose.t, rays @ pose.R[:, :2].T + pose.R[:, 2])
        hits = replace(found, normal=found.normal @ pose.R)
        hits.normal[hits.slant(rays) > 0] *= -1
        return hits

    def hit(self, place: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first surfaces in (N, 3) directions, room frame; depth in their lengths."""
        raise NotImplementedError


class MeshRoom(Room):
    """A triangle mesh."""

    def __init__(
        self, triangles: np.ndarray, reflectivity: np.ndarray | None, border: np.ndarray
    ) -> None:
        """
        Build the tree of bounding boxes.

        `triangles` are (F, 3, 3) float64 corners, metres; `reflectivity` (F, 3) float32 at each
        corner, 0 to 1, or None; `border` (F,) bool, triangles at an open border.
        """
        corners = triangles.reshape(-1, 3)
        self.bounds = np.array([corners.min(axis=0), corners.max(axis=0)])
        # Embree calculates in float32: coordinates far from zero would lose digits.
        self._centre = self.bounds.mean(axis=0)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, (triangles - self._centre).astype(np.float32))
        sides = triangles[:, 1:] - triangles[:, :1]
        normal = np.cross(sides[:, 0], sides[:, 1])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        # The additional last row is for index -1 (no hit).
        self._normal = np.vstack([normal, np.zeros(3)])
        self._border = np.append(border, False)
        self._reflectivity = (
            None
            if reflectivity is None
            else np.vstack([reflectivity, np.zeros((1, 3), np.float32)])
        )

    def hit(self, place: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first triangles in these directions; see `Room.hit`."""
        starts = np.broadcast_to(place - self._centre, directions.shape).astype(np.float32)
        found = self._scene.run(starts, directions.astype(np.float32), output=True)
        index = found['primID']
        depth = np.where(index < 0, np.nan, found['tfar'].astype(np.float64))
        mixed = None
        if self._reflectivity is not None:
            u, v = found['u'], found['v']
            corners = self._reflectivity[index]
            mixed = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        return Hits(depth, self._normal[index], mixed, self._border[index])


def visible_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return (G,) bool, the geoms that a camera sees."""
    return np.asarray(VISIBLE_GROUPS[np.clip(model.geom_group, 0, 5)] > 0)


class MujocoRoom(Room):
    """A MuJoCo model at rest, its visible geoms (groups 0 to 2)."""

    complete = True

    def __init__(self, model: mujoco.MjModel) -> None:
        """Place all geoms."""
        self._model = exact_for_rays(model)
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._reflectivity = reflectivity_table(model)
        seen = visible_geoms(model)
        solid = seen & (model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE))
        chosen = solid if solid.any() else seen
        place, reach = self._data.geom_xpos[chosen], model.geom_rbound[chosen, None]
        self.bounds = np.array([(place - reach).min(axis=0), (place + reach).max(axis=0)])

    def hit(self, place: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first geoms in these directions; see `Room.hit`."""
        count, length = len(directions), np.linalg.norm(directions, axis=1)
        distance, geom = np.empty(count), np.empty(count, np.int32)
        normal = np.zeros((count, 3))
        mujoco.mj_multiRay(
            m=self._model,
            d=self._data,
            pnt=np.ascontiguousarray(place, np.float64),
            vec=np.ascontiguousarray(directions / length[:, None], np.float64).ravel(),
            geomgroup=VISIBLE_GROUPS,
            flg_static=1,
            bodyexclude=-1,
            geomid=geom,
            dist=distance,
            normal=normal.ravel(),
            nray=count,
            cutoff=mujoco.mjMAXVAL,
        )
        depth = np.where(geom < 0, np.nan, distance / length)
        return Hits(depth, normal, self._reflectivity[geom], np.zeros(count, bool))


class _RegularFiles(trimesh.resolvers.FilePathResolver):
    """Parts of a mesh (materials, textures, buffers): ordinary files only."""

    def get(self, name: str) -> bytes:
        """Return the content of a part."""
        for part in (name.strip(), name.strip().lstrip('/'), Path(name).name):
            path = Path(self.parent, part)
            if path.exists() and not is_regular_file(path):
                raise InputError(f'{shown_path(path)}: must be an ordinary file')
        return bytes(super().get(name))


@lru_cache(maxsize=2)  # A worker process registers many recordings to the same room.
def load_room(path: Path) -> Room:
    """Load a room in metres: a mesh (`SUFFIXES`), or a model of MuJoCo (`SCENE_SUFFIXES`)."""
    if path.suffix.lower() in SCENE_SUFFIXES:
        if not is_regular_file(path):
            raise InputError(f'--scene: {shown_path(path)}: must be a file, got none')
        spec = read_model('--scene', str(path), path, ())
        with one_sentence(f'--scene: {shown_path(path)}: cannot be used'):
            model = spec.compile()
            if not visible_geoms(model).any():
                raise InputError(f'--scene: {shown_path(path)}: must have visible geoms, got none')
            room = MujocoRoom(model)
            if not (np.abs(room.bounds) < _FARTHEST).all():
                raise InputError(
                    f'--scene: {shown_path(path)}: must have geoms within {_FARTHEST:g} m, got '
                    'one that is farther away or at NaN'
                )
            return room
    # Colours of vertices, faces or textures become reflectivity: the Rec. 709 luminance.
    name = f'--scan: {shown_path(path)}'
    if path.suffix.lower() not in SUFFIXES or not is_regular_file(path):
        raise InputError(f'{name}: must be a mesh file ({", ".join(SUFFIXES)}), got no such file')
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f'{name}: must be at most 4 GiB, got {path.stat().st_size / 2**30:.1f}')
    with one_sentence(f'{name}: cannot be read as a mesh'), np.errstate(all='ignore'):
        return _room(name, _load(name, path))


def _room(name: str, mesh: trimesh.Trimesh) -> MeshRoom:
    faces, vertices = np.asarray(mesh.faces), np.asarray(mesh.vertices, np.float64)
    if len(faces) > MOST_TRIANGLES:
        raise InputError(
            f'{name}: must have at most {MOST_TRIANGLES:,} triangles, got {len(faces):,}; '
            'simplify the mesh'
        )
    if not np.isfinite(vertices).all():
        raise InputError(f'{name}: vertices: must be finite numbers, got NaN or infinity')
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f'{name}: faces: must name vertices 0 to {len(vertices) - 1}')
    triangles = vertices[faces]
    extent = np.ptp(triangles.reshape(-1, 3), axis=0)
    size = ' x '.join(f'{value:.3g}' for value in extent)
    if extent.max() > _LARGEST:
        raise InputError(
            f'{name}: must be a room in metres, got {size} m; it looks like millimetres: scale '
            'it by 0.001'
        )
    if extent.max() < _SMALLEST:
        raise InputError(f'{name}: must be a room in metres, got {size} m; scale it to metres')
    return MeshRoom(triangles, _luminance(mesh, faces), _at_border(vertices, faces))


def _load(name: str, path: Path) -> trimesh.Trimesh:
    scene = trimesh.load_scene(path, resolver=_RegularFiles(str(path)), process=False)
    meshes = [one for one in scene.dump() if isinstance(one, trimesh.Trimesh) and len(one.faces)]
    if not meshes:
        points = sum(len(getattr(one, 'vertices', ())) for one in scene.geometry.values())
        raise InputError(
            f'{name}: must have triangles, got {points} points and no faces; make a mesh of the '
            'point cloud first'
        )
    whole: Any = trimesh.util.concatenate(meshes)
    return whole


def _luminance(mesh: trimesh.Trimesh, faces: np.ndarray) -> np.ndarray | None:
    # (F, 3) reflectivity at the corners of each triangle; None without colours.
    visual: Any = mesh.visual
    given = getattr(visual, 'vertex_attributes', {}).get('color')  # Of a .glb with a material.
    if given is not None and np.ndim(given) == 2 and len(given) == len(mesh.vertices):
        return _gray(given)[faces]
    if visual.kind == 'texture':
        visual = visual.to_color()
        if np.ndim(visual.vertex_colors) != 2:  # A material of one colour.
            return None
    if visual.kind == 'face':
        light = _gray(visual.face_colors)
        return np.repeat(light[:, None], 3, axis=1) if len(light) == len(faces) else None
    if visual.kind == 'vertex':
        light = _gray(visual.vertex_colors)
        return light[faces] if len(light) == len(mesh.vertices) else None
    return None


def _gray(colours: np.ndarray) -> np.ndarray:
    return np.asarray(colours)[:, :3].astype(np.float32) @ _LUMINANCE / np.float32(255)


def _at_border(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    # Triangles with a side that no other triangle shares. Vertices at the same place count as one:
    # an .stl has three of its own for each triangle.
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces]
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1), axis=-1)
    keys = sides[..., 0].astype(np.int64) * (len(vertices) + 1) + sides[..., 1]
    _, index, count = np.unique(keys, return_inverse=True, return_counts=True)
    return (count[index.reshape(keys.shape)] == 1).any(axis=1)
