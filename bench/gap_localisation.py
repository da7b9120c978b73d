"""
How well diagnoses locate the effects of the blind camera: the benchmark's scores of `where`.

Each effect of the catalogue is recorded by one camera with a development seed, in one set of
scenes, and diagnosed; the effect `none` is a camera without any. With `--poses`, the poses are
wrong by so many mm, and by 0.0625 degrees for each.

python -m bench.gap_localisation --strength 1 --width 112 --height 86
python -m bench.gap_localisation --strength 0.5 --effects none,flying_pixels --poses 0,2,5
"""

import argparse
from dataclasses import replace
import itertools
import math
from pathlib import Path
import tempfile

from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.report.places import difference, group
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT, make_design
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.overlap import overlap
from flexx2_sim_ros.validation.benchmark.physics import DEPENDS_ON, is_physical
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
    parser.add_argument('--poses', default='2', help='standard deviations of pose errors, mm')
    parser.add_argument('--scenes', default='0', help='sets of scenes, by index')
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    scores, firsts = [], []
    with tempfile.TemporaryDirectory() as cache:
        for name, pose, scenes in itertools.product(
            arguments.effects.split(','), arguments.poses.split(','), arguments.scenes.split(',')
        ):
            planned = replace(
                _usual(name, arguments.strength, arguments.usecase),
                scene_seed=DEVELOPMENT.seed(int(scenes)),
                pose_mm=float(pose),
                width=arguments.width,
                height=arguments.height,
            )
            camera = BlindCamera(planned.case, SceneSet(planned.case.scenes, Path(cache)))
            comparison = Comparison(camera)
            with tempfile.TemporaryDirectory() as folder:
                camera.record(Path(folder), comparison.watch)
                table = diagnose(folder, seed=planned.seed, jobs=arguments.jobs)
            pixels = comparison.affected()
            scores.append(overlap(table['where'], pixels))
            if name in DEPENDS_ON and table['where']:
                firsts.append(is_physical(table['where'][0]['covariate'], [name]))
            found = ', '.join(effect['name'] for effect in table['effects'])
            first = table['where'][0] if table['where'] else None
            print(
                f'{name:20s} {pose:>3s} mm  scenes {scenes:2s} {table["verdict"]:10s} {found:30s} '
                f'affected {pixels["affected"].mean():4.0%}  IoU {scores[-1]:.2f}  '
                f'{f"{group(first)}: {difference(first)}" if first else ""}',
                flush=True,
            )
    known = [score for score in scores if not math.isnan(score)]
    print(f'mean IoU {np.mean(known) if known else math.nan:.2f} of {len(known)}')
    print(f'first rows: {sum(firsts)} of {len(firsts)} name what the effect depends on')


def _usual(name: str, strength: float, usecase: str) -> Planned:
    # The benchmark's first case with this effect alone, or with none.
    effects = {} if name == 'none' else {name: strength}
    return next(
        case
        for case in make_design(DEVELOPMENT, quick=False)
        if case.group in ('single', 'none') and case.usecase == usecase and case.effects == effects
    )


if __name__ == '__main__':
    main()
