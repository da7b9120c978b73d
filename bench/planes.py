"""
Five views of a simulated corner of 112 x 86 pixels, and what people measured of its planes.

``python -m bench.planes`` prints by how much each effect of usual strength bends these planes at
most, root mean square.
"""

from pathlib import Path
import tempfile

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.truth import make_truth, PlaneRequest
import numpy as np
from scipy.spatial.transform import Rotation
import yaml

MODE = 'Mode_9_30fps'
WIDTH, HEIGHT, FRAMES = 112, 86, 8
K = flexx2().intrinsics.matrix.copy()
K[:2] *= 0.5
V, U = np.mgrid[:HEIGHT, :WIDTH]
RAYS = np.stack([U, V, np.ones_like(U)], axis=-1) @ np.linalg.inv(K).T
# Where the camera stands and looks: turn, tilt and roll in degrees; distances of left wall, right
# wall and floor in metres.
VIEWS = (
    ((5, -22, 2), (0.9, 1.0, 0.6)),
    ((-6, -30, -4), (1.1, 1.2, 0.7)),
    ((12, -26, 5), (1.2, 1.5, 0.9)),
    ((0, -35, 0), (1.6, 1.4, 1.0)),
    ((-8, -24, 8), (0.7, 0.9, 0.5)),
)
NAMES = 'left', 'right', 'floor'
LASER, TAPE = 0.001, 0.003  # metres


def corner(turn, tilt, roll):
    """Return the (3, 3) normals of a room's corner that the camera looks into."""
    half = np.sqrt(0.5)
    normals = np.array([[-half, 0, half], [half, 0, half], [0, 1, 0]])
    turned = Rotation.from_euler('yxz', [turn, -tilt, roll], degrees=True).as_matrix()
    return np.asarray(normals @ turned.T)


def seen(normals, distances):
    """Return depth and which plane it is of, (H, W) each."""
    along = RAYS @ normals.T
    with np.errstate(divide='ignore'):
        depth = np.where(along > 0, np.array(distances) / along, np.inf)
    return depth.min(axis=-1).astype(np.float32), depth.argmin(axis=-1)


def record(folder, offset=0.0, views=VIEWS, reflectivity=0.6, others=(), step=1):
    """
    Write a recording of each view, with an offset and with other effects of usual strength.

    Of each `step` pixels, across and down, a camera has one.
    """
    folder.mkdir()
    matrix = K / [[step], [step], [1]]
    table = {'offset': {'bias': offset}} if offset else {}
    table |= {name: {} for name in others}
    effects = tuple(registry()[name].from_mapping(values) for name, values in table.items())
    for i, (turns, distances) in enumerate(views):
        clean, _ = seen(corner(*turns), distances)
        clean = np.ascontiguousarray(clean[::step, ::step])
        camera = Camera(MODE, effects=effects, seed=i)
        albedo = np.full_like(clean, reflectivity)
        stamp = np.arange(FRAMES) / 30
        depth = camera.capture(clean, matrix, stamp, albedo).depth
        content = {'depth': depth, 'K': matrix, 'stamp': stamp, 'usecase': MODE}
        np.savez(folder / f'corner{i}.npz', **content, reflectivity=albedo)
    return folder


def boxes(normals, distances):
    """Return a part of each plane, as a person would draw it."""
    _, which = seen(normals, distances)
    out = []
    for k in range(len(normals)):
        v, u = (round(float(np.median(side[which == k]))) for side in (V, U))
        out.append([u - 3, v - 3, u + 3, v + 3])
    return out


def describe(path, taped, square=True, flat=0.0, **changes):
    """
    Write what people measured of all views.

    * `taped`: standard deviation of the measured distances, metres, by which they are wrong; None:
      no distance was measured
    * `square`: whether angles were measured
    * `flat`: standard deviation of the surfaces, metres
    * `changes`: of the file's content
    """
    rng = np.random.default_rng(3)
    recordings = {}
    for i, (turns, distances) in enumerate(VIEWS):
        rows = {}
        for name, box, distance in zip(
            NAMES, boxes(corner(*turns), distances), distances, strict=True
        ):
            rows[name] = {'box': box}
            if taped is not None:
                told = distance + taped * rng.standard_normal()
                rows[name]['distance'] = f'{told:.4f} +- {taped}'
        recordings[f'corner{i}'] = rows
    planes = [{'name': name, 'flat': flat} for name in NAMES]
    if square:
        planes[0]['angles'] = {'right': '90 +- 0.2', 'floor': '90 +- 0.2'}
        planes[1]['angles'] = {'floor': '90 +- 0.2'}
    content = {'schema': 1, 'planes': planes, 'recordings': recordings, **changes}
    path.write_text(yaml.safe_dump(content))
    return path


def main():
    """Print by how much each effect bends the planes."""
    print('| effect | mm rms |\n|---|---|')
    for effect in registry():
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            record(folder / 'in', others=(effect,))
            planes = describe(folder / 'planes.yaml', taped=LASER)
            table = make_truth(
                PlaneRequest(recordings=(folder / 'in',), planes=planes, out=folder / 'out')
            )
        found = [one['bend_mm'] for row in table['recordings'] for one in row.get('planes', [])]
        print(f'| {effect} | {max(found, default=float("nan")):.1f} |', flush=True)


if __name__ == '__main__':
    main()
