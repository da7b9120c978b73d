"""Rooms that rays can be cast into: triangle meshes and MuJoCo models."""

from dataclasses import dataclass
from typing import Protocol

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from flexx2_sim_ros.rendering.culling import exact_for_rays
from flexx2_sim_ros.rendering.materials import reflectivity_table
from flexx2_sim_ros.rendering.model_cameras import VISIBLE_GROUPS
from flexx2_sim_ros.truth.poses import Pose
import mujoco
import numpy as np


@dataclass(frozen=True)
class Hits:
    """
    The first surfaces that rays hit.

    Attributes
    ----------
    depth : numpy.ndarray
        (N,) float64 metres along the optical axis, NaN without a hit.
    normal : numpy.ndarray
        (N, 3) float64 unit normals in the optical frame, towards the camera.
    reflectivity : numpy.ndarray or None
        (N,) float32, 0 to 1; None if the room has no colours.
    border : numpy.ndarray
        (N,) bool: the hit triangle is at an open border of the mesh.

    """

    depth: np.ndarray
    normal: np.ndarray
    reflectivity: np.ndarray | None
    border: np.ndarray

    def slant(self, rays: np.ndarray) -> np.ndarray:
        """Return (N,) the product of normal and (x/z, y/z, 1), which is negative."""
        return np.einsum('ni,ni->n', self.normal[:, :2], rays) + self.normal[:, 2]


class Room(Protocol):
    """
    A room in front of a camera.

    Attributes
    ----------
    complete : bool
        Whether a ray without a hit means that there is no surface. A scan may have a hole there.
    bounds : numpy.ndarray
        (2, 3) least and greatest coordinates, metres.

    """

    complete: bool
    bounds: np.ndarray

    def cast(self, pose: Pose, rays: np.ndarray) -> Hits:
        """
        Follow a camera's rays to the first surface.

        Parameters
        ----------
        pose : Pose
            The camera's.
        rays : numpy.ndarray
            (N, 2) x/z and y/z in the optical frame.

        Returns
        -------
        Hits

        """

    def distances(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return (N,) float32 metres along (N, 3) unit directions, room frame; inf: no hit."""


class MeshRoom:
    """
    A triangle mesh.

    Parameters
    ----------
    triangles : numpy.ndarray
        (F, 3, 3) float64 corners, metres.
    reflectivity : numpy.ndarray or None
        (F, 3) float32 at each corner, 0 to 1.
    border : numpy.ndarray
        (F,) bool, triangles at an open border.

    Attributes
    ----------
    triangles : int
        Number of triangles.

    """

    complete = False

    def __init__(
        self, triangles: np.ndarray, reflectivity: np.ndarray | None, border: np.ndarray
    ) -> None:
        """Build the tree of bounding boxes."""
        self.triangles = len(triangles)
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

    def cast(self, pose: Pose, rays: np.ndarray) -> Hits:
        """Follow a camera's rays to the first surface; see `Room.cast`."""
        directions = (rays @ pose.R[:, :2].T + pose.R[:, 2]).astype(np.float32)
        found = self._run(np.broadcast_to(pose.t, directions.shape), directions)
        index = found['primID']
        depth = np.where(index < 0, np.nan, found['tfar'].astype(np.float64))
        normal = self._normal[index] @ pose.R
        hits = Hits(depth, normal, None, self._border[index])
        normal[hits.slant(rays) > 0] *= -1
        if self._reflectivity is None:
            return hits
        u, v = found['u'], found['v']
        corners = self._reflectivity[index]
        mixed = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        return Hits(depth, normal, mixed, hits.border)

    def distances(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return distances along rays; see `Room.distances`."""
        found = self._run(origins, directions.astype(np.float32))
        return np.where(found['primID'] < 0, np.float32(np.inf), found['tfar'])

    def _run(self, origins: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
        starts = (origins - self._centre).astype(np.float32)
        return self._scene.run(starts, directions, output=True)


def visible_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return (G,) bool, the geoms that a camera sees."""
    return np.asarray(VISIBLE_GROUPS[np.clip(model.geom_group, 0, 5)] > 0)


class MujocoRoom:
    """
    A MuJoCo model at rest, its visible geoms (groups 0 to 2).

    Parameters
    ----------
    model : mujoco.MjModel
        Any model.

    """

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

    def cast(self, pose: Pose, rays: np.ndarray) -> Hits:
        """Follow a camera's rays to the first surface; see `Room.cast`."""
        length = np.sqrt(1 + (rays**2).sum(axis=1))
        directions = (rays @ pose.R[:, :2].T + pose.R[:, 2]) / length[:, None]
        distance, geom, normal = self._run(pose.t, directions)
        depth = np.where(geom < 0, np.nan, distance / length)
        normal = normal @ pose.R
        hits = Hits(depth, normal, self._reflectivity[geom], np.zeros(len(rays), bool))
        normal[hits.slant(rays) > 0] *= -1
        return hits

    def distances(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return distances along rays; see `Room.distances`."""
        out = np.empty(len(directions), np.float32)
        # MuJoCo casts rays from one point at a time.
        places, index = np.unique(origins, axis=0, return_inverse=True)
        for number, place in enumerate(places):
            chosen = index == number
            distance, geom, _ = self._run(place, directions[chosen])
            out[chosen] = np.where(geom < 0, np.inf, distance)
        return out

    def _run(
        self, origin: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(directions)
        distance, geom = np.empty(count), np.empty(count, np.int32)
        normal = np.zeros((count, 3))
        mujoco.mj_multiRay(
            m=self._model,
            d=self._data,
            pnt=np.ascontiguousarray(origin, np.float64),
            vec=np.ascontiguousarray(directions, np.float64).ravel(),
            geomgroup=VISIBLE_GROUPS,
            flg_static=1,
            bodyexclude=-1,
            geomid=geom,
            dist=distance,
            normal=normal.ravel(),
            nray=count,
            cutoff=mujoco.mjMAXVAL,
        )
        return distance, geom, normal
