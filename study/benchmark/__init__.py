"""
The check on withheld effects: a diagnosis against a camera it knows nothing of.

The only package that knows both sides. `design` says which cases there are, `sealing` commits to
their labels, `runner` makes and diagnoses them one by one, `scoring` opens the labels, `report`
prints. ``docs/benchmark.md`` describes the camera.
"""

from study.benchmark.design import make_design, Planned
from study.benchmark.runner import run_benchmark
from study.benchmark.scoring import score, Scores
from study.benchmark.seeds import DEVELOPMENT, SeedRange, TEST

__all__ = [
    'DEVELOPMENT',
    'TEST',
    'Planned',
    'Scores',
    'SeedRange',
    'make_design',
    'run_benchmark',
    'score',
]
