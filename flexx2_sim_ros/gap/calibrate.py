"""Calibrate the effects of a diagnosis: give them the form that the recordings show."""

from collections.abc import Sequence
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import check_outputs
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import loadable, parse_effects
from flexx2_sim_ros.effects.patch import COVARIATES
from flexx2_sim_ros.effects.registry import check_map_files
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.features.physical import COUNTED, distance
from flexx2_sim_ros.gap.forms.calibratable import PATTERN, rounds
from flexx2_sim_ros.gap.forms.calibrating import best_of, calibrate_effects, correct, Explained
from flexx2_sim_ros.gap.forms.empirical import NAME
from flexx2_sim_ros.gap.forms.named import Simulator
from flexx2_sim_ros.gap.forms.proposals import totals, Verdict
from flexx2_sim_ros.gap.forms.work import Looked, outcome, Settings
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.improvement import measured
from flexx2_sim_ros.gap.report.age import with_delay
from flexx2_sim_ros.gap.report.calibration_page import FILES, write_calibration
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis, SEEN
from flexx2_sim_ros.gap.work import find, noisier, Progress, stepper
from flexx2_sim_ros.jobs import workers
import numpy as np

SCHEMA = 1
_LEFT_OUT = 'effects_without', 'forms_without'  # of a recording's row in diagnosis.json


