"""
List the answers of the published benchmark that missed a goal, and what its page quotes.

Prints single effects of strength 1 and 0.5 that were missed or for which only others were named,
false alarms, the error of the predicted reduction, its largest errors, the reductions below 0,
the time of campaigns without effects, and the largest times.

python -m bench.benchmark_answers
python -m bench.benchmark_answers --answers build/benchmark/answers.jsonl

Answers exist only after a run was scored. No threshold is chosen from them.
"""

import argparse
import lzma
from pathlib import Path
import tempfile

import numpy as np
from study.benchmark.answers import read_answers

_PUBLISHED = Path(__file__).with_name('benchmark_answers.jsonl.xz')
_LARGEST = 8  # errors and times to list


def main():
    """Print the lists."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--answers', type=Path, default=_PUBLISHED)
    answers = _read(parser.parse_args().answers)
    single = [one for one in answers if one.planned.group == 'single' and _usual(one)]
    wrong = [one for one in single if one.wrong]
    for one in wrong:
        print(f'wrong: {_name(one)}: {one.verdict} {", ".join(one.effects)}')
    print(f'{len(wrong)} of {len(single)} wrong')
    for one in answers:
        if one.planned.group == 'none' and one.verdict != 'none':
            named = zip(one.effects, one.confidences, strict=True)
            told = ', '.join(f'{effect} {confidence:.2f}' for effect, confidence in named)
            print(f'false alarm: poses {one.planned.pose_mm:g} mm: {one.verdict} {told}')
    measured = [one for one in answers if np.isfinite(one.prediction_error)]
    for name, some in (
        ('all', measured),
        ('independent measure', [one for one in measured if one.independent]),
    ):
        errors = np.array([one.prediction_error for one in some])
        mean, median = errors.mean(), np.median(errors)
        print(f'{name}: prediction wrong by {mean:.3f}, median {median:.3f} (of {len(some)})')
    for one in sorted(measured, key=lambda one: -one.prediction_error)[:_LARGEST]:
        print(f'{_name(one)}: predicted {one.predicted:.2f}, realised {one.realised:.2f}')
    for one in measured:
        if one.realised < 0:
            print(f'larger: {_name(one)}: {one.realised:.4f}, predicted {one.predicted:.3f}')
    quiet = [one.cpu_seconds for one in answers if not one.planned.effects]
    print(f'without effects: {np.median(quiet):.1f} s of a core (median of {len(quiet)})')
    slowest = sorted((one.cpu_seconds for one in answers), reverse=True)[:_LARGEST]
    print('slowest: ' + ', '.join(f'{seconds:.0f}' for seconds in slowest) + ' s of a core')


def _read(path):
    if path.suffix != '.xz':
        return read_answers(path).answers
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / 'answers.jsonl'
        plain.write_bytes(lzma.decompress(path.read_bytes()))
        return read_answers(plain).answers


def _usual(one):
    planned = one.planned
    strengths = set(planned.effects.values())
    return planned.pose_mm == 2.0 and not planned.hidden and strengths <= {0.5, 1.0}


def _name(one):
    return ' + '.join(f'{name} {strength:g}' for name, strength in one.planned.effects.items())


if __name__ == '__main__':
    main()
