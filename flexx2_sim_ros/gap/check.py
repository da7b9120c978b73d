"""Check a diagnosis on recordings that it has never seen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import as_json, check_outputs, write_texts
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects.registry import for_reports
from flexx2_sim_ros.effects.tables import plain
from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.given import given_effects, in_one_table, Table
from flexx2_sim_ros.gap.features.confirm import apart_in, seen_in, simulated
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.features.work import find, noisier, portion, Progress, Simulator, stepper
from flexx2_sim_ros.gap.given_effects import fit_without_and_with, FittedRecordings
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.improvement import measured, tolerances
from flexx2_sim_ros.gap.report.check_page import page
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.gap.report.text import short
from flexx2_sim_ros.jobs import workers
import numpy as np

SCHEMA = 1
FILES = 'check.json', 'check.html'


def check(
    diagnosis: str | Path,
    fresh: str | Path,
    *,
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    pose_prior: tuple[float, float] | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
    known: Table | None = None,
) -> dict[str, Any]:
    """
    Measure the gap of fresh recordings before and after the diagnosed effects are simulated.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written. The effects are those of its ``effects.yaml``.
    fresh : str or pathlib.Path
        A folder of recordings with ``clean_depth``, none of which was part of the diagnosis.
    out : str or pathlib.Path, optional
        Folder to write ``check.json`` and ``check.html`` to.
    profile, seed, jobs, pose_prior, progress, scheduler, known
        As for `diagnose` (default: the diagnosis' own pose prior and known effects).

    Returns
    -------
    dict
        The table that ``docs/diagnosis.md`` describes.

    Raises
    ------
    InputError
        When an input cannot be used; then nothing is written.

    """
    began = time.monotonic()
    if out is not None:
        check_outputs('--out', out, FILES)
    before = read_diagnosis(Path(diagnosis))
    effects = before.effects_to_check()
    given = before.known if known is None else known
    in_one_table(given_effects(given), effects)  # Refuses effects that are in both.
    prior = tuple(np.repeat(before.pose_prior if pose_prior is None else pose_prior, 3))
    progress = progress or (lambda text, fraction: None)
    progress('looking for recordings', 0.0)
    folder = Path(fresh).absolute() if scheduler is not None else Path(fresh)
    with workers(jobs, scheduler) as mapped:
        found, left_out = find(folder, profile, mapped, before.full_scale)
        simulator = Simulator(mapped, profile, given, seed, prior)
        _refuse_seen(before, found, simulator)
        fitted = fit_without_and_with(
            folder,
            found,
            left_out,
            effects,
            simulator,
            before.pose_held or pose_prior is not None,
            portion(progress, 0.05, 0.6),
        )
        noisy, own = noisier(fitted.found, profile, before.noise_factor)
        simulator = replace(simulator, profile=own)
        placed = list(zip(noisy, *fitted.motions(), strict=True))
        step = stepper(progress, 'measuring in physical units', 0.65, 0.33, len(placed))
        physical = simulator.run(_physical, placed, step, effects=table_of(effects))
    values = {'loss': fitted.losses()}
    values.update({unit: np.array([one[unit] for one in physical]) for unit in UNITS})
    least = {'loss': THRESHOLDS.gain, **tolerances(fitted.models[1])}
    measures = {name: measured(some, least[name]) for name, some in values.items()}
    holds, reasons = judged(measures)
    table = {
        'schema': SCHEMA,
        'holds': holds,
        'reasons': reasons,
        'effects': for_reports(table_of(effects)),
        'known': {name: plain(values) for name, values in given.items()},
        'measures': measures,
        'recordings': _recordings(fitted, left_out, values),
        'seconds': round(time.monotonic() - began, 2),
        'version': __version__,
    }
    if out is not None:
        progress('writing', 0.99)
        write_texts(out, dict(zip(FILES, (as_json(table), page(table)), strict=True)))
    progress('done', 1.0)
    return table


def _recordings(
    fitted: FittedRecordings, left_out: Sequence[tuple[str, str]], found: Mapping[str, np.ndarray]
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = [
        {
            'name': one.name,
            'used': True,
            'reason': '',
            'checksum': one.checksum,
            'frames': one.frames,
            'notes': [*file.notes, *one.notes],
            **{name: [float(v) for v in values[i]] for name, values in found.items()},
        }
        for i, (file, one) in enumerate(zip(fitted.found, fitted.evidence, strict=True))
    ]
    return rows + [
        {'name': name, 'used': False, 'reason': reason}
        for name, reason in (*left_out, *fitted.unusable)
    ]


def judged(measures: Mapping[str, Mapping[str, Any]]) -> tuple[bool, list[str]]:
    """
    Return whether a diagnosis holds, and sentences that say why not.

    It holds if the mean loss shrinks by the threshold at which the diagnosis names an effect, and
    no physical measure gets significantly worse.
    """
    reasons, loss = [], measures['loss']
    if loss['change'] > -loss['tolerance']:
        reasons.append(
            f'The loss of the diagnosis changes by {loss["change"]:+.3g} per recording; the gap '
            f'shrinks if it changes by less than {-loss["tolerance"]:g}.'
        )
    for unit in UNITS:
        if measures[unit]['worse']:
            before, after = (short(measures[unit][key], 3) for key in ('before', 'after'))
            reasons.append(f'{unit} gets significantly worse: {before} to {after}.')
    return not reasons, reasons


def _refuse_seen(before: Diagnosed, found: Sequence[Found], simulator: Simulator) -> None:
    # Recordings are compared by checksum, because two recordings may have the same name. Names are
    # compared only where the diagnosis has no checksums.
    seen = []
    for file, checksum in zip(found, simulator.run(_checksum, found), strict=True):
        name = file.path.name
        if checksum in before.checksums:
            seen.append(f'{unquoted(name)} (there {unquoted(before.checksums[checksum])})')
        elif name in before.unsummed:
            seen.append(f'{unquoted(name)} (by its name; the diagnosis has no checksums)')
    if seen:
        more = f' and {len(seen) - 3} more' if len(seen) > 3 else ''
        raise InputError(
            'FRESH: must be recordings that the diagnosis has not seen, got '
            f'{", ".join(seen[:3])}{more}'
        )


def _checksum(found: Found, profile: Profile | None, **_: Any) -> str:
    try:
        return read(found, profile).checksum
    except InputError:  # Its summary says why.
        return ''


def _physical(
    job: tuple[Found, np.ndarray, np.ndarray],
    profile: Profile | None,
    effects: dict[str, dict[str, float]],
    seed: int,
    known: Table,
) -> dict[str, list[float]]:
    # Each of `UNITS` of a recording: before, after, and the difference of two simulations with the
    # effects. Motions are fitted without and with the effects: neither simulation is compared at
    # the pose that suits the other one. All simulations have common random numbers.
    found, *motions = job
    recording = read(found, profile, known)
    gaps = []
    for motion, table in zip(motions, ({}, effects), strict=True):
        scene = PlacedScene.at(recording, motion)
        depths = recording.depth, *simulated(scene, table, seed)
        real, *some = (seen_in(scene, depth, effects) for depth in depths)
        gaps.append(apart_in(real, some, some).physical)
    before, after = gaps
    return {unit: [before[unit][0], *after[unit][1:]] for unit in UNITS}
