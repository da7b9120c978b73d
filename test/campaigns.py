"""Recordings of a diagnosis as tests change and read them, and the files of a diagnosis."""

import json

from flexx2_sim_ros.effects import parse_effects, save_effects
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.work import find
from flexx2_sim_ros.jobs import workers
import numpy as np


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
