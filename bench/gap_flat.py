"""
How much the fitted form of a named effect varies, where it is the cause and where a constant is.

Records the blind camera (development seeds, 8 recordings of 12 frames, 80 x 62 pixels, poses
wrong by 2 mm) with effects that are functions of amplitude, incidence, range or uptime; and with
an offset and random dropouts, which the diagnosis is not to consider. ``THRESHOLDS.varies`` lies
between what it prints for the two.

python -m bench.gap_flat --seeds 31,32,33,34
"""

import argparse

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.blind import BlindCamera, Case, SceneKey, SceneSet

_STRENGTHS = 0.5, 1.0
_CAUSES = (
    'amplitude_bias',
    'wiggling',
    'warm_up_drift',
    'grazing_dropout',
    'low_signal_dropout',
    'saturation',
)
_CONSTANTS = 'offset', 'random_dropout'


def main() -> None:
    """Print the variation of each fitted form."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--seeds', default='31,32,33,34', help='of scenes and cameras')
    seeds = [int(one) for one in parser.parse_args().seeds.split(',')]
    print('| cause | strength | named, and how much its form varies |\n|---|---|---|')
    for name in (*_CAUSES, *_CONSTANTS):
        for strength in _STRENGTHS:
            said = [_varies(name, strength, seed) for seed in seeds]
            print(f'| {name} | {strength} | {"; ".join(filter(None, said))} |', flush=True)


def _varies(cause: str, strength: float, seed: int) -> str:
    key = SceneKey('Mode_9_30fps', seed, 2.0, 80, 62, 8, 12)
    without = (cause,) if cause in _CONSTANTS else ()
    with scratch_folder() as folder:
        BlindCamera(Case(key, {cause: strength}, seed), SceneSet(key)).record(folder)
        table = diagnose(folder, without=without, seed=seed)
    rows = (table['calibration'] or {}).get('effects', [])
    return ', '.join(f'{row["name"]} {row["varies"]:.3f}' for row in rows)


if __name__ == '__main__':
    main()
