"""
Whether the first row of `where` names the covariate that the physics of an effect depends on.

Each campaign has one effect of the catalogue. Prints the first row, and whether its covariate is
among those of `PHYSICS`. With `--without`, the catalogue of the diagnosis lacks the effect, so
that the covariate has to follow from the recordings.

python -m bench.gap_where --seeds 22
"""

import argparse
from pathlib import Path
import tempfile

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.report.places import place

# Covariates on which the size of each effect depends, by its formula.
PHYSICS = {
    'ambient_light': ('amplitude', 'distance'),  # light that competes with the signal
    'amplitude_bias': ('amplitude',),
    'excess_noise': ('all',),
    'flying_pixels': ('edge',),
    'grazing_dropout': ('incidence',),
    'heavy_tails': ('all',),
    'intrinsics_error': ('image region', 'radius'),
    'lateral_noise': ('edge',),
    'low_signal_dropout': ('amplitude',),
    'motion_artefact': ('speed', 'edge'),
    'multipath': ('concavity', 'amplitude'),  # indirect light, relative to the direct light
    'offset': ('all',),
    'range_wrap': ('distance', 'amplitude'),  # beyond the range, or where noise is large
    'spatial_filter': ('all', 'edge'),
    'stray_light': ('amplitude',),
    'temporal_filter': ('all', 'speed'),
    'time_offset': ('speed', 'edge'),
    'warm_up_drift': ('uptime',),
    'wiggling': ('distance',),
}


def main() -> None:
    """Print one line for each campaign, and the total."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', default=','.join(PHYSICS))
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
            covariate = first['covariate'].removeprefix('fine_')
            good = any(covariate.startswith(one) for one in PHYSICS[name])
            right += good
            total += 1
            print(
                f'{seed:4d} {name:20s} {table["verdict"]:10s} {"right" if good else "WRONG"} '
                f'{place(first)}',
                flush=True,
            )
    print(f'{right} of {total} right')


if __name__ == '__main__':
    main()
