"""
How much of the loss of moving recordings a wrong latency takes off, and a true one.

Records the blind camera (development seeds, 8 recordings of 12 frames, 80 x 62 pixels, poses
wrong by 2 mm) without an effect, and with effects that could be taken for a latency, or are one.
``SEARCH.latency_gains`` lies between what it prints for the two. A filter over frames is told
apart by the lag that still scenes show.

python -m bench.gap_latency --seeds 31,32,33,34
"""

import argparse

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.data.clues import clues_of, latencies
from flexx2_sim_ros.gap.work import find
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.validation.blind import BlindCamera, Case, Internals, SceneKey, SceneSet
import numpy as np

_CASES: tuple[tuple[str, dict[str, float], Internals], ...] = (
    ('no effect', {}, Internals()),
    ('pose_error 2', {'pose_error': 2.0}, Internals()),
    ('motion_artefact 2', {'motion_artefact': 2.0}, Internals()),
    ('temporal_filter 1', {'temporal_filter': 1.0}, Internals()),
    ('time_offset, 10 ms', {'time_offset': 1.0}, Internals(latency_s=0.010)),
    ('time_offset, 25 ms', {'time_offset': 1.0}, Internals(latency_s=0.025)),
)


def main() -> None:
    """Print the best latency of each campaign, and the fraction of the loss that it takes off."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--seeds', default='31,32,33,34', help='of scenes and cameras')
    seeds = [int(one) for one in parser.parse_args().seeds.split(',')]
    print('| effect | latency, ms | loss taken off | lag, ms |\n|---|---|---|---|')
    for name, effects, inside in _CASES:
        found = [_best(seed, effects, inside) for seed in seeds]
        times, lags = (', '.join(f'{1e3 * one[i]:.0f}' for one in found) for i in (0, 2))
        gains = ', '.join(f'{gain:.3f}' for _, gain, _ in found)
        print(f'| {name} | {times} | {gains} | {lags} |', flush=True)


def _best(seed: int, effects: dict[str, float], inside: Internals) -> tuple[float, float, float]:
    # Seconds, the fraction, and the lag of a filter in seconds.
    key = SceneKey('Mode_9_30fps', seed, 2.0, 80, 62, 8, 12)
    with scratch_folder() as folder, workers(1, None) as mapped:
        BlindCamera(Case(key, effects, seed, internals=inside), SceneSet(key)).record(folder)
        clues = [clues_of(read(one, None)) for one in find(folder, None, mapped)[0]]
    losses = [one.late for one in clues if len(one.late) and np.isfinite(one.late).any()]
    mean = np.where(np.isfinite(losses).all(axis=0), np.mean(losses, axis=0), np.inf)
    best = int(np.argmin(mean))
    lag = float(np.nanmedian([one.lag for one in clues]))
    return float(latencies()[best]), 1.0 - float(mean[best]), lag


if __name__ == '__main__':
    main()
