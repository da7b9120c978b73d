"""Rooms that rays are cast into: triangle meshes and MuJoCo models."""

from dataclasses import dataclass, replace

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from flexx2_sim_ros.rendering.model_cameras import VISIBLE_GROUPS
from flexx2_sim_ros.rendering.rays import exact_for_rays
from flexx2_sim_ros.rendering.scenes import reflectivity_table
from flexx2_sim_ros.truth.poses import Pose
import mujoco
import numpy as np


@dataclass(frozen=True)
class Hits:
    """
    The first surfaces that rays hit.

    * `depth`: (N,) float64 metres along the optical axis, NaN without a hit.
    * `normal`: (N, 3) float64 unit normals in the optical frame, towards the camera.
    * `reflectivity`: (N,) float32, 0 to 1; None if the room has no colours.
    * `border`: (N,) bool: the hit triangle is at an open border of the mesh.
    """

    depth: np.ndarray
    normal: np.ndarray
    reflectivity: np.ndarray | None
    border: np.ndarray

    def slant(self, rays: np.ndarray) -> np.ndarray:
        """Return (N,) the product of normal and (x/z, y/z, 1), which is negative."""
        return np.einsum('ni,ni->n', self.normal[:, :2], rays) + self.normal[:, 2]

    def picked(self, use: np.ndarray) -> 'Hits':
        """Return those that an (N,) bool array picks, without their reflectivity."""
        return Hits(self.depth[use], self.normal[use], None, self.border[use])


class Room:
    """
    Surfaces in front of a camera.

    `complete`: a ray without a hit means that there is no surface; a scan may have a hole there.
    `bounds` are (2, 3) least and greatest coordinates, metres.
    """

    complete = False
    bounds: np.ndarray

    def cast(self, pose: Pose, rays: np.ndarray) -> Hits:
        """Follow a camera's rays to the first surface, (N, 2) x/z and y/z in the optical frame."""
        found = self.hit(pose.t, rays @ pose.R[:, :2].T + pose.R[:, 2])
        hits = replace(found, normal=found.normal @ pose.R)
        hits.normal[hits.slant(rays) > 0] *= -1
        return hits

    def distances(self, places: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return (P, N) metres from (P, 3) places along (N, 3) unit directions; inf: no hit."""
        depths = [self.hit(place, directions).depth for place in places]
        return np.nan_to_num(np.stack(depths).astype(np.float32), nan=np.inf)

    def hit(self, place: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first surfaces in (N, 3) directions, room frame; depth in their lengths."""
        raise NotImplementedError


class MeshRoom(Room):
    """
    A triangle mesh.

    `triangles` are (F, 3, 3) float64 corners, metres; `reflectivity` (F, 3) float32 at each
    corner, 0 to 1, or None; `border` (F,) bool, triangles at an open border.
    """

    def __init__(
        self, triangles: np.ndarray, reflectivity: np.ndarray | None, border: np.ndarray
    ) -> None:
        """Build the tree of bounding boxes."""
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
