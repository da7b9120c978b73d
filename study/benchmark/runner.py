"""Record each case, diagnose it and store the answer."""

from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import replace
import datetime
import hashlib
import importlib
import json
from pathlib import Path
import time
import traceback
from typing import Any

from flexx2_sim_ros import __version__, processes
from flexx2_sim_ros.atomic import output_folder, scratch_folder, whole, write_text
from flexx2_sim_ros.errors import InputError
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from study.benchmark.answers import code_digest, not_answered
from study.benchmark.baselines import all_baselines
from study.benchmark.design import make_design, Planned
from study.benchmark.many import contributions
from study.benchmark.realised import realised_gap
from study.benchmark.scoring import score, Scores
from study.benchmark.sealing import seal, Sealed
from study.benchmark.seeds import seed_range
from study.benchmark.truth import Comparison
from study.blind import BlindCamera, SceneSet
from study.blind.partial_truth import hide_truth

DIAGNOSE = 'flexx2_sim_ros.gap:diagnose'
MEASURE = 'flexx2_sim_ros.gap:measure'


def run_benchmark(
    out: Path,
    *,
    quick: bool = False,
    seed_set: str = 'dev',
    release: bool = False,
    jobs: int = 1,
    diagnoser: str = DIAGNOSE,
    measurer: str = MEASURE,
    limit: int | None = None,
    earlier: Scores | None = None,
    console: Console | None = None,
) -> Scores | None:
    """
    Run the cases of a benchmark that have no result yet; score it when all have one.

    * `out`: folder of the results; ``out/sealed`` has the labels, ``out/cache`` rendered scenes.
      An interrupted run resumes.
    * `seed_set`: ``dev`` or ``test``
    * `release`: allows the test seeds
    * `diagnoser`, `measurer`: ``module:function`` of `diagnose` and `measure`
    * `limit`: stop after this many new cases
    * `earlier`: an earlier part of the run, from `read_answers`: its cases are not run again

    Returns the scores without those of the earlier part; None when cases are missing. Raises
    InputError for test seeds without a release, a folder of another benchmark, or an earlier part
    that is of another run.
    """
    if jobs < 1:
        raise InputError(f'--jobs: must be at least 1, got {jobs}')
    facts = {
        'seed_set': seed_set,
        'quick': quick,
        'version': __version__,
        'code': code_digest(),
        'date': datetime.datetime.now(datetime.UTC).strftime('%Y-%m-%d %H:%M UTC'),
    }
    design = not_answered(make_design(seed_range(seed_set, release), quick), earlier, facts)
    results = output_folder(out / 'results')
    sealed = seal(design, out / 'sealed', out, facts)
    left = [name for name in sealed.cases if not (results / f'{name}.json').is_file()]
    left = left[:limit]
    _run(out, sealed, left, jobs, diagnoser, measurer, console or Console(stderr=True))
    if any(not (results / f'{name}.json').is_file() for name in sealed.cases):
        return None
    return score(out)


def _run(
    out: Path,
    sealed: Sealed,
    left: list[str],
    jobs: int,
    diagnoser: str,
    measurer: str,
    console: Console,
) -> None:
    bar = Progress(
        TextColumn('diagnosing'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn('{task.fields[note]}'),
        console=console,
    )
    done_before = sum((out / 'results' / f'{name}.json').is_file() for name in sealed.cases)
    with bar:
        task = bar.add_task('', total=len(sealed.cases), note='', completed=done_before)
        failures = 0

        def done(failed: bool) -> None:
            nonlocal failures
            failures += failed
            bar.update(task, advance=1, note=f'{failures} failed' if failures else '')

        calls = [(out, name, sealed.cases[name].to_json(), diagnoser, measurer) for name in left]
        if jobs == 1:
            for call in calls:
                done(run_case(*call))
            return
        with processes.workers(jobs, one_thread=True) as submit:
            for future in as_completed(submit(_run_call, calls)):
                done(future.result())


def _run_call(call: tuple[Path, str, dict[str, Any], str, str]) -> bool:
    return run_case(*call)


def run_case(out: Path, name: str, label: dict[str, Any], diagnoser: str, measurer: str) -> bool:
    """
    Record and diagnose one case and store the answer.

    The diagnosis gets a folder of recordings with an opaque name, and nothing else. Returns
    whether the diagnosis raised an error, which is stored and counts as wrong.
    """
    planned = Planned.from_json(label)
    # The same in every run, unlike the salted name; it does not reveal the seed of the camera.
    seed = int(hashlib.sha256(f'diagnosis/{planned.seed}'.encode()).hexdigest()[:7], 16)
    cache = out / 'cache'
    result: dict[str, Any] = {'error': None, 'diagnosis': None, 'baselines': {}, 'realised': None}
    with scratch_folder() as scratch:
        folder = scratch / f'campaign-{name}'
        folder.mkdir()
        _make(out, name, planned, folder, cache)
        start, cpu = time.perf_counter(), time.process_time()
        try:
            result['diagnosis'] = _function(diagnoser)(
                folder, without=planned.without, seed=seed, jobs=1
            )
        except Exception:  # noqa: B902 - any error is the answer of the diagnosis
            result['error'] = traceback.format_exc(limit=20)
        result['seconds'] = time.perf_counter() - start
        result['cpu_seconds'] = time.process_time() - cpu
        if planned.baselines:
            result['baselines'] = all_baselines(folder, seed)
    if planned.realise and result['diagnosis'] and result['diagnosis'].get('effects'):
        try:
            result['realised'] = realised_gap(
                planned, result['diagnosis'], cache, _function(measurer)
            )
        except Exception:  # noqa: B902 - effects that cannot be simulated are an answer, too
            result['error'] = traceback.format_exc(limit=20)
    _write(out / 'results' / f'{name}.json', result)
    return result['error'] is not None


def _make(out: Path, name: str, planned: Planned, folder: Path, cache: Path) -> None:
    case = planned.case
    camera = BlindCamera(case, SceneSet(case.scenes, cache))
    comparison = Comparison(camera)
    camera.record(folder, comparison.watch, planned.only or None)
    if planned.only:
        others = sorted(set(range(planned.recordings)) - set(planned.only))
        BlindCamera(replace(case, effects={}), camera.scenes).record(folder, only=others)
    if planned.hidden:
        hide_truth(folder, planned.seed)
    truth = out / 'sealed' / 'truth'
    output_folder(truth)
    with whole(truth / f'{name}.npz') as part:
        np.savez_compressed(part, **comparison.affected())  # type: ignore[arg-type]
    _write(
        truth / f'{name}.json',
        {
            'parameters': {effect.name: effect.parameters for effect in camera.effects},
            'sigma_factor': camera.sigma_factor,
            'contributions': contributions(planned, cache) if planned.group == 'many' else {},
        },
    )


def _write(path: Path, value: dict[str, Any]) -> None:
    # Written whole or not at all: an existing file is a finished case.
    write_text(path, json.dumps(value, default=lambda one: one.tolist()))  # NumPy's values


def _function(reference: str) -> Callable[..., Any]:
    module, name = reference.split(':')
    return getattr(importlib.import_module(module), name)
