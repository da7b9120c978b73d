"""
What each kind of ground truth takes away of each effect: ``python -m bench.absorbed [--write]``.

The package's camera records a furnished room (six places where it stands still, two walks) and
five corners, once without an effect and once with each effect at its usual strength, with the same
noise. Ground truth is made of both, with ``flexx2 gap truth``: the room as a mesh and poses 5 cm
and 3 degrees off (scan), the same of each recording alone, for the effects that only several
recordings tell from their poses (single), three planes of each corner measured with a tape and a
set square (tape), and the same planes without a distance (planes). What the effect changes of
``clean_depth`` is projected on what it changes of the mean measured depth of blocks of 6 x 6
pixels: 1 means that clean depth follows the effect and hides all of it, 0 that it does not. A
dash: the effect changes mean depth by less than 0.3 mm. ``--write`` writes
``config/absorbed.yaml``; ``--effects`` measures some effects, ``--only`` the room or the corners.
"""

import argparse
from pathlib import Path
import tempfile

from bench.planes import corner, describe, FRAMES, HEIGHT, K, MODE, seen, TAPE, VIEWS, WIDTH
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.effects import ageing, registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth import make_truth, PlaneRequest, RoomRequest
import numpy as np
from study.blind.meshes import write_mesh
from study.blind.scanned import off, ScannedCamera
import yaml

UPTIME = 60.0  # seconds
_SESSION = 3600.0  # seconds from the first recording of the room to the last
_SINGLE = 'intrinsics_error', 'warm_up_drift'
LEAST = 3e-4  # metres, root mean square of an effect that a fraction is given for
_BLOCK = 6


class FurnishedMesh:
    """A furnished room as a mesh, seen from six places and on two walks."""

    kinds = 'scan', 'single'

    def __init__(self, folder):
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
        self.matrix = still.camera.scenes.optics.intrinsics.matrix
        self.uptimes = np.geomspace(UPTIME, UPTIME + _SESSION, len(self.views))

    def make(self, recordings, kind, out):
        """Write the campaign."""
        paths, poses = tuple(sorted(recordings.iterdir())), tuple(self.poses)
        if kind == 'scan':
            make_truth(RoomRequest(recordings=paths, room=self.mesh, out=out, poses=poses))
            return
        for path, pose in zip(paths, poses, strict=True):
            make_truth(RoomRequest(recordings=(path,), room=self.mesh, out=out, poses=(pose,)))


class Corners:
    """Corners of which planes are measured, or not."""

    kinds = ('tape', 'planes')

    def __init__(self, folder):
        """Write what was measured, with the errors of a tape."""
        self.views, self._folder, self.matrix = [], folder, K
        for turns, distances in VIEWS:
            clean, _ = seen(corner(*turns), distances)
            self.views.append((clean, np.full_like(clean, 0.6)))
        self.uptimes = np.full(len(self.views), UPTIME)
        for kind, taped in zip(self.kinds, (TAPE, None), strict=True):
            describe(folder / f'{kind}.yaml', taped=taped)

    def make(self, recordings, kind, out):
        """Write the campaign."""
        planes = self._folder / f'{kind}.yaml'
        make_truth(PlaneRequest(recordings=(recordings,), planes=planes, out=out))


def record(folder, scenes, effects):
    """Write a recording of each view, and return the mean measured depth, (H, W) or (T, H, W)."""
    folder.mkdir()
    table = {name: dict(values) for name, values in effects.items()}
    means = []
    for i, (clean, reflectivity) in enumerate(scenes.views):
        for name in ageing(table):
            table[name]['uptime'] = float(scenes.uptimes[i])
        own = tuple(registry()[name].from_mapping(values) for name, values in table.items())
        stamp = 100 + np.arange(FRAMES) / 30
        camera = Camera(MODE, effects=own, seed=i, name='real')
        depth = camera.capture(clean, scenes.matrix, stamp, reflectivity).depth
        content = {'depth': depth, 'K': scenes.matrix, 'stamp': stamp, 'usecase': MODE}
        np.savez(folder / f'corner{i}.npz', **content, uptime=scenes.uptimes[i] + stamp - stamp[0])
        means.append(depth if clean.ndim == 3 else np.median(depth, axis=0))
    return means


