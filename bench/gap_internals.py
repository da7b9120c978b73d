"""
How often the diagnosis names the cause although the camera differs inside from its profile.

One row a campaign of the blind camera: the effect, what differs inside, the verdict and the names.
`--plain` diagnoses the same effects in cameras that are as usual. Development seeds only.

python -m bench.gap_internals --seeds 700 --out rows.json
"""

import argparse
import json
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder, whole
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT
from flexx2_sim_ros.validation.blind import (
    BlindCamera,
    Case,
    CATALOGUE,
    Internals,
    SceneKey,
    SceneSet,
    VARIED,
)

_SAID = 'identified', 'partly'


def main() -> None:
    """Print a line for each campaign, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--seeds', default='700')
    parser.add_argument('--effects', default='', help='only these; all when left out')
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--plain', action='store_true', help='cameras that are as usual, and none')
    parser.add_argument('--usecase', default='Mode_9_30fps')
    parser.add_argument('--width', type=int, default=112, help='of the image; 224 is the camera')
    parser.add_argument('--frames', type=int, default=12)
    parser.add_argument('--cache', type=Path, help='folder for rendered scenes')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--out', type=Path, help='file for the rows as JSON')
    arguments = parser.parse_args()
    cases: list[tuple[str, dict[str, Any]]] = list(VARIED)
    if arguments.plain:
        cases = [('none', {}), *((name, {}) for name in CATALOGUE)]
    chosen = [one for one in arguments.effects.split(',') if one]
    rows = []
    for seed in map(int, arguments.seeds.split(',')):
        for name, inside in cases:
            if not chosen or name in chosen:
                rows.append(_row(arguments, seed, name, inside))
                print(_line(rows[-1]), flush=True)
                if arguments.out:
                    with whole(arguments.out) as part:
                        part.write_text(json.dumps(rows))
    count = max(len(rows), 1)
    right, wrong = (sum(row[key] for row in rows) for key in ('right', 'wrong'))
    seconds = sum(row['seconds'] for row in rows) / count
    print(f'{right} of {len(rows)} right, {wrong} wrong names; {seconds:.1f} s a diagnosis')


def _row(
    arguments: argparse.Namespace, seed: int, name: str, inside: dict[str, Any]
) -> dict[str, Any]:
    scene, camera = DEVELOPMENT.seed(seed), DEVELOPMENT.seed(1000 + seed)
    height = round(arguments.width * 172 / 224)
    key = SceneKey(arguments.usecase, scene, 2.0, arguments.width, height, 8, arguments.frames)
    effects = {} if name == 'none' else {name: arguments.strength}
    case = Case(key, effects, camera, internals=Internals(**inside))
    with scratch_folder() as folder:
        BlindCamera(case, SceneSet(key, arguments.cache)).record(folder)
        start = time.perf_counter()
        table = diagnose(folder, jobs=arguments.jobs)
    said = [row['name'] for row in table['effects']] if table['verdict'] in _SAID else []
    first = said[0] if said else table['verdict']
    return {
        'seed': seed,
        'effect': name,
        'inside': inside,
        'verdict': table['verdict'],
        'named': table['effects'],
        'alternatives': [row['name'] for row in table['alternatives']],
        'right': first == name,
        'wrong': bool(said) and first != name,
        'seconds': round(time.perf_counter() - start, 1),
    }


def _line(row: dict[str, Any]) -> str:
    inside = ', '.join(f'{key} {value}' for key, value in row['inside'].items()) or 'as usual'
    good = 'right' if row['right'] else 'WRONG' if row['wrong'] else 'open'
    named = ', '.join(one['name'] for one in row['named'])
    return (
        f'{row["seed"]:4d} {row["effect"]:18s} {inside:36s} {good:5s} {row["verdict"]:12s} '
        f'{named} (or {", ".join(row["alternatives"])}) {row["seconds"]} s'
    )


if __name__ == '__main__':
    main()
