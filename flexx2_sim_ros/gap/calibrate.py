"""Calibrate the effects of a diagnosis: give them the form that the recordings show."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import check_outputs
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms.calibrating import calibratable, calibrate_effects, PATTERN, Verdict
from flexx2_sim_ros.gap.forms.work import judge, look, look_at_pixels, Looked, Settings
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.report.calibration_page import FILES, write_calibration
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.gap.work import find, Progress, stepper
from flexx2_sim_ros.jobs import bind, workers
import numpy as np

SCHEMA = 1


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
    Fit curves and maps of the diagnosed effects to recordings.

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
        Folder to write ``effects.yaml``, maps, ``calibration.json`` and ``calibration.html`` to.
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
    before = read_diagnosis(Path(diagnosis))
    effects = _to_calibrate(before)
    settings = table_of(effects)
    folder = Path(campaign_dir).absolute() if scheduler is not None else Path(campaign_dir)
    progress('looking for recordings', 0.0)
    metres, degrees = before.pose_prior
    fixed: dict[str, Any] = {'profile': profile, 'known': before.known}
    with workers(jobs, scheduler) as mapped:
        found, left_out = find(folder, profile, mapped)
        if len(found) < FORMS.fewest:
            raise InputError(
                f'CAMPAIGN: must have at least {FORMS.fewest} recordings, so that one can be left '
                f'out, got {len(found)}'
            )
        work = bind(
            look, effects=settings, prior=(metres,) * 3 + (degrees,) * 3, seed=seed, **fixed
        )
        step = stepper(progress, 'looking at the recordings', 0.05, 0.35, len(found))
        looked = mapped(work, found, step)
        _check_sizes(looked, settings)
        rounds = (len(calibratable(settings)) + 1) * len(looked)
        step = stepper(progress, 'comparing forms on left-out recordings', 0.4, 0.55, rounds)

        def judged(some: Sequence[tuple[Looked, Settings]]) -> np.ndarray:
            return np.array(mapped(bind(judge, seed=seed, **fixed), some, step))

        def pixels(some: Sequence[tuple[Looked, Settings]]) -> Any:
            return mapped(bind(look_at_pixels, **fixed), some, lambda: None)

        verdicts = calibrate_effects(looked, settings, judged, pixels)
    calibrated = _calibrated(before.effects, verdicts)
    table = _table(verdicts, looked, left_out, settings)
    table['seconds'] = round(time.monotonic() - began, 2)
    table['version'] = __version__
    if out is not None:
        progress('writing', 0.97)
        write_calibration(Path(out), table, calibrated, verdicts, looked)
    progress('done', 1.0)
    return table


def _to_calibrate(before: Diagnosed) -> tuple[Effect, ...]:
    effects = before.effects_to_check()
    if not calibratable(table_of(effects)):
        names = ', '.join(effect.name for effect in effects)
        raise InputError(
            f'DIAGNOSIS: must have an effect that can have a curve or map, got {names}'
        )
    return effects


def _check_sizes(looked: Sequence[Looked], settings: Settings) -> None:
    # A map has one number for each pixel.
    sizes = sorted({one.shape for one in looked})
    if PATTERN in settings and len(sizes) > 1:
        raise InputError(
            f'CAMPAIGN: must have images of one size, because {PATTERN} gets a map of the image, '
            f'got {" and ".join(f"{width} x {height}" for height, width in sizes)}'
        )


def _calibrated(effects: Sequence[Effect], verdicts: Sequence[Verdict]) -> list[Effect]:
    # As diagnosed, but for the forms that are taken.
    forms = {one.proposal.effect: one.proposal.together for one in verdicts if one.taken}
    return [replace(effect, **forms.get(effect.name, {})) for effect in effects]


def _table(
    verdicts: Sequence[Verdict],
    looked: Sequence[Looked],
    left_out: Sequence[tuple[str, str]],
    settings: Settings,
) -> dict[str, Any]:
    rows: list[dict[str, Any]] = [
        {
            'name': one.proposal.effect,
            'form': one.proposal.label,
            'taken': one.taken,
            'before': float(one.before.mean()),
            'after': float(one.after.mean()),
            'recordings_better': int((one.after < one.before).sum()),
        }
        for one in verdicts
    ]
    tried = {row['name'] for row in rows}
    return {
        'schema': SCHEMA,
        'effects': rows,
        'unchanged': [name for name in settings if name not in tried],
        'recordings': [one.found.path.name for one in looked],
        'left_out': [{'name': name, 'reason': reason} for name, reason in left_out],
    }
