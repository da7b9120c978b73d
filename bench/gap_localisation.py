"""
How well diagnoses locate the effects of the blind camera: the benchmark's score of `where`.

Each effect of the catalogue is recorded by one camera with a development seed, in one set of
scenes, and diagnosed.

python -m bench.gap_localisation --strength 1 --width 112 --height 86
"""

import argparse
from dataclasses import replace
import math
from pathlib import Path
import tempfile

from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT, make_design
from flexx2_sim_ros.validation.benchmark.scoring import overlap
from flexx2_sim_ros.validation.benchmark.truth import Comparison
from flexx2_sim_ros.validation.blind import BlindCamera, CATALOGUE, SceneSet
import numpy as np


def main() -> None:
    """Print a line for each effect, and the mean."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', default=','.join(sorted(CATALOGUE)))
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--usecase', default='Mode_9_30fps')
    parser.add_argument('--width', type=int, default=112)
    parser.add_argument('--height', type=int, default=86)
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    scores = []
    with tempfile.TemporaryDirectory() as cache:
        for name in arguments.effects.split(','):
            planned = next(
                replace(
                    case,
                    scene_seed=DEVELOPMENT.seed(0),
                    width=arguments.width,
                    height=arguments.height,
                )
                for case in make_design(DEVELOPMENT, quick=False)
                if case.group == 'single'
                and case.usecase == arguments.usecase
                and case.effects == {name: arguments.strength}
            )
            camera = BlindCamera(planned.case, SceneSet(planned.case.scenes, Path(cache)))
            comparison = Comparison(camera)
            with tempfile.TemporaryDirectory() as folder:
                camera.record(Path(folder), comparison.watch)
                table = diagnose(folder, seed=planned.seed, jobs=arguments.jobs)
            pixels = comparison.affected()
            scores.append(overlap(table['where'], pixels))
            found = ', '.join(effect['name'] for effect in table['effects'])
            print(
                f'{name:20s} {table["verdict"]:10s} {found:30s} '
                f'affected {pixels["affected"].mean():4.0%}  IoU {scores[-1]:.2f}',
                flush=True,
            )
    known = [score for score in scores if not math.isnan(score)]
    print(f'mean IoU {np.mean(known) if known else math.nan:.2f} of {len(known)}')


if __name__ == '__main__':
    main()
