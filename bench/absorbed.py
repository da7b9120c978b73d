"""
What each kind of ground truth takes away of each effect: ``python -m bench.absorbed [--write]``.

The package's camera records a furnished room (six places where it stands still, two walks) and
five corners, once without an effect and once with each effect at its usual strength, with the same
noise. Ground truth is made of both, with ``flexx2 gap truth``: the room as a mesh and poses 5 cm
and 3 degrees off (scan), three planes of each corner measured with a tape and a set square (tape),
and the same planes without a distance (planes). What the effect changes of ``clean_depth`` is
projected on what it changes of the mean measured depth of blocks of 6 x 6 pixels: 1 means that
clean depth follows the effect and hides all of it, 0 that it does not. A dash: the effect changes
mean depth by less than 0.3 mm. ``--write`` writes ``config/absorbed.yaml``.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import ageing, registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth import make_plane_truth, make_truth, PlaneRequest, Request
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.validation.blind.meshes import write_mesh
from flexx2_sim_ros.validation.blind.scanned import off, ScannedCamera
import numpy as np
from scipy.spatial.transform import Rotation
import yaml

MODE, WIDTH, HEIGHT, FRAMES, UPTIME = 'Mode_9_30fps', 112, 86, 8, 60.0
LEAST = 3e-4  # metres, root mean square of an effect that a fraction is given for
_BLOCK = 6
# Turn, tilt and roll of the camera, degrees; distances of left wall, right wall and floor, metres.
CORNERS = (
    ((5, -22, 2), (0.9, 1.0, 0.6)),
    ((-6, -30, -4), (1.1, 1.2, 0.7)),
    ((12, -26, 5), (1.2, 1.5, 0.9)),
    ((0, -35, 0), (1.6, 1.4, 1.0)),
    ((-8, -24, 8), (0.7, 0.9, 0.5)),
)
Effects = Mapping[str, Mapping[str, float]]


class Room:
    """A furnished room as a mesh, seen from six places and on two walks."""

    kinds = ('scan',)

    def __init__(self, folder: Path) -> None:
        """Write the mesh, and draw rough poses."""
        size = {'frames': FRAMES, 'width': WIDTH, 'height': HEIGHT}
        still, moving = (
            ScannedCamera(1, {}, count, moving=walks, **size)
            for count, walks in ((6, False), (2, True))
        )
        self.mesh = folder / 'room.ply'
        write_mesh(still.solids, self.mesh, 0.1)
        rng = np.random.default_rng(1)
        self.views, self.poses = [], []
        for camera, count in ((still, 6), (moving, 2)):
            for i in range(count):
                self.views.append(camera.camera.scenes.clean(i))
                rough = Pose(*off(camera.poses(i)[0], 0.05, 3.0, rng))
                self.poses.append(tuple(rough.numbers()))

    def make(self, recordings: Path, kind: str, out: Path) -> None:
        """Write the campaign."""
        paths = tuple(sorted(recordings.iterdir()))
        make_truth(
            Request(recordings=paths, room=self.mesh, out=out, poses=tuple(self.poses), jobs=1)
        )


class Corners:
    """Corners of which planes are measured, or not."""

    kinds = ('tape', 'planes')

    def __init__(self, folder: Path) -> None:
        """Write what was measured: with errors of a tape, 3 mm."""
        self.views, self._folder = [], folder
        rng = np.random.default_rng(1)
        told: dict[str, Any] = {kind: {} for kind in self.kinds}
        for number, (turns, distances) in enumerate(CORNERS):
            clean, which = _corner(turns, np.array(distances))
            self.views.append((clean, np.full_like(clean, 0.6)))
            for kind in self.kinds:
                rows: dict[str, Any] = {}
                for k, distance in enumerate(distances):
                    v, u = (int(np.median(side)) for side in np.nonzero(which == k))
                    rows[f'plane{k}'] = {'box': [u - 3, v - 3, u + 3, v + 3]}
                    if kind == 'tape':
                        measured = distance + 0.003 * rng.standard_normal()
                        rows[f'plane{k}']['distance'] = f'{measured:.4f} +- 0.003'
                told[kind][f'{number}'] = rows
        angles = {f'plane{k}': '90 +- 0.3' for k in range(3)}
        planes = [
            {
                'name': f'plane{k}',
                'flat': 0,
                'angles': {name: angles[name] for name in list(angles)[k + 1 :]},
            }
            for k in range(3)
        ]
        for kind in self.kinds:
            content = {'schema': 1, 'planes': planes, 'recordings': told[kind]}
            (folder / f'{kind}.yaml').write_text(yaml.safe_dump(content))

    def make(self, recordings: Path, kind: str, out: Path) -> None:
        """Write the campaign."""
        planes = self._folder / f'{kind}.yaml'
        make_plane_truth(PlaneRequest(recordings=(recordings,), planes=planes, out=out))


def matrix() -> np.ndarray:
    """Return the camera matrix of the small image."""
    K = flexx2().intrinsics.matrix.copy()  # noqa: N806
    K[:2] *= 0.5
    return K


def _corner(turns: tuple[int, int, int], distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Clean depth, and the number of the plane that a pixel shows.
    half, (turn, tilt, roll) = np.sqrt(0.5), turns
    normals = np.array([[-half, 0, half], [half, 0, half], [0, 1, 0]])
    normals = normals @ Rotation.from_euler('yxz', [turn, -tilt, roll], degrees=True).as_matrix().T
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    along = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix()).T @ normals.T
    with np.errstate(divide='ignore'):
        depth = np.where(along > 0, distances / along, np.inf)
    return depth.min(axis=-1).astype(np.float32), depth.argmin(axis=-1)


def record(folder: Path, scenes: Room | Corners, effects: Effects) -> list[np.ndarray]:
    """Write a recording of each view, and return the mean measured depth, (H, W) or (T, H, W)."""
    folder.mkdir()
    table: dict[str, Any] = {name: dict(values) for name, values in effects.items()}
    for name in ageing(table):
        table[name]['uptime'] = UPTIME
    own = tuple(registry()[name].from_mapping(values) for name, values in table.items())
    means = []
    for i, (clean, reflectivity) in enumerate(scenes.views):
        stamp = 100 + np.arange(FRAMES) / 30
        camera = Camera(MODE, effects=own, seed=i, name='real')
        depth = camera.capture(clean, matrix(), stamp, reflectivity).depth
        content = {'depth': depth, 'K': matrix(), 'stamp': stamp, 'usecase': MODE}
        np.savez(folder / f'{i}.npz', **content, uptime=UPTIME + stamp - stamp[0])
        means.append(depth if clean.ndim == 3 else np.median(depth, axis=0))
    return means


def clean_depths(campaign: Path, count: int) -> list[np.ndarray | None]:
    """Return clean depth where it is known, by number of recording; None where refused."""
    out: list[np.ndarray | None] = []
    for i in range(count):
        path = campaign / f'{i}.npz'
        if not path.is_file():
            out.append(None)
            continue
        recording = open_recording(path).load()
        out.append(np.where(recording.extra['known'], recording.clean_depth, np.nan))
    return out


def fraction(
    changes: list[np.ndarray], before: list[np.ndarray | None], after: list[np.ndarray | None]
) -> float | None:
    """Return the part of changes of depth that clean depth follows; None where there are none."""
    own, taken, size, count = 0.0, 0.0, 0.0, 0
    for change, one, other in zip(changes, before, after, strict=True):
        if one is None or other is None:
            continue
        shift = np.broadcast_to(other - one, change.shape)
        good = np.isfinite(change + shift) & (np.abs(change) < 0.2) & (np.abs(shift) < 0.2)
        change, shift = (_blocks(np.where(good, part, np.nan)) for part in (change, shift))
        own += float(np.nansum(change * change))
        taken += float(np.nansum(change * shift))
        size += float(np.nansum(change * change))
        count += int(np.isfinite(change).sum())
    if not count or np.sqrt(size / count) < LEAST:
        return None
    return taken / own


def _blocks(images: np.ndarray) -> np.ndarray:
    height, width = (side - side % _BLOCK for side in images.shape[-2:])
    parts = images[..., :height, :width].reshape(
        *images.shape[:-2], height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK
    )
    many = np.isfinite(parts).sum(axis=(-3, -1)) > _BLOCK
    sums, counts = np.nansum(parts, axis=(-3, -1)), np.isfinite(parts).sum(axis=(-3, -1))
    return np.where(many, sums / np.maximum(counts, 1), np.nan)


def main(write: bool) -> None:
    """Print the table."""
    found: dict[str, dict[str, float]] = {'scan': {}, 'tape': {}, 'planes': {}}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        for scenes in (Room(folder), Corners(folder)):
            _measure(folder, scenes, found)
    print('| effect | scan | tape | planes |')
    print('|---|---|---|---|')
    for name in registry():
        cells = [found[kind].get(name) for kind in found]
        words = ' | '.join('-' if cell is None else f'{cell:.2f}' for cell in cells)
        print(f'| {name} | {words} |')
    if write:
        head = '# Fraction of each effect that ground truth hides, by kind: '
        body = yaml.safe_dump({'schema': 1, 'absorbed': found}, sort_keys=False)
        path = config_dir() / 'absorbed.yaml'
        path.write_text(f'{head}python -m bench.absorbed --write\n{body}')


def _measure(folder: Path, scenes: Room | Corners, found: dict[str, dict[str, float]]) -> None:
    name = type(scenes).__name__
    plain = record(folder / f'{name}-in', scenes, {})
    before = {}
    for kind in scenes.kinds:
        scenes.make(folder / f'{name}-in', kind, folder / f'{kind}-out')
        before[kind] = clean_depths(folder / f'{kind}-out', len(scenes.views))
    for effect in registry():
        means = record(folder / f'{name}-{effect}', scenes, {effect: {}})
        changes = [one - other for one, other in zip(means, plain, strict=True)]
        for kind in scenes.kinds:
            out = folder / f'{kind}-{effect}'
            try:
                scenes.make(folder / f'{name}-{effect}', kind, out)
            except InputError as error:
                print(f'{effect}, {kind}: {error}', flush=True)
                continue
            part = fraction(changes, before[kind], clean_depths(out, len(scenes.views)))
            if part is not None:
                found[kind][effect] = round(float(np.clip(part, 0, 1)), 2)
            print(f'{effect}, {kind}: {part}', flush=True)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description='Measure what ground truth takes away.')
    parser.add_argument('--write', action='store_true', help='write config/absorbed.yaml')
    main(parser.parse_args().write)
