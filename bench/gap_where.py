"""
Whether the first row of `where` names the covariate that the physics of an effect depends on.

Each campaign has one effect of the catalogue. Prints the first row, and whether its covariate is
among those of the benchmark's table. With `--without`, the catalogue of the diagnosis lacks the
effect, so that the covariate has to follow from the recordings.

python -m bench.gap_where --seeds 22
"""

import argparse
from pathlib import Path
import tempfile

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.report.places import difference, group
from flexx2_sim_ros.validation.benchmark.physics import DEPENDS_ON, is_physical


def main() -> None:
    """Print one line for each campaign, and the total."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', default=','.join(DEPENDS_ON))
    parser.add_argument('--seeds', default='22')
    parser.add_argument('--without', action='store_true', help='take the true effect out')
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    right = total = 0
    for seed in map(int, arguments.seeds.split(',')):
        for name in arguments.effects.split(','):
            with tempfile.TemporaryDirectory() as folder:
                write_campaign(
                    Path(folder),
                    seed=seed,
                    scale=0.5,
                    recordings=6,
                    frames=12,
                    moving=2,
                    effects={name: {}},
                )
                without = [name] if arguments.without else []
                table = diagnose(folder, jobs=arguments.jobs, without=without)
            if not table['where']:
                print(f'{seed:4d} {name:20s} {table["verdict"]}', flush=True)
                continue
            first = table['where'][0]
            good = is_physical(first['covariate'], [name])
            right += good
            total += 1
            print(
                f'{seed:4d} {name:20s} {table["verdict"]:10s} {"right" if good else "WRONG"} '
                f'{group(first)}: {difference(first)}',
                flush=True,
            )
    print(f'{right} of {total} right')


if __name__ == '__main__':
    main()
