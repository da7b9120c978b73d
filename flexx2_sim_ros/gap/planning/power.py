"""
What a plan can find: the smallest strength at which the diagnosis finds each effect.

An effect's shift of all features is simulated once at each strength. Noise of the features comes
from the simulations without effects, errors of the ground truth from its covariance. The fit and
the calibrated rule of the verdict then decide on many draws, without any further simulation.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from datetime import datetime, UTC
from hashlib import sha256
import json
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.config_file import is_regular_file, read_config
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.data.prior import POSE, USUAL
from flexx2_sim_ros.gap.data.unknown import PLANE_STEPS
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue, Column
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.work import find, portion, Progress, Simulator
from flexx2_sim_ros.gap.inference.decidable import parted, undecided
from flexx2_sim_ros.gap.inference.decide import hidden_could_explain
from flexx2_sim_ros.gap.inference.model import combine, Model
from flexx2_sim_ros.gap.inference.own_errors import COMMON
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge
from flexx2_sim_ros.gap.inference.selection import (
    best_of_each,
    Choice,
    Selection,
    Trials,
    without_each,
)
from flexx2_sim_ros.gap.inference.support import support_of
from flexx2_sim_ros.gap.planning.plan import Plan
from flexx2_sim_ros.gap.planning.truths import KINDS, TruthKind, write_campaign
from flexx2_sim_ros.jobs import bind, Map, workers
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.physics.frame_state import why_no_phases
import numpy as np
import yaml

STRENGTHS = (0.1, 0.25, 0.5, 1.0, 2.0)
_WANTED = 0.9
_TYPICAL = 0.5  # strength at which rival explanations are selected
_DRAWS = 6
_RIVALS = 3


@dataclass(frozen=True)
class PowerRequest:
    """
    What to compute of a plan: `draws` at each strength, for each kind of ground truth.

    Finished parts are in the folder `out`. `seed` is that of the simulations and draws.
    """

    plan: Plan
    profile: Profile
    out: Path
    seed: int = 0
    draws: int = _DRAWS
    jobs: int = 1
    kinds: tuple[TruthKind, ...] = KINDS

    @property
    def key(self) -> str:
        """Return a digest of everything that the result depends on."""
        plan = self.plan
        scenes = [one.scene for one in plan.recordings]
        simulated = plan.usecase, plan.scale, plan.frames, scenes
        told = repr((simulated, self.profile, self.seed, self.draws, calibrated(), __version__))
        return sha256(told.encode()).hexdigest()[:16]

    @property
    def modulation(self) -> bool:
        """Return whether there are effects that need modulation frequencies, as in `catalogue`."""
        return not why_no_phases(self.profile.mode(self.plan.usecase))

    @property
    def effects(self) -> list[str]:
        """Return the names of the effects that a camera in this mode can have."""
        kinds = registry().items()
        return [name for name, kind in kinds if self.modulation or not kind.needs_modulation]


def shipped_table() -> dict[str, Any]:
    """Return the table that comes with the package, as from `compute`."""
    return read_config(config_dir() / 'gap_plan_table.yaml')


def to_yaml(table: Mapping[str, Any]) -> str:
    """Return a table as text."""
    return (
        '# The smallest strength of each effect that the plan finds, by kind of ground truth.\n'
        '# docs/diagnose_your_flexx2.md says how it is computed.\n'
        + yaml.safe_dump(dict(table), sort_keys=False, width=100)
    )


def compute(request: PowerRequest, command: str, progress: Progress) -> dict[str, Any]:
    """
    Return the table of what a plan can find; `command` is the command line to store in it.

    Finished kinds of ground truth are stored in ``out``, so that an interrupted run resumes.
    ``effects`` has, by effect and kind, the ``smallest`` strength that is found in 90 % of draws
    (or None), the fraction ``found`` by strength, as far as strengths were tried, and whether the
    ground truth leaves the effect ``open`` at any strength.
    """
    effects: dict[str, dict[str, Any]] = {name: {} for name in request.effects}
    with workers(request.jobs, None) as mapped:
        for i, kind in enumerate(request.kinds):
            part = portion(progress, i / len(request.kinds), 1 / len(request.kinds))
            found = _of_kind(request, kind, mapped, part)
            for name, own in effects.items():
                own[kind.name] = found[name]
    return {
        'schema': 1,
        'command': command,
        'date': datetime.now(UTC).date().isoformat(),
        'version': __version__,
        'usecase': request.plan.usecase,
        'camera': request.profile.model,
        'simulation': {'scale': request.plan.scale, 'frames': request.plan.frames},
        'draws': request.draws,
        'seed': request.seed,
        'strengths': list(STRENGTHS),
        'kinds': {kind.name: kind.words for kind in request.kinds},
        'effects': effects,
    }


def _of_kind(
    request: PowerRequest, kind: TruthKind, mapped: Map, progress: Progress
) -> dict[str, Any]:
    # All effects with one kind of ground truth; finished ones are read from their file.
    file = request.out / f'computed_{kind.name}.json'
    done = _finished(file, request.key)
    todo = [name for name in request.effects if name not in done]
    if todo:
        evidence, columns = _simulate(request, kind, mapped, progress)
        model = Model(evidence, columns, np.repeat(USUAL, 3))
        confounded = undecided(model, catalogue((), request.modulation)[1])
        hidden = kind.never | {one.effect for one in confounded if one.confounded}
        told = {'evidence': evidence, 'columns': columns, 'kind': kind, 'request': request}
        work = bind(power, hidden=hidden, **told)
        for start in range(0, len(todo), 2 * request.jobs):
            progress(f'{kind.name}: deciding', 0.5 + 0.5 * start / len(todo))
            some = todo[start : start + 2 * request.jobs]
            done |= zip(some, mapped(work, some, lambda: None), strict=True)
            atomic.write_text(file, json.dumps({'key': request.key, 'effects': done}))
    return done


def _finished(file: Path, key: str) -> dict[str, Any]:
    # Results of an interrupted run; empty if that run had another request or the file is damaged.
    try:
        table = json.loads(file.read_text()) if is_regular_file(file) else {}
        return dict(table['effects']) if table['key'] == key else {}
    except (ValueError, KeyError, TypeError):
        return {}


def _simulate(
    request: PowerRequest, kind: TruthKind, mapped: Map, progress: Progress
) -> tuple[list[Evidence], list[Column]]:
    # The recordings' summaries, with each effect at each strength. The latter are simulated with
    # other random numbers than the catalogue; otherwise the fit would include their noise.
    known, _ = catalogue((), request.modulation)
    planned = _planned_columns(request.effects)
    prior = tuple(np.repeat(USUAL, 3))
    outcomes: list[list[Evidence | str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_campaign(folder, request.plan, request.profile, kind, seed=request.seed)
        found, _ = find(folder, request.profile, mapped)
        for half, columns in enumerate((known, planned)):
            progress(f'{kind.name}: simulating', 0.25 * half)
            seed = request.seed + half
            simulator = Simulator(mapped, request.profile, {}, seed, prior, columns)
            outcomes.append(simulator.summaries(found))
    # Too little of a scene may be within the mode's range.
    evidence = [
        replace(one, columns=np.concatenate([one.columns, other.columns]))
        for one, other in zip(*outcomes, strict=True)
        if isinstance(one, Evidence) and isinstance(other, Evidence)
    ]
    if not evidence:
        raise InputError(
            f'--plan: must have recordings within the range of {request.plan.usecase}, got none: '
            f'{next(one for half in outcomes for one in half if isinstance(one, str))}'
        )
    return evidence, known + planned


def _planned_columns(effects: Sequence[str]) -> list[Column]:
    # The simulations of all effects at all strengths, in addition to the catalogue.
    return [
        Column(
            _column_name(name, strength),
            {name: {'strength': strength}},
            all(term.few for one in registry()[name].hypotheses for term in one.terms),
        )
        for name in effects
        for strength in STRENGTHS
    ]


def _column_name(effect: str, strength: float) -> str:
    return f'plan:{effect}:{strength:g}'


def power(
    effect: str,
    evidence: Sequence[Evidence],
    columns: Sequence[Column],
    hidden: Set[str],
    kind: TruthKind,
    request: PowerRequest,
) -> dict[str, Any]:
    """
    Return the cell of an effect in the table of `compute`.

    The effect is found if the diagnosis names it first, and no effect that the ground truth leaves
    undecided explains about as much. `evidence` has the recordings without effects, `columns` of
    all effects at all strengths; `hidden` are the effects that the ground truth leaves undecided.
    """
    model = Model(evidence, columns, np.repeat(USUAL, 3))
    candidates = catalogue((), request.modulation)[1]
    draws = request.draws
    never = kind.never
    # As in the diagnosis, what the truth takes away wholly explains nothing.
    candidates = [one for one in candidates if one.effect not in never]
    if not model.own.posed.any():
        candidates = [one for one in candidates if one.kind.role != 'pose']
    if effect in hidden or not any(one.effect == effect for one in candidates):
        return {'smallest': None, 'open': True, 'found': {}}
    decidable, others = _considered(model, candidates, hidden, effect)

    def fraction(strength: float) -> float:
        shift = model.column(_column_name(effect, strength))
        if _first_effect(_singles(Trials(model.as_if(shift)), decidable)) != effect:
            return 0.0  # It does not explain the gap best even without noise.
        misses = 0
        for draw in range(draws):
            rng = np.random.default_rng([request.seed, draw])
            gap = shift + noise(model, rng) + wrong_truth(model, kind.fitted, rng)
            misses += not _is_found(Trials(model.as_if(gap)), decidable, others, effect)
            if misses > (1 - _WANTED) * draws:  # It can no longer reach 90 %.
                return 1 - misses / (draw + 1)
        return 1 - misses / draws

    # From the middle strength, weaker ones are tried while the effect is found, or stronger ones
    # until it is.
    middle = len(STRENGTHS) // 2
    found = {STRENGTHS[middle]: fraction(STRENGTHS[middle])}
    weaker = found[STRENGTHS[middle]] >= _WANTED
    for strength in STRENGTHS[:middle][::-1] if weaker else STRENGTHS[middle + 1 :]:
        found[strength] = fraction(strength)
        if (found[strength] >= _WANTED) != weaker:
            break
    least = min((one for one, share in found.items() if share >= _WANTED), default=None)
    shares = {f'{one:g}': round(share, 2) for one, share in sorted(found.items())}
    return {'smallest': least, 'open': False, 'found': shares}


def _considered(
    model: Model, candidates: Sequence[Candidate], hidden: Set[str], effect: str
) -> tuple[list[Candidate], list[Candidate]]:
    # The best variant of the effect, and the effects that explain its gap next best, without
    # noise: of effects that can be decided, and of those left undecided.
    trials = Trials(model.as_if(model.column(_column_name(effect, _TYPICAL))))
    several = [one for some in parted(candidates, hidden) for one in some]
    singles = best_of_each([trials.choice([one]) for one in several])
    best = [one.fit.candidates[0] for one in singles]
    own = [one for one in best if one.effect == effect]
    rivals = [one for one in best if one.effect != effect]
    return (
        own + [one for one in rivals if one.effect not in hidden][:_RIVALS],
        [one for one in rivals if one.effect in hidden][:_RIVALS],
    )


def _is_found(
    trials: Trials, decidable: list[Candidate], hidden: list[Candidate], effect: str
) -> bool:
    singles = _singles(trials, decidable)
    if _first_effect(singles) != effect:
        return False
    first, *rivals = singles
    selection = Selection(first, tuple(rivals))
    support = support_of(trials, selection, without_each(trials, first), singles)
    if judge(support, calibrated()).verdict not in EXPLAINED:
        return False
    if not hidden:
        return True
    # The diagnosis ends `unknown` where an undecided effect explains about as much.
    singles += [trials.single(one) for one in hidden]
    names = {one.effect for one in hidden}
    return not hidden_could_explain(trials, first, [*decidable, *hidden], singles, names)


def _singles(trials: Trials, decidable: list[Candidate]) -> list[Choice]:
    return best_of_each([trials.single(one) for one in decidable])


def _first_effect(singles: Sequence[Choice]) -> str:
    return singles[0].fit.candidates[0].effect


def noise(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Return (R, SIZE) noise of features: one simulation of each recording minus the others."""
    out = []
    for one in model.evidence:
        k = int(rng.integers(len(one.nulls)))
        out.append(one.nulls[k] - np.delete(one.nulls, k, axis=0).mean(axis=0))
    return np.nan_to_num(np.array(out))


def wrong_truth(model: Model, fitted: bool, rng: np.random.Generator) -> np.ndarray:
    """
    Return (R, SIZE) shift of the features by random errors of the ground truth, linearised.

    Planes that are `fitted` to the recordings are where the recordings have them.
    """
    amounts = np.zeros((len(model.gap), model.own.count))
    for row, one in zip(amounts, model.evidence, strict=True):
        covariance = one.covariance
        if covariance is None or fitted:
            continue
        deviation = np.sqrt(np.diag(covariance)) * rng.standard_normal(len(covariance))
        row[:POSE] = deviation[:POSE] / STEPS
        planes = deviation[POSE:] / np.resize(PLANE_STEPS, len(covariance) - POSE)
        row[COMMON : COMMON + len(planes)] = planes
    columns, _ = model.nuisance_columns([], np.zeros((len(amounts), 0)))
    return combine(amounts, columns)
