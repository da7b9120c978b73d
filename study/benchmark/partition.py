"""
The scorer's partition of a campaign's pixels into cells of like pixels.

It is built from the rooms alone, with what only their maker knows: exact points and normals. The
pixels of each recording are divided into those near depth jumps and the others. Each part is
divided further by a k-d tree over the ranks of the true covariates. Such a tree halves cells
where their pixels differ most, until they are small. It has no class limits that somebody chose,
and it shares none with the diagnosis: a diagnosis gains nothing from grouping pixels in a
particular way.
"""

from dataclasses import dataclass
import math

import numpy as np
from scipy.spatial import cKDTree
from study.blind.scene_set import SceneSet
from study.blind.views import cast_rays, View

# Metres, degrees, fractions (of half the diagonal, the width, the height), 0 to 1, 1/m^2, 0 or 1,
# seconds, metres per second, number.
COVARIATES = (
    'distance',
    'incidence',
    'radius',
    'x',
    'y',
    'reflectivity',
    'amplitude',
    'edge',
    'uptime',
    'speed',
    'recording',
)
# Change it whenever the same scenes give another partition: old caches are then not used.
_VERSION = 1
# Pixels of the largest cell. In 20 frames, cells of 100 to 200 pixels have a standard error of
# about half of each tolerance in `truth.py` if the random numbers of the two cameras differ.
_LARGEST = 200
_SAMPLES = 20_000  # of a campaign; an intersection over union has a standard error below 0.005
_REACH = 16  # the image's width over this is how far away a concave corner is noticed


@dataclass(frozen=True)
class Partition:
    """
    The cells of a campaign, and a sample of its pixels.

    * `cells`: (V, H, W) int32, the cell of each pixel of each distinct view; -1 where nothing is
    * `samples`: (S, 11) float32, `COVARIATES` of pixels drawn uniformly from all frames
    * `sample_cells`: (S,) int32, the cell of each sample
    """

    cells: np.ndarray
    count: int
    samples: np.ndarray
    sample_cells: np.ndarray


@dataclass(frozen=True)
class _Surfaces:
    # True incidence (degrees), amplitude (1/m^2) and concavity of a view's pixels, (H, W).
    incidence: np.ndarray
    amplitude: np.ndarray
    concavity: np.ndarray


def partition_of(scenes: SceneSet) -> Partition:
    """
    Divide the pixels of a campaign into cells.

    `scenes`: the scenes as the camera truly sees them. The result is kept in their cache.
    """
    arrays = scenes.cached(f'partition-{_VERSION}', lambda: _make(scenes))
    return Partition(
        arrays['cells'], int(arrays['count']), arrays['samples'], arrays['sample_cells']
    )


def _make(scenes: SceneSet) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    key = scenes.key
    fraction = _SAMPLES / (key.recordings * key.frames * key.height * key.width)
    cells, samples, sample_cells, count = [], [], [], 0
    for recording in range(key.recordings):
        moving = scenes.scenes[recording].path.moving
        views = [
            scenes.true_view(recording, frame) for frame in range(key.frames if moving else 1)
        ]
        surfaces = [_surfaces(view) for view in views]
        own = _cells(views, surfaces)
        own[own >= 0] += count
        count = max(count, int(own.max(initial=-1)) + 1)
        cells.append(own)
        for frame in range(key.frames):
            i = frame if moving else 0
            drawn = (own[i] >= 0) & (rng.random(own[i].shape) < fraction)
            samples.append(_covariates(scenes, recording, frame, views[i], surfaces[i], drawn))
            sample_cells.append(own[i][drawn])
    return {
        'cells': np.concatenate(cells),
        'count': np.array(count),
        'samples': np.concatenate(samples),
        'sample_cells': np.concatenate(sample_cells),
    }


