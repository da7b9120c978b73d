"""
How much of what a camera with many effects does is named, promised and delivered.

Blind cameras with several effects of mixed strengths and internals of their own are diagnosed.
What an effect contributes is by how much the measured images change when the camera loses it, in
the distance of `validation.benchmark.realised`; recall is weighted by that. What the diagnosis
delivers is measured in other scenes. Development seeds only.

python -m bench.gap_many --count 4 --seeds 1-5
"""

import argparse
from dataclasses import replace
import json
import math
from pathlib import Path
import time

from flexx2_sim_ros.atomic import scratch_folder, whole
from flexx2_sim_ros.gap import diagnose, measure
from flexx2_sim_ros.recording import load_recording
import numpy as np
from scipy.stats import spearmanr
from study.benchmark import DEVELOPMENT
from study.benchmark.design import MODES, Planned
from study.benchmark.realised import apart_of, FRESH, realised_gap
from study.blind import BlindCamera, CATALOGUE, SceneSet
from study.blind.scene_set import DEGREES_PER_MM

_FIRST = 300_000  # of the seeds of these cameras, and of their scenes
_STRENGTHS = 0.25, 2.0  # log-uniform
_NEVER = ('pose_error',)  # no effect of a camera
_SHOWN = 3  # frames of each recording that say what an effect contributes
# What differs inside: each field of `Internals` with probability 0.5, between two values or one of
# several.
_INSIDE = {
    'mhz': (25.0, 105.0),
    'wave_m': (0.25, 2.0),
    'footprint': ('round', 'gauss'),
    'footprint_px': (1.2, 3.0),
    'scatter': ('gauss', 'even'),
    'scatter_px': (3.0, 12.0),
    'window': ('box', 'gauss'),
    'window_px': (3, 5, 7, 9),
    'memory': ('second', 'mean'),
    'light_scale': (0.3, 4.0),
    'knee': (0.03, 1.0),
    'latency_s': (0.02, 0.2),
    'lost': (0.03, 0.3),
}


