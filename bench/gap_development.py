"""
How often the diagnosis is right about the effects of the simulator.

The effects are those of the catalogue and the ones of `bench.gap_novel`. Only the errors of pose,
reflectivity and sigma are outside the catalogue. Thresholds were chosen on seeds below 100.

python -m bench.gap_development --strength 1 --seeds 101 --scale 0.5
"""

import argparse
from pathlib import Path
import tempfile
import time

from bench.gap_campaigns import write_campaign
from bench.gap_novel import NOVEL
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap import diagnose


def main() -> None:
    """Print a line for each campaign, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', default='none,novel,all')
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--seeds', default='101')
    parser.add_argument('--scale', type=float, default=0.5, help='of 224 x 172')
    parser.add_argument('--usecase', default='Mode_9_30fps')
    parser.add_argument('--without', action='store_true', help='take the true effect out')
    parser.add_argument('--jobs', type=int, default=2)
    arguments = parser.parse_args()
    names: list[str] = []
    for name in arguments.effects.split(','):
        names += {'all': list(registry()), 'novel': [f'novel:{n}' for n in NOVEL]}.get(
            name, [name]
        )
    right = total = 0
    for seed in map(int, arguments.seeds.split(',')):
        for name in names:
            own = name in registry()
            with tempfile.TemporaryDirectory() as folder:
                write_campaign(
                    Path(folder),
                    seed=seed,
                    scale=arguments.scale,
                    usecase=arguments.usecase,
                    effects={name: {'strength': arguments.strength}} if own else None,
                    novel=NOVEL[name.removeprefix('novel:')] if name.startswith('novel') else None,
                )
                start = time.perf_counter()
                table = diagnose(
                    folder,
                    jobs=arguments.jobs,
                    without=[name] if own and arguments.without else [],
                )
            found = [row['name'] for row in table['effects']]
            ties = [other['name'] for other in table['alternatives']]
            if own and not arguments.without:
                good = name in found
            elif name == 'none':
                good = table['verdict'] == 'none'
            else:
                good = table['verdict'] in ('unknown', 'partly')
            right += good
            total += 1
            print(
                f'{seed:4d} {name:22s} {"right" if good else "WRONG":5s} '
                f'{table["verdict"]:10s} {",".join(found):32s} or {",".join(ties)[:40]:40s} '
                f'shrink {table["gap"]["shrink"]:.2f} '
                f'{time.perf_counter() - start:5.1f} s',
                flush=True,
            )
    print(f'{right} of {total} right')


if __name__ == '__main__':
    main()
