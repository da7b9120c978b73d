"""
How often the diagnosis names an effect of the blind camera, in cases as large as the benchmark's.

Development seeds only. The cases are those of no run of the benchmark, and no rule was fitted to
them.

python -m bench.gap_blind --effects saturation,excess_noise --strength 0.5 --cases 8 --jobs 2
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark.design import MODES, Planned
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera, CATALOGUE

_FIRST, _OF_AN_EFFECT, _SCENES = 5000, 100, 16  # indices of seeds
_Answer = tuple[str, list[str], list[str], float]


def main() -> None:
    """Print a line for each case, and how many are right."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--effects', default=','.join(sorted(CATALOGUE)))
    parser.add_argument('--strength', type=float, default=0.5)
    parser.add_argument('--cases', type=int, default=8, help='of each effect')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    arguments = parser.parse_args()
    names = arguments.effects.split(',')
    cases = list(_cases(names, arguments.strength, arguments.cases))
    right = dict.fromkeys(names, 0)
    with ProcessPoolExecutor(arguments.jobs, get_context('spawn')) as pool:
        for case, answer in zip(cases, pool.map(_answer, cases), strict=True):
            (name,), (verdict, named, others, shrink) = case.effects, answer
            right[name] += [one.split()[0] for one in named[:1]] == [name]
            print(
                f'{name:20s} {case.usecase:14s} {verdict:10s} {", ".join(named):36s} '
                f'or {", ".join(others):30s} shrink {shrink:.2f}',
                flush=True,
            )
    for name, count in right.items():
        print(f'{name}: {count} of {arguments.cases} are named first')


def _cases(names: list[str], strength: float, count: int) -> Iterator[Planned]:
    for name in names:
        start = _FIRST + _OF_AN_EFFECT * sorted(CATALOGUE).index(name)
        for i in range(count):
            yield Planned(
                'single',
                MODES[i % len(MODES)],
                {name: strength},
                DEVELOPMENT.seed(start + i),
                DEVELOPMENT.seed(i % _SCENES),
            )


def _answer(case: Planned) -> _Answer:
    with scratch_folder() as folder:
        BlindCamera(case.case).record(folder)
        table = diagnose(folder)
    named = [f'{row["name"]} {row["confidence"]:.2f}' for row in table['effects']]
    others = [row['name'] for row in table['alternatives']]
    return table['verdict'], named, others, table['gap']['shrink']


if __name__ == '__main__':
    main()