def main():
    """Print a line for each camera, and the means."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--count', default='4', help='effects of each camera, as 1,4,8')
    parser.add_argument('--seeds', default='1-4')
    parser.add_argument('--width', type=int, default=112, help='of the image; 224 is the camera')
    parser.add_argument('--frames', type=int, default=12)
    parser.add_argument('--recordings', type=int, default=8)
    parser.add_argument('--pose', type=float, default=2.0, help='error of the poses, mm')
    parser.add_argument('--stated', action='store_true', help='state this error to the diagnosis')
    parser.add_argument('--cache', type=Path, help='folder that keeps recordings and scenes')
    parser.add_argument('--out', type=Path, help='file for the rows as JSON')
    arguments = parser.parse_args()
    rows = []
    for count in map(int, arguments.count.split(',')):
        for seed in _numbers(arguments.seeds):
            with scratch_folder() as folder:
                rows.append(_row(arguments, count, seed, arguments.cache or folder))
            print(_line(rows[-1]), flush=True)
            if arguments.out:
                with whole(arguments.out) as part:
                    part.write_text(json.dumps(rows))
    print(_summary(rows))


def plan(arguments, count, seed):
    """Draw a camera with so many effects."""
    index = _FIRST + 100 * count + seed
    rng = np.random.default_rng([DEVELOPMENT.seed(index), 9])
    names = sorted(set(CATALOGUE) - set(_NEVER))
    low, high = map(math.log, _STRENGTHS)
    effects = {
        str(name): round(float(np.exp(rng.uniform(low, high))), 3)
        for name in sorted(rng.choice(names, count, replace=False))
    }
    inside = {}
    for field, values in _INSIDE.items():
        if rng.random() < 0.5:
            continue
        if len(values) == 2 and all(isinstance(one, float) for one in values):
            low, high = map(math.log, values)
            inside[field] = round(float(np.exp(rng.uniform(low, high))), 4)
        else:
            inside[field] = values[int(rng.integers(len(values)))]
    return Planned(
        'many',
        MODES[seed % 2],
        effects,
        DEVELOPMENT.seed(index),
        DEVELOPMENT.seed(_FIRST + 10_000 + seed),
        arguments.pose,
        (),
        arguments.width,
        round(arguments.width * 172 / 224),
        arguments.recordings,
        arguments.frames,
        internals=inside,
    )


def _row(arguments, count, seed, cache):
    case = plan(arguments, count, seed)
    size = f'{case.width}_{case.recordings}_{case.frames}_{case.pose_mm:g}mm'
    folder = cache / f'many_{count}_{seed}_{size}'
    campaign = folder / 'campaign'
    if not campaign.exists():
        part = folder / 'part'
        part.mkdir(parents=True, exist_ok=True)
        BlindCamera(case.case, SceneSet(case.case.scenes, cache / 'scenes')).record(part)
        part.rename(campaign)
    kept = folder / 'contributions.json'
    if not kept.exists():
        kept.write_text(json.dumps(_contributions(case, cache / 'scenes')))
    true = json.loads(kept.read_text())
    began = time.process_time()
    prior = (arguments.pose / 1000, arguments.pose * DEGREES_PER_MM) if arguments.stated else None
    table = diagnose(campaign, pose_prior=prior)
    seconds = time.process_time() - began
    named = [one['name'] for one in table['effects']]
    realised = None
    if named:
        realised = realised_gap(case, table, cache / 'scenes', measure)
    total = sum(true.values())
    return {
        'count': count,
        'seed': seed,
        'true': true,
        'verdict': table['verdict'],
        'named': [[one['name'], one['confidence'], one['takes_off']] for one in table['effects']],
        'recall': sum(value for name, value in true.items() if name in named) / total,
        'wrong': [name for name in named if name not in true],
        'order': _order(table['effects'], true),
        'disagree': table['disagree'] and table['disagree']['name'],
        'predicted': table['gap']['shrink'] if named else 0.0,
        'interval': table['gap']['interval'],
        'realised': realised,
        'seconds': round(seconds, 1),
    }


def _order(effects, true):
    # Rank correlation of what named effects take off with what they contribute.
    rows = [one for one in effects if one['name'] in true and one['takes_off']]
    if len(rows) < 3:
        return None
    taken = [one['takes_off']['distance']['mean'] for one in rows]
    return float(spearmanr(taken, [true[one['name']] for one in rows]).statistic)


def _contributions(case, cache):
    # By how much the images of fresh scenes change when the camera loses each effect.
    key = replace(case.case.scenes, seed=case.scene_seed + FRESH, pose_mm=0.0, frames=_SHOWN)
    scenes = SceneSet(key, cache)

    def recorded(folder, lost):
        folder.mkdir()
        camera = BlindCamera(replace(case.case, scenes=key), scenes)
        camera.effects = tuple(one for one in camera.effects if one.name != lost)
        camera.record(folder)
        return sorted(folder.iterdir())

    out = {}
    with scratch_folder() as folder:
        all_ = recorded(folder / 'all', '')
        for name in case.effects:
            pairs = zip(all_, recorded(folder / name, name), strict=True)
            apart = [apart_of(*map(load_recording, pair)) for pair in pairs]
            out[name] = round(float(np.mean([one for one, _ in apart])), 4)
    return out


def _line(row):
    true = ', '.join(
        f'{name} {value:.1f}' for name, value in sorted(row['true'].items(), key=lambda x: -x[1])
    )
    named = ', '.join(name for name, *_ in row['named'])
    gap = row['realised'] or dict.fromkeys(('shrink', 'before_mm', 'after_mm'), float('nan'))
    return (
        f'{row["count"]:2d}/{row["seed"]:<3d} {row["verdict"]:10s} recall {row["recall"]:.2f} '
        f'predicted {row["predicted"]:.2f} realised {gap["shrink"] or 0:.2f} '
        f'({gap["before_mm"]:.1f} to {gap["after_mm"]:.1f} mm) {row["seconds"]:.0f} s\n'
        f'      true:  {true}\n      named: {named}; wrong: {", ".join(row["wrong"]) or "none"}'
        + f'; recordings disagree: {row["disagree"]}'
        * bool(row['disagree'])
    )


def _summary(rows):
    gaps = [one['realised'] for one in rows]
    shrink = [0.0 if one is None else one['shrink'] or 0.0 for one in gaps]
    off = [row['predicted'] - value for row, value in zip(rows, shrink, strict=True)]
    orders = [row['order'] for row in rows if row['order'] is not None]
    worse = sum(one is not None and one['after_mm'] > one['before_mm'] for one in gaps)
    return (
        f'{len(rows)} cameras: recall {np.mean([one["recall"] for one in rows]):.3f}, wrong names '
        f'{np.mean([len(one["wrong"]) for one in rows]):.2f}, realised mean {np.mean(shrink):.3f} '
        f'median {np.median(shrink):.3f}, |predicted - realised| {np.mean(np.abs(off)):.3f}, '
        f'order {np.mean(orders or [np.nan]):.2f}, worse in mm {worse}, '
        f'{np.mean([one["seconds"] for one in rows]):.0f} s'
    )


def _numbers(text):
    for part in text.split(','):
        low, _, high = part.partition('-')
        yield from range(int(low), int(high or low) + 1)


if __name__ == '__main__':
    main()