def clean_depths(campaign, count):
    """Return clean depth where it is known, by number of recording; None where refused."""
    out = []
    for i in range(count):
        path = campaign / f'corner{i}.npz'
        if not path.is_file():
            out.append(None)
            continue
        recording = open_recording(path).load()
        out.append(np.where(recording.extra['known'], recording.clean_depth, np.nan))
    return out


def fraction(changes, before, after):
    """Return the part of changes of depth that clean depth follows; None where there are none."""
    own, taken, count = 0.0, 0.0, 0
    for change, one, other in zip(changes, before, after, strict=True):
        if one is None or other is None:
            continue
        shift = np.broadcast_to(other - one, change.shape)
        good = np.isfinite(change + shift) & (np.abs(change) < 0.2) & (np.abs(shift) < 0.2)
        change, shift = (_blocks(np.where(good, part, np.nan)) for part in (change, shift))
        own += float(np.nansum(change * change))
        taken += float(np.nansum(change * shift))
        count += int(np.isfinite(change).sum())
    if not count or np.sqrt(own / count) < LEAST:
        return None
    return taken / own


def _blocks(images):
    height, width = (side - side % _BLOCK for side in images.shape[-2:])
    parts = images[..., :height, :width].reshape(
        *images.shape[:-2], height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK
    )
    many = np.isfinite(parts).sum(axis=(-3, -1)) > _BLOCK
    sums, counts = np.nansum(parts, axis=(-3, -1)), np.isfinite(parts).sum(axis=(-3, -1))
    return np.where(many, sums / np.maximum(counts, 1), np.nan)


def main(only, effects, write):
    """Print the table."""
    names = effects.split(',') if effects else list(registry())
    found = {}
    kinds = {'room': FurnishedMesh, 'corners': Corners}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        for name, scenes in kinds.items():
            if only in ('', name):
                _measure(folder, scenes(folder), names, found)
    print(f'| effect | {" | ".join(found)} |')
    print(f'|---{"|---" * len(found)}|')
    for name in names:
        cells = [part.get(name) for part in found.values()]
        words = ' | '.join('-' if cell is None else f'{cell:.2f}' for cell in cells)
        print(f'| {name} | {words} |')
    if write:
        path = config_dir() / 'absorbed.yaml'
        before = read_config(path)['absorbed'] if path.is_file() else {}
        head = '# Fraction of each effect that ground truth hides, by kind: '
        for kind, parts in found.items():
            kept = {} if not effects else before.get(kind, {})
            merged = {name: part for name, part in kept.items() if name not in names} | parts
            before[kind] = {name: merged[name] for name in registry() if name in merged}
        body = yaml.safe_dump({'schema': 1, 'absorbed': before}, sort_keys=False)
        path.write_text(f'{head}python -m bench.absorbed --write\n{body}')


def _measure(folder, scenes, names, found):
    name = type(scenes).__name__
    plain = record(folder / f'{name}-in', scenes, {})
    before = {}
    for kind in scenes.kinds:
        found[kind] = {}
        scenes.make(folder / f'{name}-in', kind, folder / f'{kind}-out')
        before[kind] = clean_depths(folder / f'{kind}-out', len(scenes.views))
    for effect in names:
        means = record(folder / f'{name}-{effect}', scenes, {effect: {}})
        changes = [one - other for one, other in zip(means, plain, strict=True)]
        for kind in scenes.kinds:
            if kind == 'single' and effect not in _SINGLE:
                continue
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
    parser.add_argument('--effects', default='', help='names (default: all)')
    parser.add_argument('--only', choices=('', 'room', 'corners'), default='', help='scenes')
    main(**vars(parser.parse_args()))
