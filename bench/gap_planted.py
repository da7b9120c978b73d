"""
Whether the predicted reduction happens where nothing but the effect is unknown.

The package's own camera records rooms with one effect of typical strength. Poses, reflectivity
and noise are known exactly. The campaign is diagnosed, and other rooms are simulated with the
effects that were found. What goes away there is measured by the benchmark's distance
(`validation.benchmark.realised`), or, where the gap is below the tolerance, by the diagnosis's
own measure. An effect that is not named alone has no row of figures. Development seeds only.

python -m bench.gap_planted --seed 131
python -m bench.gap_planted --effects low_signal_dropout,wiggling
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap import diagnose, measure
from flexx2_sim_ros.validation.benchmark.realised import distances
import numpy as np

_EXACT: dict[str, Any] = {'pose': (0.0, 0.0), 'reflectivity': 0.0, 'sigma': 0.0}
_CLOSE = 0.03


def main() -> None:
    """Print a row for each effect, and how many predictions hold."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    names = [name for name, kind in registry().items() if kind.role != 'pose']
    parser.add_argument('--effects', default=','.join(names))
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--seed', type=int, default=131)
    parser.add_argument('--recordings', type=int, default=6)
    parser.add_argument('--frames', type=int, default=12)
    arguments = parser.parse_args()
    print('| effect | verdict | named | measured by | predicted | realised |')
    print('|---|---|---|---|---:|---:|')
    errors = []
    for name in arguments.effects.split(','):
        table, realised = _planted(name, arguments)
        named = ', '.join(row['name'] for row in table['effects'])
        gap = table['gap']
        cells = [f'`{name}`', table['verdict'], named, gap['measured_by']]
        if named == name and realised is not None:
            cells += [f'{gap["shrink"]:.2f}', f'{realised:.2f}']
            errors.append(abs(gap['shrink'] - realised))
        print(f'| {" | ".join(cells)} |', flush=True)
    if errors:
        print(
            f'{sum(one <= _CLOSE for one in errors)} of {len(errors)} at most {_CLOSE:g}; '
            f'mean {np.mean(errors):.3f}, largest {max(errors):.2f}'
        )


def _planted(name: str, arguments: argparse.Namespace) -> tuple[dict[str, Any], float | None]:
    # The diagnosis, and what goes away in other rooms.
    size = {'recordings': arguments.recordings, 'frames': arguments.frames, 'scale': 0.5}
    effects = {name: {'strength': arguments.strength}}
    with scratch_folder() as folder:
        for part, seed in (('campaign', arguments.seed), ('fresh', arguments.seed + 1)):
            write_campaign(folder / part, seed=seed, effects=effects, moving=2, **size, **_EXACT)
        table = diagnose(folder / 'campaign')
        found = {row['name']: row['parameters'] for row in table['effects']}
        return table, _realised(folder / 'fresh', found, table['gap']['measured_by'])


def _realised(folder: Path, found: Mapping[str, Any], by: str) -> float | None:
    if not found:
        return None
    if by == 'loss':
        own = measure(folder, dict(found))['shrink']
        return None if own is None else float(own)
    null, before, after = distances(folder, dict(found), flexx2())[:, 0]
    return float((before - after) / (before - null))


if __name__ == '__main__':
    main()
