"""Recordings of a diagnosis as tests change and read them, and the files of a diagnosis."""

import json

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import parse_effects, registry, save_effects
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.features.work import find
from flexx2_sim_ros.jobs import workers
import numpy as np

# Rooms at half of the resolution, and few of them: what a test can afford.
SMALL = {'scale': 0.5, 'recordings': 4, 'frames': 8, 'moving': 1}
# Effects that are taken for each other. A diagnosis of these alone takes half of the time.
ALIKE = 'offset', 'wiggling', 'warm_up_drift', 'depth_scale', 'amplitude_bias', 'multipath'
ALIKE += 'stray_light', 'intrinsics_error', 'pose_error'


def all_but(*kept):
    """Return the names of all other effects, as a diagnosis leaves them out."""
    return [name for name in registry() if name not in kept]


def among(*kept):
    """Return the arguments of a diagnosis that knows these effects alone, in their usual forms."""
    return {'without': all_but(*kept), 'forms': 'catalogue'}


def leaving(*kept):
    """Return the options that leave out all other effects."""
    return [word for name in all_but(*kept) for word in ('--without', name)]


# A short plan, and what makes documented commands short, for a camera with a temporal
# filter. Two processes would take longer to start than they save.
TWO_WALLS = """\
schema: 1
title: Two walls
usecase: Mode_9_30fps
simulation: {scale: 0.25, frames: 6}
recordings:
  - {name: near, title: Near, set_up: A wall., seconds: 5, for: [offset], walls: [[1.0, 0, 0.8]]}
  - {name: far, title: Far, set_up: A wall., seconds: 5, for: [offset], walls: [[2.0, 40, 0.8]]}
"""
_SHORTER = {
    'diagnose': leaving('temporal_filter', 'excess_noise', 'pose_error'),
    'next': ['--plan', 'plan.yaml'],
    'cost': ['--consumer', 'height_grid'],
}


def shorter(words):
    """Return a documented command of `flexx2`, shortened; ``plan.yaml`` has to be `TWO_WALLS`."""
    if words[0] != 'gap' or words[1] == 'plan':
        return words
    return [*words, '--jobs', '1', *_SHORTER.get(words[1], [])]


def run_diagnose(campaign, out, *options):
    """Run ``flexx2 gap diagnose`` in this process; return what is in ``diagnosis.json``."""
    command = ['gap', 'diagnose', str(campaign), '--out', str(out), '--jobs', '1']
    assert main([*command, *options]) == 0
    return json.loads((out / 'diagnosis.json').read_text())


def change(path, **changes):
    """Rewrite a recording with other arrays: a value, a function of them all, None for none."""
    with np.load(path) as archive:
        content = dict(archive)
    changes = {k: v(content) if callable(v) else v for k, v in changes.items()}
    np.savez(path, **{k: v for k, v in (content | changes).items() if v is not None})


def save(path, depth, clean, matrix, **more):
    """Write a recording at 30 Hz, stamps from 0; `more` is other arrays, or another mode."""
    usual = {'stamp': np.arange(len(depth)) / 30, 'usecase': 'Mode_9_30fps'}
    np.savez(path, depth=depth, clean_depth=clean, K=matrix, **usual | more)


MODE, SHAPE = 'Mode_9_30fps', (86, 112)
K = flexx2().intrinsics.resized(*SHAPE[::-1]).matrix


def write_walls(folder, distances, same=False, frames=10, **effects):
    """Write recordings of walls that face a camera; with the very same noise, or each its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, distance in enumerate(distances):
        clean = np.full(SHAPE, distance, np.float32)
        device = Camera(MODE, seed=7 if same else i, effects=effects)
        depth = device.capture(clean, K, np.arange(frames) / 30).depth
        save(folder / f'wall{i}.npz', depth, clean, K)
    return folder


def find_all(folder):
    """Return the recordings of a campaign."""
    with workers(1, None) as mapped:
        return find(folder, None, mapped)[0]


def read_all(folder):
    """Return the contents of a campaign's recordings, in the order of their names."""
    return [read(one, None) for one in find_all(folder)]


def write_diagnosis(folder, named, settings=None, **table):
    """Write the files of a diagnosis that has named these effects; `table` is the rest."""
    folder.mkdir()
    save_effects(folder / 'effects.yaml', parse_effects(named))
    usual = {'schema': 2, 'verdict': 'identified', 'effects': [], 'recordings': []}
    table = {**usual, 'settings': {'known': {}, **(settings or {})}, **table}
    (folder / 'diagnosis.json').write_text(json.dumps(table))
    return folder