def _cells(views: list[View], surfaces: list[_Surfaces]) -> np.ndarray:
    # (V, H, W) int32 from 0 on: the cells of a recording.
    depth = np.stack([view.depth for view in views])
    edge = np.stack([view.near_edge for view in views])
    y, x = np.broadcast_arrays(*np.ogrid[: depth.shape[1], : depth.shape[2]])
    covariates = np.stack(
        [
            depth,
            np.stack([surface.incidence for surface in surfaces]),
            np.stack([surface.amplitude for surface in surfaces]),
            np.stack([surface.concavity for surface in surfaces]),
            np.broadcast_to(x, depth.shape),
            np.broadcast_to(y, depth.shape),
        ],
        axis=-1,
    )
    cells = np.full(depth.shape, -1, np.int32)
    count = 0
    for part in (edge, ~edge):
        part = part & np.isfinite(depth)
        if not part.any():
            continue
        leaves = _leaves(covariates[part], _LARGEST * len(views))
        cells[part] = leaves + count
        count += int(leaves.max()) + 1
    return cells


def _leaves(points: np.ndarray, largest: int) -> np.ndarray:
    # (N,) int32, the leaf of each of (N, C) points in a tree over their ranks.
    ranks = np.argsort(np.argsort(points, axis=0, kind='stable'), axis=0)
    leaves = np.empty(len(points), np.int32)
    count = 0
    nodes = [cKDTree(ranks, leafsize=largest, balanced_tree=True).tree]
    while nodes:
        node = nodes.pop()
        if node.split_dim == -1:  # a leaf
            leaves[node.indices] = count
            count += 1
        else:
            nodes += [node.lesser, node.greater]
    return leaves


def _surfaces(view: View) -> _Surfaces:
    rays = view.rays.reshape(*view.depth.shape, 2)
    normals = cast_rays(view.solids, view.R, view.origin, view.rays)[2] @ view.R
    normals = normals.reshape(*view.depth.shape, 3)
    directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    cosine = np.abs((normals * directions).sum(-1)) / np.linalg.norm(directions, axis=-1)
    with np.errstate(invalid='ignore', divide='ignore'):
        return _Surfaces(
            np.degrees(np.arccos(np.clip(cosine, 0, 1))),
            view.reflectivity * cosine / view.depth**2,
            concavity(directions * view.depth[..., None], normals),
        )


def concavity(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """
    Measure how far the surroundings of each pixel rise above its tangent plane.

    `points`, `normals`: (H, W, 3) metres, NaN for no return; and unit vectors. Returns (H, W) the
    largest sine of the elevation of eight surrounding points: 0 on planes and convex surfaces,
    towards 1 in narrow concave corners, rounded to 0.01.
    """
    height, width = points.shape[:2]
    step = max(width // _REACH, 1)
    padded = np.pad(points, ((step, step), (step, step), (0, 0)), constant_values=np.nan)
    highest = np.zeros((height, width))
    for down in (0, step, 2 * step):
        for across in (0, step, 2 * step):
            if down == across == step:
                continue
            between = padded[down : down + height, across : across + width] - points
            sine = (between * normals).sum(-1) / np.linalg.norm(between, axis=-1)
            highest = np.fmax(highest, sine)
    # Planes are 0, and not the rounding errors of their points.
    return np.round(highest, 2)


def _covariates(
    scenes: SceneSet, recording: int, frame: int, view: View, surface: _Surfaces, drawn: np.ndarray
) -> np.ndarray:
    # (N, 11) float32, `COVARIATES` of the drawn pixels of a frame.
    height, width = drawn.shape
    y, x = np.nonzero(drawn)
    across, down = x - (width - 1) / 2, y - (height - 1) / 2
    columns = (
        view.depth[drawn],
        surface.incidence[drawn],
        np.hypot(across, down) / math.hypot(width / 2, height / 2),
        (x + 0.5) / width,
        (y + 0.5) / height,
        view.reflectivity[drawn],
        surface.amplitude[drawn],
        view.near_edge[drawn],
        np.full(len(x), scenes.uptimes[recording] + scenes.times()[frame]),
        np.full(len(x), math.hypot(*scenes.scenes[recording].path.velocity)),
        np.full(len(x), recording),
    )
    return np.stack(columns, axis=1).astype(np.float32)
