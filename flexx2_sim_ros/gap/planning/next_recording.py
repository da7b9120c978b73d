"""Rank recordings by how well they would decide what a diagnosis leaves open."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import flexx2, Profile
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import check, Found
from flexx2_sim_ros.gap.features.catalogue import catalogue, Column, nuisances
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.planning.explanations import Effects, explanations, NONE
from flexx2_sim_ros.gap.planning.information import (
    entropy,
    Outlook,
    outlook,
    true_columns,
    with_true,
)
from flexx2_sim_ros.gap.planning.looks import look, View
from flexx2_sim_ros.gap.planning.plan import Plan
from flexx2_sim_ros.gap.planning.possible import (
    kinds_named,
    of_campaign,
    of_plan,
    of_scene,
    Possible,
    usual_kinds,
)
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.gap.work import find, summarise
from flexx2_sim_ros.jobs import bind, workers
import numpy as np

SCHEMA = 1
_SHOWN = 3  # number of suggestions with images
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Suggestions:
    """
    What to record next.

    Attributes
    ----------
    table : dict
        The table ``next.json`` of ``docs/planning.md``.
    views : list of View
        The images of the first suggestions.

    """

    table: dict[str, Any]
    views: list[View]


@dataclass(frozen=True)
class _Setting:
    # Settings of all simulations.
    profile: Profile
    known: Effects
    prior: tuple[float, ...]
    seed: int
    standing: dict[str, Effects]
    weights: tuple[float, ...]
    needed: float

    @property
    def names(self) -> list[str | None]:
        return [name if effects else None for name, effects in self.standing.items()]


def suggest(
    diagnosis: str | Path,
    plan: Plan,
    *,
    kinds: Sequence[str] = (),
    scenes: Sequence[str | Path] = (),
    campaign: str | Path | None = None,
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = lambda text, share: None,
) -> Suggestions:
    """
    Rank recordings by their expected information about the open explanations of a diagnosis.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    plan : Plan
        What could be recorded.
    kinds : sequence of str
        Kinds of ground truth that the user can make (default: those of the diagnosed recordings).
    scenes : sequence of str or pathlib.Path
        ``.npz`` files of further scenes, with ``clean_depth`` and ``K``.
    campaign : str or pathlib.Path, optional
        The recordings that were diagnosed, to compare with repeating them.
    profile : Profile, optional
        The camera (default: the Flexx2).
    seed : int
        Seed of the simulations.
    jobs : int
        Number of processes.
    progress : callable
        Called with the name of the current step and the fraction of the work that is done.

    Raises
    ------
    InputError
        When the diagnosis or a scene cannot be used, or the diagnosis leaves nothing open.

    """
    before = read_diagnosis(Path(diagnosis))
    camera = profile or flexx2()
    setting = _setting(before, camera, seed)
    chosen = kinds_named(kinds or usual_kinds(before.table))
    plan = replace(plan, usecase=_usecase(before))
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        progress('simulating recordings', done / len(possible))

    with tempfile.TemporaryDirectory() as name, workers(jobs, None) as mapped:
        folder = Path(name)
        progress('rendering scenes', 0.0)
        told = camera, setting.known, seed
        possible = of_plan(folder, plan, chosen, *told)
        for i, scene in enumerate(scenes):
            written = folder / f'own_{i}.npz'
            possible.append(of_scene(written, Path(scene), plan.usecase, *told))
        if campaign is not None:
            possible += of_campaign(find(campaign, camera, mapped)[0])
        outlooks = mapped(bind(_look_out, setting=setting), possible, step)
        pairs = [
            (one, expected)
            for one, expected in zip(possible, outlooks, strict=True)
            if isinstance(expected, Outlook)
        ]
        if not any(not one.repeat for one, _ in pairs):
            raise InputError(f'DIAGNOSIS: no recording of the plan can be used: {outlooks[0]}')
        pairs.sort(key=lambda pair: -pair[1].bits)
        progress('drawing', 1.0)
        first = [one for one, _ in pairs if not one.repeat][:_SHOWN]
        views = [look(one, setting.standing, *told) for one in first]
    return Suggestions(_table(pairs, setting), views)


def _setting(before: Diagnosed, camera: Profile, seed: int) -> _Setting:
    metres, degrees = before.pose_prior
    known = {name: dict(values) for name, values in before.known.items()}
    standing = explanations(before)
    return _Setting(
        camera,
        known,
        (metres,) * 3 + (degrees,) * 3,
        seed,
        standing,
        _weights(before, standing),
        _needed(before),
    )


def _weights(before: Diagnosed, standing: dict[str, Effects]) -> tuple[float, ...]:
    # Explanations are equally likely, except no effect where the diagnosis has found a gap: its
    # probability falls with the loss that it leaves.
    gap = _gap(before)
    left = max(gap['before'] - gap['null'], 0.0) if before.verdict != 'not_decidable' else 0.0
    weights = np.array([np.exp(-left / 2) if name == NONE else 1.0 for name in standing])
    return tuple(float(one) for one in weights / weights.sum())


def _needed(before: Diagnosed) -> float:
    # The difference of loss that the next diagnosis, with one more recording, needs for a
    # decision.
    gap, about = _gap(before), THRESHOLDS
    count = sum(bool(row.get('used')) for row in before.table['recordings']) + 1
    margin = GROUND_TRUTH.margin if before.table['not_decidable'] else 1.0
    explained = max(gap['before'] - gap['after'], 0.0)
    return margin * count * (about.gain + about.term_cost) + (1 - about.alternative) * explained


def _gap(before: Diagnosed) -> dict[str, float]:
    gap = before.table.get('gap', {})
    try:
        gap = gap.get('loss', gap)  # A diagnosis of schema 1 has it in the gap itself.
        return {key: float(gap[key]) for key in ('before', 'after', 'null')}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f'DIAGNOSIS: diagnosis.json: gap: must have before, after and null, got {shown(gap)}'
        ) from error


def _usecase(before: Diagnosed) -> str:
    usecase = before.table.get('settings', {}).get('usecase')
    if not isinstance(usecase, str):
        raise InputError(
            f'DIAGNOSIS: settings: usecase: must be the mode, got {shown(usecase)}: diagnose again'
        )
    return usecase


def _look_out(possible: Possible, setting: _Setting) -> Outlook | str:
    # The expected value of a recording, or the reason why it cannot be used.
    profile = setting.profile
    found = check(possible.path, profile)
    if not isinstance(found, Found):
        return found
    wrong = nuisances().columns
    base = [c for c in catalogue((), bool(found.mode.modulation_hz))[0] if c.name in wrong]
    of_camera = [
        Column(name, {k: v for k, v in effects.items() if k not in possible.kind.never}, few=False)
        for name, effects in setting.standing.items()
        if effects
    ]
    parts: list[Evidence] = []
    for half, columns in enumerate((base + of_camera, of_camera)):
        one = summarise(found, profile, columns, setting.seed + half, setting.prior, setting.known)
        if isinstance(one, str):
            return one
        parts.append(one)
    return outlook(
        with_true(*parts),
        base + of_camera + true_columns(of_camera),
        setting.names,
        np.array(setting.weights),
        np.array(setting.prior),
        possible.kind.fitted,
        setting.needed,
        setting.seed,
    )


def _table(pairs: Sequence[tuple[Possible, Outlook]], setting: _Setting) -> dict[str, Any]:
    names = list(setting.standing)
    rows = [
        {
            'name': one.name,
            'truth': one.kind.name,
            'words': one.words,
            'bits': expected.bits,
            'right': expected.right,
            'wrong': expected.wrong,
            'undecided': expected.undecided,
            'best_told_apart': [names[i] for i in expected.told_apart],
        }
        for one, expected in pairs
        if not one.repeat
    ]
    repeats = [expected for one, expected in pairs if one.repeat]
    planned = [expected for one, expected in pairs if one.planned is not None]
    baselines = {'random': _mean(planned)}
    if repeats:
        baselines['repeat'] = _mean(repeats)
    return {
        'schema': SCHEMA,
        'explanations': setting.standing,
        'probabilities': dict(zip(names, setting.weights, strict=True)),
        'ranking': rows,
        'baselines': baselines,
        'most_bits': entropy(np.array(setting.weights)),
        'version': __version__,
    }


def _mean(outlooks: Sequence[Outlook]) -> dict[str, float]:
    return {
        key: float(np.mean([getattr(one, key) for one in outlooks]))
        for key in ('bits', 'right', 'wrong', 'undecided')
    }
