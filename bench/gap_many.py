"""
How much of what a camera with many effects does is named, promised and delivered.

Blind cameras with several effects of mixed strengths and internals of their own are diagnosed.
What an effect contributes is by how much the measured images change when the camera loses it, in
the distance of `study.benchmark.realised`; recall is weighted by that. What the diagnosis
delivers is measured in other scenes. Development seeds only.

python -m bench.gap_many --count 4 --seeds 1-5
"""

import argparse
import json
import math
from pathlib import Path
import time

from flexx2_sim_ros.atomic import scratch_folder, whole
from flexx2_sim_ros.gap import diagnose, measure
import numpy as np
from study.benchmark import DEVELOPMENT
from study.benchmark.design import drawn, MODES, Planned
from study.benchmark.many import contributions, order, recall
from study.benchmark.realised import realised_gap
from study.blind import BlindCamera, SceneSet
from study.blind.scene_set import DEGREES_PER_MM

_FIRST = 300_000  # of the seeds of these cameras, and of their scenes


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
    effects, inside = drawn(rng, count)
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
        kept.write_text(json.dumps(contributions(case, cache / 'scenes')))
    true = json.loads(kept.read_text())
    began = time.process_time()
    prior = (arguments.pose / 1000, arguments.pose * DEGREES_PER_MM) if arguments.stated else None
    table = diagnose(campaign, pose_prior=prior)
    seconds = time.process_time() - began
    named = [one['name'] for one in table['effects']]
    realised = None
    if named:
        realised = realised_gap(case, table, cache / 'scenes', measure)
    return {
        'count': count,
        'seed': seed,
        'true': true,
        'verdict': table['verdict'],
        'named': [[one['name'], one['confidence'], one['takes_off']] for one in table['effects']],
        'recall': recall(true, named),
        'wrong': [name for name in named if name not in true],
        'order': order(table['effects'], true),
        'disagree': table['disagree'] and table['disagree']['name'],
        'predicted': table['gap']['shrink'] if named else 0.0,
        'interval': table['gap']['interval'],
        'realised': realised,
        'seconds': round(seconds, 1),
    }


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
    orders = [row['order'] for row in rows if not math.isnan(row['order'])]
    inside = [
        row['interval'][0] <= min(value, 1.0) <= row['interval'][1]
        for row, value in zip(rows, shrink, strict=True)
        if row['interval']
    ]
    worse = sum(one is not None and one['after_mm'] > one['before_mm'] for one in gaps)
    return (
        f'{len(rows)} cameras: recall {np.mean([one["recall"] for one in rows]):.3f}, wrong names '
        f'{np.mean([len(one["wrong"]) for one in rows]):.2f}, realised mean {np.mean(shrink):.3f} '
        f'median {np.median(shrink):.3f}, |predicted - realised| {np.mean(np.abs(off)):.3f}, '
        f'intervals hold {sum(inside)} of {len(inside)}, '
        f'order {np.mean(orders or [np.nan]):.2f}, worse in mm {worse}, '
        f'{np.mean([one["seconds"] for one in rows]):.0f} s'
    )


def _numbers(text):
    for part in text.split(','):
        low, _, high = part.partition('-')
        yield from range(int(low), int(high or low) + 1)


if __name__ == '__main__':
    main()