def calibrate(
    diagnosis: str | Path,
    campaign_dir: str | Path,
    *,
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """
    Fit curves, maps and parameters of the diagnosed effects to recordings.

    A form is taken only if it brings the simulation nearer to recordings that it was not fitted
    to. Otherwise the effect stays as it was diagnosed.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    campaign_dir : str or pathlib.Path
        A folder of recordings with ``clean_depth``: those of the diagnosis, or others.
    profile : Profile, optional
        The camera; the Flexx2 when left out.
    seed : int
        Of the simulations.
    jobs : int
        Processes.
    out : str or pathlib.Path, optional
        Folder to write ``effects.yaml``, maps, ``calibration.json`` and ``calibration.html`` to,
        and ``diagnosis.json``, so that `check`, `cost` and `walk` can use the folder.
    progress : callable, optional
        Called with what is being done, and the fraction that is done.
    scheduler : str, optional
        Address of a Dask scheduler to work on.

    Returns
    -------
    dict
        As in ``docs/diagnosis.md``.

    Raises
    ------
    InputError
        When something given cannot be used; nothing is written then.

    """
    began = time.monotonic()
    progress = progress or (lambda text, fraction: None)
    if out is not None:
        check_outputs('--out', out, FILES)
        check_map_files(out)
    before = read_diagnosis(Path(diagnosis))
    explanations = _explanations(before)
    folder = Path(campaign_dir).absolute() if scheduler is not None else Path(campaign_dir)
    progress('looking for recordings', 0.0)
    prior = (before.pose_prior[0],) * 3 + (before.pose_prior[1],) * 3
    with workers(jobs, scheduler) as mapped:
        found, left_out = find(folder, profile, mapped, before.full_scale)
        found, noisy = noisier(found, profile, before.noise_factor)
        simulator = Simulator(mapped, noisy, before.known, seed, prior)
        step = stepper(progress, 'looking at the recordings', 0.05, 0.15, len(found))
        items = [(one, explanations[0], None) for one in found]
        looked, unusable = _usable(found, simulator.look(items, step))
        left_out = [*left_out, *unusable]
        _check_number(looked)
        # Besides the forms, the last explanation and each empirical correction are judged.
        judged = sum(map(rounds, explanations)) + 1 + len(COVARIATES)
        total = judged * len(looked)
        step = stepper(progress, 'comparing forms on left-out recordings', 0.2, 0.75, total)
        work = simulator.work(step)
        explained = []
        for place, settings in enumerate(explanations):
            if place:
                again = [one.found for one in looked]
                begun = [(one.found, settings, one.registered) for one in looked]
                looked, gone = _usable(again, simulator.look(begun, lambda: None))
                _check_number(looked)
                left_out = [*left_out, *gone]
            if place and PATTERN in settings and len(_sizes(looked)) > 1:
                continue  # An alternative that cannot be fitted is none.
            _check_sizes(looked, settings)
            explained.append(calibrate_effects(looked, settings, work))
        chosen = explained[best_of(explained)]
        given = NAME in chosen.effects or NAME in before.known
        empirical = None if given else correct(chosen, work)
        effects, now = dict(chosen.effects), chosen.now
        if empirical is not None and empirical.taken:
            form = empirical.proposal
            effects[NAME] = form.together
            now = [{**own, NAME: one} for own, one in zip(now, form.without, strict=True)]
        jobs_of_all = list(zip(chosen.looked, now, strict=True))
        outcomes = simulator.run(outcome, jobs_of_all, lambda: None)
    posed = [one for one in before.effects if one.role == 'pose']
    kept, dropped = ([], posed) if chosen.fits_lens else (posed, [])
    calibrated = with_delay([*kept, *parse_effects(effects)], before.arrival)
    table = _table(explained, chosen, empirical, left_out)
    table['dropped'] = [one.name for one in dropped]
    table['gap'] = _gap(outcomes)
    table['seconds'] = round(time.monotonic() - began, 2)
    table['version'] = __version__
    if out is not None:
        progress('writing', 0.97)
        same = effects == explanations[0]
        write_calibration(
            Path(out),
            table,
            calibrated,
            chosen.verdicts,
            chosen.looked,
            before.table if same else _of_calibration(before.table, chosen.looked),
        )
    progress('done', 1.0)
    return table


def _explanations(before: Diagnosed) -> list[Settings]:
    # The effects of the diagnosis first; then the same with each alternative explanation.
    named = before.effects_to_check()
    out = [table_of(named)]
    for row in before.alternatives():
        kind = loadable()[row.effect.name]
        if kind.role == 'pose' or len(out) > FORMS.others:
            continue
        rest = [one for one in named if one.name not in (*row.instead_of, kind.name, NAME)]
        out.append(table_of([*rest, row.effect]))
    return out


def _usable(
    found: Sequence[Found], outcomes: Sequence[Looked | str]
) -> tuple[list[Looked], list[tuple[str, str]]]:
    # Recordings, and name and reason of those that cannot be used.
    pairs = list(zip(found, outcomes, strict=True))
    return (
        [one for _, one in pairs if isinstance(one, Looked)],
        [(file.path.name, one) for file, one in pairs if isinstance(one, str)],
    )


def _check_number(looked: Sequence[Looked]) -> None:
    if len(looked) < FORMS.fewest:
        raise InputError(
            f'CAMPAIGN: must have at least {FORMS.fewest} recordings, so that one can be left '
            f'out, got {len(looked)}'
        )


def _check_sizes(looked: Sequence[Looked], settings: Settings) -> None:
    # A map has one number for each pixel.
    sizes = _sizes(looked)
    if PATTERN in settings and len(sizes) > 1:
        raise InputError(
            f'CAMPAIGN: must have images of one size, because {PATTERN} gets a map of the image, '
            f'got {" and ".join(f"{width} x {height}" for height, width in sizes)}'
        )


def _sizes(looked: Sequence[Looked]) -> list[tuple[int, ...]]:
    return sorted({one.shape for one in looked})


def _table(
    explained: Sequence[Explained],
    chosen: Explained,
    empirical: Verdict | None,
    left_out: Sequence[tuple[str, str]],
) -> dict[str, Any]:
    tried = {one.proposal.effect for one in chosen.verdicts}
    return {
        'schema': SCHEMA,
        'effects': [one.as_table() for one in chosen.verdicts],
        'unchanged': [name for name in chosen.effects if name not in tried],
        'explanations': [
            {
                'effects': list(one.effects),
                'distance': float(totals(one.apart).mean()),
                'chosen': one is chosen,
            }
            for one in explained
        ],
        'empirical': None if empirical is None else empirical.as_table(),
        'recordings': [one.found.path.name for one in chosen.looked],
        'left_out': [{'name': name, 'reason': reason} for name, reason in left_out],
    }


def _of_calibration(diagnosis: dict[str, Any], looked: Sequence[Looked]) -> dict[str, Any]:
    # diagnosis.json, less the effects as fitted to the other recordings: they have other forms.
    # With the recordings that the forms were fitted to: no check may use them.
    rows = [
        {key: value for key, value in row.items() if key not in _LEFT_OUT}
        for row in diagnosis['recordings']
    ]
    seen = {row['checksum']: row for row in diagnosis.get(SEEN, [])}
    seen |= {
        one.checksum: {'name': one.found.path.name, 'checksum': one.checksum} for one in looked
    }
    return {**diagnosis, 'recordings': rows, SEEN: list(seen.values())}


def _gap(outcomes: Sequence[dict[str, list[float]]]) -> dict[str, Any]:
    # The reduction of the distance in recordings that the forms were not fitted to.
    apart = [[distance({u: one[u][k] for u in COUNTED}) for k in range(3)] for one in outcomes]
    whole = measured(np.array(apart), 1.0)
    return {
        'shrink': whole['shrink'],
        'interval': whole['shrink_interval'],
        **{name: whole[name] for name in ('before', 'after', 'null')},
    }
