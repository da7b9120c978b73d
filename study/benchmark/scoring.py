"""Open the labels and score the answers."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import json
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
import numpy as np
from study.benchmark.design import Planned
from study.benchmark.many import order, recall
from study.benchmark.overlap import overlap
from study.benchmark.physics import is_physical
from study.benchmark.realised import is_independent
from study.benchmark.sealing import COMMITMENT, open_seal
from study.blind import CATALOGUE

NONE, UNKNOWN = 'none', 'unknown'
SAID = ('identified', 'partly')
_UNSURE = ('unknown', 'partly')


@dataclass(frozen=True)
class Answer:
    """
    A case and its answer.

    * `verdict`: as in the diagnosis, or ``error``
    * `effects`, `alternatives`: names in order of importance
    * `confidences`: of the effects: the probability that each is present; NaN where the diagnosis
      gives none
    * `seconds`, `cpu_seconds`, `peak_mb`: of the diagnosis: elapsed time, computing time, memory
    * `place`: covariate of the first row of ``where``, empty where there is no row
    * `overlap`: intersection over union of the affected pixels and the named ones, NaN where no
      pixel is affected
    * `visible`: whether the effect changes any pixel's statistics by more than the tolerance
    * `parameter_error`: relative error of the first effect if it is right and comparable; NaN
      otherwise
    * `predicted`, `low`, `high`, `realised`: reduction of the gap; NaN where it was not measured,
      or where there is no gap
    * `before_mm`, `after_mm`: depth errors of fresh recordings beside the simulation without and
      with the effects; NaN where it was not measured
    * `contributions`: of each effect of a camera with many; see `many.contributions`
    * `order`: see `many.order`
    * `disagrees`: the effect in which recordings are said to disagree; empty if in none
    * `independent`: whether the realised reduction was measured without code of the diagnosis
    """

    planned: Planned
    verdict: str
    effects: tuple[str, ...]
    alternatives: tuple[str, ...]
    confidences: tuple[float, ...]
    seconds: float
    cpu_seconds: float
    peak_mb: float
    place: str
    overlap: float
    visible: bool
    parameter_error: float
    predicted: float
    low: float
    high: float
    realised: float
    before_mm: float
    after_mm: float
    contributions: dict[str, float]
    order: float
    disagrees: str
    independent: bool
    baselines: dict[str, str]

    @property
    def truth(self) -> set[str]:
        """Return the true effects."""
        return set(self.planned.effects)

    @property
    def first(self) -> str:
        """Return the first effect, ``none`` or ``unknown``."""
        if self.verdict == NONE:
            return NONE
        return self.effects[0] if self.verdict in SAID and self.effects else UNKNOWN

    @property
    def right(self) -> bool:
        """Whether the first answer is right; `partly` is for effects outside the catalogue."""
        if not self.planned.effects:
            return self.verdict == NONE
        if self.planned.group in ('novel', 'left_out'):
            return self.verdict in _UNSURE
        if self.planned.only:
            return self.said_of_some
        return self.first in self.truth

    @property
    def said_of_some(self) -> bool:
        """Whether a true effect is named at any place, or one in which recordings disagree."""
        return bool(self.truth & {self.disagrees, *(self.effects if self.verdict in SAID else ())})

    @property
    def recall(self) -> float:
        """Return the share of what all effects contribute that is named."""
        return recall(self.contributions, self.effects if self.verdict in SAID else ())

    @property
    def delivered(self) -> float:
        """Return the realised reduction; 0 where none was measured, as nothing was named."""
        return 0.0 if math.isnan(self.realised) else self.realised

    @property
    def wrong_names(self) -> int:
        """Return how many effects are named that the camera does not have."""
        return len(set(self.effects) - self.truth) if self.verdict in SAID else 0

    @property
    def contains(self) -> bool:
        """Whether it is right, or a true effect is among the effects and alternatives."""
        return self.right or bool(
            self.truth & {*self.effects, *self.alternatives} and self.verdict in SAID
        )

    @property
    def covers(self) -> bool:
        """Whether a true effect is among the effects and alternatives, whatever the verdict."""
        return bool(self.truth & {*self.effects, *self.alternatives})

    @property
    def both(self) -> bool:
        """Whether all true effects are among those identified."""
        return self.verdict in SAID and self.truth <= set(self.effects)

    @property
    def wrong(self) -> bool:
        """Whether it names effects but no true one, or misses a true one."""
        return not self.contains and self.verdict != UNKNOWN

    @property
    def right_place(self) -> bool:
        """Whether a true effect depends on the covariate of the first row of ``where``."""
        return bool(self.place) and is_physical(self.place, self.truth)

    @property
    def prediction_error(self) -> float:
        """Return how far the predicted reduction is from the realised one; NaN without both."""
        return abs(self.predicted - self._gone)

    @property
    def interval_holds(self) -> bool:
        """Whether the realised reduction lies in the interval of the prediction."""
        return self.low <= self._gone <= self.high

    @property
    def _gone(self) -> float:
        # Not more than all of a gap goes away: what is above 1 is noise of the fresh scenes.
        return min(self.realised, 1.0)

    @property
    def missed(self) -> bool:
        """Whether there was an effect and the answer was ``none``."""
        return bool(self.truth) and self.verdict == NONE


@dataclass(frozen=True)
class Scores:
    """
    All answers of a run.

    * `commitment`: the commitment that was written before the run
    * `earlier`: the commitments of earlier parts of the run
    """

    answers: tuple[Answer, ...]
    commitment: dict[str, Any]
    earlier: tuple[dict[str, Any], ...] = ()

    @property
    def planned(self) -> int:
        """Return how many cases the whole run has."""
        return int((*self.earlier, self.commitment)[0]['cases'])

    def of(self, group: str, **wanted: Any) -> list[Answer]:
        """Return the answers of a group with these attributes (strength, pose_mm, usecase)."""
        return [
            answer
            for answer in self.answers
            if answer.planned.group == group
            and all(getattr(answer.planned, key) == value for key, value in wanted.items())
        ]


def score(out: Path, partly: bool = False) -> Scores:
    """
    Score a run.

    * `out`: as given to `run_benchmark`
    * `partly`: whether cases may be missing. Finished cases are a random sample of the first half
      of the design, or this half and a random sample of the second.

    Raises InputError when the labels differ from the commitment, or no case is finished.
    """
    sealed = open_seal(out / 'sealed', out)
    answers = []
    for name, planned in sealed.cases.items():
        file = out / 'results' / f'{name}.json'
        if partly and not file.is_file():
            continue
        result = json.loads(file.read_text())
        truth = out / 'sealed' / 'truth'
        facts = json.loads((truth / f'{name}.json').read_text())
        with np.load(truth / f'{name}.npz', allow_pickle=False) as pixels:
            answers.append(answer_of(planned, result, facts, dict(pixels)))
    if not answers:
        raise InputError(
            f'--out: must have at least one finished case to score, got none in {out}'
        )
    return Scores(tuple(answers), json.loads((out / COMMITMENT).read_text()))


def answer_of(
    planned: Planned, result: dict[str, Any], facts: dict[str, Any], pixels: dict[str, np.ndarray]
) -> Answer:
    """
    Compare a result with its label.

    * `facts`: ``parameters``, the true ones by effect, and ``contributions``
    * `pixels`: from `truth.Comparison.affected`
    """
    diagnosis = result['diagnosis'] or {'verdict': 'error'}
    effects = diagnosis.get('effects') or []
    names = tuple(effect['name'] for effect in effects)
    gap = diagnosis.get('gap') or {}
    realised = result.get('realised') or {}
    interval = gap.get('interval') or (math.nan, math.nan)
    where = diagnosis.get('where') or []
    error = math.nan
    if effects and names[0] in planned.effects:
        error = _parameter_error(effects[0], facts['parameters'].get(names[0], {}))
    checked = bool(realised)
    return Answer(
        planned,
        str(diagnosis['verdict']),
        names,
        tuple(effect['name'] for effect in diagnosis.get('alternatives') or []),
        tuple(_number(effect.get('confidence')) for effect in effects),
        float(result['seconds']),
        _number(result.get('cpu_seconds')),
        float(diagnosis.get('peak_mb') or math.nan),
        str(where[0]['covariate']) if where else '',
        overlap(where, pixels) if planned.effects else math.nan,
        bool(planned.effects and pixels['affected'].any()),
        error,
        _number(gap.get('shrink')) if checked else math.nan,
        _number(interval[0]) if checked else math.nan,
        _number(interval[1]) if checked else math.nan,
        _number(realised.get('shrink')),
        _number(realised.get('before_mm')),
        _number(realised.get('after_mm')),
        facts['contributions'],
        order(effects, facts['contributions']),
        str((diagnosis.get('disagree') or {}).get('name', '')),
        is_independent(realised),
        result.get('baselines') or {},
    )


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _parameter_error(effect: dict[str, Any], label: dict[str, float]) -> float:
    # Of the parameter that a label and a diagnosis share.
    kind = registry().get(effect['name'])
    compared = kind.compared if kind else ''
    found, true = (effect.get('parameters') or {}).get(compared), label.get(compared)
    if not isinstance(found, int | float) or not true:  # Calibrated forms may have tables.
        return math.nan
    # A factor of 1 is no effect.
    neutral = 1.0 if compared == 'factor' else 0.0
    return abs(float(found) - true) / abs(true - neutral)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share; 0 to 1 for none of none."""
    if not count:
        return 0.0, 1.0
    z = 1.96
    share = hits / count
    middle = share + z * z / (2 * count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    scale = 1 + z * z / count
    return max((middle - half) / scale, 0.0), min((middle + half) / scale, 1.0)


def share(answers: Sequence[Answer], of: Callable[[Answer], bool]) -> tuple[int, int]:
    """Return the number of answers for which this holds, and the number of answers."""
    return sum(of(answer) for answer in answers), len(answers)


def macro_f1(pairs: Iterable[tuple[str, str]]) -> float:
    """
    Return the mean F1 over the catalogue's effects that occur.

    `pairs`: truth and answer. Truths outside the catalogue (novel, none) are negatives for all.
    """
    pairs = list(pairs)
    scores = []
    for name in {truth for truth, _ in pairs} & set(CATALOGUE):
        both = sum(truth == name == said for truth, said in pairs)
        either = sum(truth == name for truth, _ in pairs) + sum(said == name for _, said in pairs)
        scores.append(2 * both / either)
    return float(np.mean(scores)) if scores else math.nan


def f1_pairs(scores: Scores) -> list[tuple[str, str]]:
    """Return truth and answer of singles, none and novel cases; `partly` counts for singles."""
    pairs = []
    for answer in scores.answers:
        if answer.planned.group in ('single', 'none', 'novel'):
            truth = next(iter(answer.planned.effects), NONE)
            claims = answer.verdict == 'identified' or answer.planned.group == 'single'
            pairs.append((truth, answer.first if claims else UNKNOWN))
    return pairs
