"""
Scored answers as a file, so that a long run can be done in parts.

A later part, at the same commit, skips the cases that the file answers; all are scored together.
"""

from collections.abc import Sequence
from dataclasses import fields
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import flexx2_sim_ros
from flexx2_sim_ros.atomic import write_text
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from study.benchmark.design import Planned
from study.benchmark.scoring import Answer, Scores

_TUPLES = 'effects', 'alternatives', 'confidences'
_NUMBERS = (
    *('seconds', 'cpu_seconds', 'peak_mb', 'overlap', 'parameter_error'),
    *('predicted', 'low', 'high', 'realised', 'before_mm', 'after_mm', 'order'),
)


def write_answers(scores: Scores, path: Path) -> None:
    """
    Write the answers of a run: a line with its commitments, and one for each case.

    * `scores`: of a run, or of the part of it that is done
    * `path`: the file, JSON lines. NaN is written as null.
    """
    rows = [_row(answer) for answer in scores.answers]
    lines = [{'commitment': scores.commitment, 'earlier': list(scores.earlier)}, *rows]
    write_text(path, ''.join(json.dumps(line) + '\n' for line in lines))


def read_answers(path: Path) -> Scores:
    """
    Read what `write_answers` wrote.

    Raises InputError when the file cannot be read, or is not of this kind.
    """
    try:
        first, *rows = [json.loads(line) for line in path.read_text().splitlines()]
        return Scores(
            tuple(_answer(row) for row in rows), first['commitment'], tuple(first['earlier'])
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'--earlier: must be the answers of a benchmark, got {path}, which cannot be read: '
            f'{error!r}'
        ) from error


def joined(earlier: Scores | None, scores: Scores) -> Scores:
    """Return the answers of all parts of a run so far."""
    if earlier is None:
        return scores
    return Scores(
        (*earlier.answers, *scores.answers),
        scores.commitment,
        (*earlier.earlier, earlier.commitment),
    )


def not_answered(
    design: Sequence[Planned], earlier: Scores | None, facts: dict[str, Any]
) -> list[Planned]:
    """
    Return the cases of a design that no earlier part of the run has answered.

    Raises InputError when the earlier part has other code or seeds, or leaves no case.
    """
    if earlier is None:
        return list(design)
    for name in 'code', 'seed_set', 'quick':
        if earlier.commitment.get(name) != facts[name]:
            raise InputError(
                f'--earlier: must be of a run with the same {name}: {facts[name]}, '
                f'got {earlier.commitment.get(name)}'
            )
    done = {one.planned.key for one in earlier.answers}
    left = [one for one in design if one.key not in done]
    if not left:
        raise InputError('--earlier: must leave cases to run, got answers to all of them')
    return left


def code_digest() -> str:
    """Return the SHA-256 of the source and configuration files."""
    digest = hashlib.sha256()
    study, package = Path(__file__).resolve().parents[1], Path(flexx2_sim_ros.__file__).parent
    sources = (study, ('*.py',)), (package, ('*.py',)), (config_dir(), ('*.yaml', '*.npz'))
    for folder, kinds in sources:
        for path in sorted(path for kind in kinds for path in folder.rglob(kind)):
            digest.update(f'{path.relative_to(folder).as_posix()}\n'.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _row(answer: Answer) -> dict[str, Any]:
    row = {one.name: getattr(answer, one.name) for one in fields(answer)}
    row['planned'] = answer.planned.to_json()
    row['confidences'] = [_known(value) for value in answer.confidences]
    return {**row, **{name: _known(row[name]) for name in _NUMBERS}}


def _answer(row: dict[str, Any]) -> Answer:
    row = {**row, 'planned': Planned.from_json(row['planned'])}
    row['confidences'] = [_number(value) for value in row['confidences']]
    row.update({name: tuple(row[name]) for name in _TUPLES})
    return Answer(**{**row, **{name: _number(row[name]) for name in _NUMBERS}})


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
