"""Compute, store and read the table of what a plan can find."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.data.prior import USUAL
from flexx2_sim_ros.gap.features.catalogue import catalogue, Column
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.planning.plan import Plan
from flexx2_sim_ros.gap.planning.power import left_open, planned_columns, Power, power, STRENGTHS
from flexx2_sim_ros.gap.planning.truths import KINDS, TruthKind, write_campaign
from flexx2_sim_ros.gap.work import find, portion, Progress, Simulations, summarise
from flexx2_sim_ros.jobs import bind, Map, workers
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.physics.frame_state import why_no_phases
import numpy as np
import yaml

_DRAWS = 6


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
        scenes = [(s.panels, s.turn_rate, s.uptime) for s in (r.scene for r in plan.recordings)]
        simulated = plan.usecase, plan.scale, plan.frames, scenes
        told = repr((simulated, self.profile, self.seed, self.draws, calibrated(), __version__))
        return sha256(told.encode()).hexdigest()[:16]


def shipped_table() -> Path:
    """Return the file of the table that comes with the package."""
    return config_dir() / 'gap_plan_table.yaml'


def read_table(path: Path) -> dict[str, Any]:
    """
    Read a table as `compute` returns it.

    Raises `InputError` when the file is not a table.
    """
    table = read_config(path)
    wanted = {'command': str, 'date': str, 'kinds': dict, 'effects': dict}
    for key, kind in wanted.items():
        if not isinstance(table.get(key), kind):
            raise InputError(f'{shown_path(path)}: {key}: must be a {kind.__name__}')
    return table


def to_yaml(table: Mapping[str, Any]) -> str:
    """Return a table as text."""
    return (
        '# The smallest strength of each effect that the plan finds, by kind of ground truth.\n'
        '# docs/diagnose_your_flexx2.md says how it is computed.\n'
        + yaml.safe_dump(dict(table), sort_keys=False, width=100)
    )


def compute(request: PowerRequest, command: str, progress: Progress) -> dict[str, Any]:
    """
    Compute what a plan can find.

    Finished kinds of ground truth are stored in ``out``, so that an interrupted run resumes. The
    command line is stored in the table, of plain values: ``effects`` has, by effect and kind, the
    ``smallest`` strength (or None), the fraction ``found`` by strength, and whether the ground
    truth leaves the effect ``open``.
    """
    mode = request.profile.mode(request.plan.usecase)
    no_phases = why_no_phases(mode)
    names = [n for n, kind in registry().items() if not (no_phases and kind.needs_modulation)]
    effects: dict[str, dict[str, Any]] = {name: {} for name in names}
    with workers(request.jobs, None) as mapped:
        for i, kind in enumerate(request.kinds):
            part = portion(progress, i / len(request.kinds), 1 / len(request.kinds))
            for one in _of_kind(request, kind, names, mapped, not no_phases, part):
                effects[one.effect][kind.name] = _row(one)
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


def _row(one: Power) -> dict[str, Any]:
    found = {f'{strength:g}': round(share, 2) for strength, share in sorted(one.found.items())}
    return {'smallest': one.smallest, 'open': one.undecided, 'found': found}


def _of_kind(
    request: PowerRequest,
    kind: TruthKind,
    names: Sequence[str],
    mapped: Map,
    modulation: bool,
    progress: Progress,
) -> list[Power]:
    # All effects with one kind of ground truth; finished ones are read from their file.
    file = request.out / f'computed_{kind.name}.json'
    done = _finished(file, request.key)
    todo = [name for name in names if name not in done]
    if todo:
        evidence, columns = _simulate(request, kind, mapped, modulation, progress)
        model = Model(evidence, columns, np.repeat(USUAL, 3))
        hidden = left_open(model, catalogue((), modulation)[1], kind)
        work = bind(
            _power,
            evidence=evidence,
            columns=columns,
            hidden=hidden,
            kind=kind,
            modulation=modulation,
            told=(request.seed, request.draws),
        )
        for start in range(0, len(todo), 2 * request.jobs):
            progress(f'{kind.name}: deciding', 0.5 + 0.5 * start / len(todo))
            found = mapped(work, todo[start : start + 2 * request.jobs], lambda: None)
            done |= {one.effect: one for one in found}
            rows = [asdict(one) for one in done.values()]
            atomic.write_text(file, json.dumps({'key': request.key, 'effects': rows}))
    return [done[name] for name in names]


def _finished(file: Path, key: str) -> dict[str, Power]:
    # Results of an interrupted run; empty if that run had another request.
    if not is_regular_file(file):
        return {}
    try:
        table = json.loads(file.read_text())
        if table['key'] != key:
            return {}
        return {
            row['effect']: Power(
                row['effect'],
                {float(s): float(share) for s, share in row['found'].items()},
                bool(row['undecided']),
            )
            for row in table['effects']
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        return {}  # The file is not valid: compute again.


def _simulate(
    request: PowerRequest, kind: TruthKind, mapped: Map, modulation: bool, progress: Progress
) -> tuple[list[Evidence], list[Column]]:
    # The recordings' summaries, with each effect at each strength. The latter are simulated with
    # other random numbers than the catalogue; otherwise the fit would include their noise.
    known, _ = catalogue((), modulation)
    planned = planned_columns(modulation)
    prior = (USUAL[0],) * 3 + (USUAL[1],) * 3
    outcomes: list[list[Evidence | str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_campaign(folder, request.plan, request.profile, kind, seed=request.seed)
        found, _ = find(folder, request.profile, mapped)
        for half, columns in enumerate((known, planned)):
            progress(f'{kind.name}: simulating', 0.25 * half)
            simulations = Simulations(request.profile, columns, request.seed + half, prior)
            job = bind(summarise, simulations=simulations)
            outcomes.append(mapped(job, [(one, None) for one in found], lambda: None))
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


def _power(
    effect: str,
    evidence: Sequence[Evidence],
    columns: Sequence[Column],
    hidden: set[str],
    kind: TruthKind,
    modulation: bool,
    told: tuple[int, int],
) -> Power:
    model = Model(evidence, columns, np.repeat(USUAL, 3))
    return power(effect, model, catalogue((), modulation)[1], hidden, kind, *told)
