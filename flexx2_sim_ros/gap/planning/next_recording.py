"""Rank recordings by how well they would decide what a diagnosis leaves open."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import flexx2, Profile
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.data.campaign import check, Found
from flexx2_sim_ros.gap.data.given import given_effects
from flexx2_sim_ros.gap.data.hidden import hidden_effects
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.planning.forecast import (
    check_open,
    DiagnosedRecordings,
    expect,
    Expected,
    Explanation,
    what_is_known,
)
from flexx2_sim_ros.gap.planning.plan import Plan
from flexx2_sim_ros.gap.planning.possible import (
    kinds_named,
    look,
    of_campaign,
    of_plan,
    of_scene,
    Possible,
    PredictedView,
    usual_kinds,
)
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.gap.work import find, Progress, Simulations, stepper, summarise, summarise_all
from flexx2_sim_ros.jobs import bind, Map, workers
import numpy as np

SCHEMA = 3
_SHOWN = 3  # number of suggestions with images
_ENOUGH = 0.9  # expected fraction right from which on one set-up is enough
_COMBINED = 4  # set-ups that are combined in pairs


@dataclass(frozen=True, eq=False)
class _Row:
    # A recording that could be made, what is expected after it, and its two simulations.
    possible: Possible
    expected: Expected
    pair: tuple[Evidence, Evidence]


def suggest(
    diagnosis: str | Path,
    campaign: str | Path,
    plan: Plan,
    *,
    kinds: Sequence[str] = (),
    scenes: Sequence[str | Path] = (),
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = lambda text, share: None,
) -> tuple[dict[str, Any], list[PredictedView]]:
    """
    Rank recordings by how well they are expected to settle what a diagnosis leaves open.

    Return the table ``next.json`` of ``docs/diagnose_your_flexx2.md``, and the images of the first
    suggestions. Raises `InputError` when the diagnosis, a recording or a scene cannot be used, or
    the diagnosis leaves nothing open.

    * `campaign`: the recordings that were diagnosed.
    * `plan`: what could be recorded.
    * `kinds`: of ground truth that the user can make (default: those of the diagnosed recordings).
    * `scenes`: ``.npz`` files of further scenes, with ``clean_depth`` and ``K``.
    """
    before = read_diagnosis(Path(diagnosis))
    check_open(before)
    camera = profile or flexx2()
    chosen = kinds_named(kinds or usual_kinds(before.table))
    plan = replace(plan, usecase=_usecase(before))
    with tempfile.TemporaryDirectory() as name, workers(jobs, None) as mapped:
        folder = Path(name)
        progress('reading the recordings', 0.0)
        known, repeated = _known(before, campaign, camera, seed, mapped, progress)
        given = known.simulations.known or {}
        told = camera, given, seed
        possible = of_plan(folder, plan, chosen, *told)
        own = []
        for i, scene in enumerate(scenes):
            written = folder / f'own_{i}.npz'
            own.append(of_scene(written, Path(scene), plan.usecase, *told))
        possible += [*own, *of_campaign(repeated, given)]
        step = stepper(progress, 'simulating recordings', 0.2, 0.6, len(possible))
        outcomes = mapped(bind(_look_out, known=known), possible, step)
        for one, outcome in zip(possible, outcomes, strict=True):
            if one in own and isinstance(outcome, str):
                raise InputError(f'--scene: must be a usable scene, got {one.name}: {outcome}')
        rows = [one for one in outcomes if isinstance(one, _Row)]
        if not any(not one.possible.repeat for one in rows):
            why = next((one for one in outcomes if isinstance(one, str)), 'none suits the truth')
            raise InputError(f'--plan: must have a recording that can be used, got none: {why}')
        rows.sort(key=lambda row: (-row.expected.right, row.expected.wrong))
        new = [row for row in rows if not row.possible.repeat]
        best, expected = _suggestion(new, known, mapped, progress)
        first = [*best, *(row for row in new if row not in best)][:_SHOWN]
        views = [look(row.possible, known.standing, camera, seed) for row in first]
    return _table(rows, best, expected, known.standing), views


def _suggestion(
    new: Sequence[_Row], known: DiagnosedRecordings, mapped: Map, progress: Progress
) -> tuple[Sequence[_Row], Expected]:
    # The first set-up if that is enough, otherwise the best pair of the first few.
    sets: list[Sequence[_Row]] = [new[:1]]
    if new[0].expected.right < _ENOUGH and len(new) > 1:
        sets = list(combinations(new[:_COMBINED], 2))
    step = stepper(progress, 'combining recordings', 0.8, 0.2, len(sets))
    expected = mapped(bind(_together, known=known), sets, step)
    best = max(range(len(sets)), key=lambda i: (expected[i].right, -expected[i].wrong))
    return sets[best], expected[best]


def _known(
    before: Diagnosed,
    campaign: str | Path,
    camera: Profile,
    seed: int,
    mapped: Map,
    progress: Progress,
) -> tuple[DiagnosedRecordings, list[Found]]:
    # Diagnoses the campaign again, without writing anything: what fits leave of the gap is not in
    # the files of a diagnosis.
    given = table_of(given_effects(before.known))
    found, left_out = find(campaign, camera, mapped, before.full_scale)
    _check_same(before, found)
    without = {row['name'] for row in before.table.get('not_considered', [])}
    modulation = bool(found[0].mode.modulation_hz)
    columns, _ = catalogue(without, modulation)
    metres, degrees = before.pose_prior
    text = 'simulating what could explain the recordings'
    step = stepper(progress, text, 0.0, 0.2, len(found))
    simulations = Simulations(camera, columns, seed, (metres,) * 3 + (degrees,) * 3, given)
    used, evidence, _ = summarise_all(campaign, found, left_out, simulations, mapped, step)
    hidden = tuple(one for one in hidden_effects(campaign) if one.effect not in without)
    told = simulations, (frozenset(without), modulation), hidden, before.pose_held
    known = what_is_known(DiagnosedRecordings(tuple(evidence), *told))
    if len(known.standing) < 2:
        name = known.standing[0].name
        raise InputError(f'DIAGNOSIS: must leave something open, got only {name}')
    return known, used


def _check_same(before: Diagnosed, found: Sequence[Found]) -> None:
    diagnosed = {row['name'] for row in before.table['recordings'] if row.get('used')}
    missing = sorted(diagnosed - {one.path.name for one in found})
    if missing:
        raise InputError(
            f'CAMPAIGN: must have the recordings that were diagnosed, got no {shown(missing[0])}'
        )


def _usecase(before: Diagnosed) -> str:
    usecase = before.table.get('settings', {}).get('usecase')
    if not isinstance(usecase, str):
        raise InputError(
            f'DIAGNOSIS: settings: usecase: must be the mode, got {shown(usecase)}: diagnose again'
        )
    return usecase


def _look_out(possible: Possible, known: DiagnosedRecordings) -> _Row | str:
    # The expected value of a recording, or the reason why it cannot be used.
    told, kind = known.simulations, possible.kind
    found = check(possible.path, told.profile)
    if not isinstance(found, Found):
        return found
    own = {one.name for one in known.standing if one.effects}
    columns = [
        # What the ground truth always hides shifts nothing.
        replace(c, effects={k: v for k, v in c.effects.items() if k not in kind.never})
        if c.name in own
        else c
        for c in told.columns
    ]
    told = replace(told, columns=columns, known=possible.known)
    pair = []
    for seed in (told.seed, told.seed + 1):
        one = summarise((found, None), replace(told, seed=seed))
        if isinstance(one, str):
            return one
        pair.append(one)
    first, second = pair
    return _Row(possible, expect(known, [(first, second)], kind.fitted), (first, second))


def _together(rows: Sequence[_Row], known: DiagnosedRecordings) -> Expected:
    # What is expected when these set-ups are recorded twice each.
    fitted = any(row.possible.kind.fitted for row in rows)
    return expect(known, [row.pair for row in rows], fitted)


def _table(
    rows: Sequence[_Row],
    first: Sequence[_Row],
    expected: Expected,
    standing: Sequence[Explanation],
) -> dict[str, Any]:
    new, repeated = (
        [row for row in rows if row.possible.repeat == again] for again in (False, True)
    )
    planned = [row for row in rows if row.possible.planned is not None]
    return {
        'schema': SCHEMA,
        'explanations': {one.name: one.effects for one in standing},
        'probabilities': {one.name: float(one.weight) for one in standing},
        'suggestion': {'record': [_named(row) for row in first], **asdict(expected)},
        'ranking': [
            {**_named(row), 'words': row.possible.words, **asdict(row.expected)} for row in new
        ],
        'baselines': {
            name: _mean(some) for name, some in (('random', planned), ('repeat', repeated)) if some
        },
        'version': __version__,
    }


def _named(row: _Row) -> dict[str, str]:
    return {'name': row.possible.name, 'truth': row.possible.kind.name}


def _mean(rows: Sequence[_Row]) -> dict[str, float]:
    every = [asdict(row.expected) for row in rows]
    return {key: float(np.mean([one[key] for one in every])) for key in every[0]}
