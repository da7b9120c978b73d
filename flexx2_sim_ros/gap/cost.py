"""What a gap costs: the errors that it makes in what reads depth on a robot."""

from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
import math
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import as_json, check_outputs, write_texts
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.consumers.comparison import compare, parts, QUANTILES
from flexx2_sim_ros.consumers.loading import ConsumerSource, sources
from flexx2_sim_ros.consumers.running import Result, run
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.effects.registry import for_reports
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.gap.data.campaign import Found, nothing_left
from flexx2_sim_ros.gap.features.work import find, Progress, Simulator, stepper
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.renditions import Known, render
from flexx2_sim_ros.gap.report.cost_page import page
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.limits import check_whole, CONSUMER_SECONDS
import numpy as np

SCHEMA = 1
FILES = 'cost.json', 'cost.html'
_HIGHEST, _STEEPEST = 10.0, 80.0  # of a camera: metres and degrees
_RANKED = 'part', 'share'


def cost(
    campaign_dir: str | Path,
    diagnosis: str | Path,
    *,
    consumers: Collection[str] = (),
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    mounting: tuple[float, float] | None = None,
    limit: float = CONSUMER_SECONDS,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """
    Measure what a gap costs, in the units of what reads depth on a robot.

    Each consumer runs in a process of its own: a script that calls this needs
    ``if __name__ == '__main__':``.

    Parameters
    ----------
    campaign_dir : str or pathlib.Path
        A folder of recordings with ``clean_depth``: those of the diagnosis, or others.
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    consumers : collection of str
        Names, or files and classes such as ``my.py:Grid`` (default: all that are installed).
    out : str or pathlib.Path, optional
        Folder to write ``cost.json`` and ``cost.html`` to.
    mounting : tuple of float, optional
        Height of the camera above the ground, metres, and angle by which it looks down, degrees
        (default: the ground is found in the ground truth).
    limit : float
        Seconds that a consumer may take for a recording.
    profile, seed, jobs, progress
        As for `diagnose`.

    Returns
    -------
    dict
        The table that ``docs/robots.md`` describes.

    Raises
    ------
    InputError
        When an input cannot be used; then nothing is written.

    """
    began = time.monotonic()
    progress = progress or (lambda text, fraction: None)
    _check(seed, jobs, limit, mounting)
    if out is not None:
        check_outputs('--out', out, FILES)
    request = CostRequest(*found_consumers(consumers), jobs, mounting, limit)
    before = read_diagnosis(Path(diagnosis))
    known = known_of(before)
    progress('looking for recordings', 0.0)
    with workers(jobs, None) as mapped:
        found, left_out = find(campaign_dir, profile, mapped, before.full_scale)
        prior = tuple(np.repeat(before.pose_prior, 3).tolist())
        simulator = Simulator(mapped, profile, before.known, seed, prior)
        table, results = measure_cost(
            request, known, campaign_dir, found, left_out, simulator, progress
        )
    table['seconds'] = round(time.monotonic() - began, 2)
    table['version'] = __version__
    if out is not None:
        progress('writing', 0.99)
        files = as_json(table), page(table, results)
        write_texts(out, dict(zip(FILES, files, strict=True)))
    progress('done', 1.0)
    return table


@dataclass(frozen=True)
class CostRequest:
    """How a cost is measured; see `cost`. `damaged` are installed packages that cannot be read."""

    consumers: Sequence[ConsumerSource]
    damaged: Sequence[str]
    jobs: int
    mounting: tuple[float, float] | None = None
    limit: float = CONSUMER_SECONDS


def found_consumers(names: Collection[str]) -> tuple[list[ConsumerSource], list[str]]:
    """Return consumers, all that are installed if none is named, and the damaged packages."""
    damaged: list[str] = []
    return sources(names, lambda name, error: damaged.append(unquoted(name))), damaged


def measure_cost(
    request: CostRequest,
    known: Known,
    campaign: str | Path,
    found: Sequence[Found],
    left_out: Sequence[tuple[str, str]],
    simulator: Simulator,
    progress: Progress,
) -> tuple[dict[str, Any], list[Result]]:
    """
    Run the consumers on recordings and on their simulations, and compare.

    Return the table of ``docs/robots.md`` without ``seconds`` and ``version``, and what the
    consumers made of the recordings. `campaign` is for errors; `left_out` has the name of each
    recording that was left out before, and the reason. Raises `InputError` when no recording can
    be used.
    """
    told = {'prior': simulator.prior, 'diagnosed': known, 'mounting': request.mounting}
    step = stepper(progress, 'simulating the recordings', 0.02, 0.6, len(found))
    rendered = simulator.run(render, found, step, **told)
    both = list(zip(found, rendered, strict=True))
    left_out = [*left_out, *((file.path.name, one) for file, one in both if isinstance(one, str))]
    used = [one for one in rendered if not isinstance(one, str)]
    if not used:
        raise nothing_left(Path(campaign), left_out)
    chosen, views = request.consumers, [one for one, _ in used]
    step = stepper(progress, 'running the consumers', 0.62, 0.36, len(chosen) * len(used))
    with ThreadPoolExecutor(request.jobs) as pool:  # Each thread waits for one process.
        results = list(pool.map(lambda source: run(source, views, request.limit, step), chosen))
    rows: list[dict[str, Any]] = [
        {'name': one.name, 'used': True, 'reason': '', 'effects_from': whence}
        for one, whence in used
    ]
    rows += [{'name': name, 'used': False, 'reason': reason} for name, reason in left_out]
    table = {
        'schema': SCHEMA,
        'effects': for_reports(known.effects),
        **compared(results, list(known.effects)),
        'damaged_packages': list(request.damaged),
        'recordings': rows,
        'settings': {
            'seed': simulator.seed,
            'mounting': request.mounting and list(request.mounting),
            'limit': request.limit,
            'delay': known.delay,
        },
    }
    return table, results


def compared(results: Sequence[Result], effects: Sequence[str]) -> dict[str, Any]:
    """
    Return ``consumers``, ``faults`` and ``ranking`` of the table in ``docs/robots.md``.

    `effects` are the names of the renditions with one effect each; `results` has one for each
    consumer.
    """
    good = [one for one in results if not one.fault]
    rows: list[dict[str, Any]] = []
    for one in good:
        first = {'name': one.label, 'title': one.title}
        rows.append({**first, 'measures': _measures(one, effects), 'seconds': one.seconds})
    return {
        'consumers': rows,
        'faults': [{'consumer': one.label, 'reason': one.fault} for one in results if one.fault],
        'ranking': _ranking(good, rows, effects),
    }


def _ranking(
    good: Sequence[Result], rows: Sequence[dict[str, Any]], effects: Sequence[str]
) -> list[dict[str, Any]]:
    differ = [
        (result, one)
        for result, row in zip(good, rows, strict=True)
        for one in row['measures']
        if one['significant']
    ]
    if not differ:
        return []
    drawn = [parts(result.errors, one['name'], effects) for result, one in differ]
    mean = np.mean(drawn, axis=0)  # (sets of recordings, effects)
    ranking = []
    for k, name in enumerate(effects):
        low, high = np.quantile(mean[:, k], QUANTILES)
        lead = np.quantile(mean[:, [k]] - mean, QUANTILES[0], axis=0)
        own = [one['effects'][name] for _, one in differ]
        means = {key: float(np.clip([one[key] for one in own], -1, 1).mean()) for key in _RANKED}
        row = {'effect': name, **means, 'interval': [float(low), float(high)]}
        row['ahead_of'] = [effects[int(i)] for i in np.flatnonzero(lead > 0)]
        ranking.append({**row, 'measures': len(differ)})
    return sorted(ranking, key=lambda row: -row['part'])


def _measures(result: Result, effects: Sequence[str]) -> list[dict[str, Any]]:
    found = (
        (name, unit, compare(result.errors, name, effects))
        for name, unit in result.measures.items()
    )
    return [{'name': name, 'unit': unit, **asdict(one)} for name, unit, one in found if one]


def known_of(before: Diagnosed) -> Known:
    """
    Return what a diagnosis knows of its camera and its recordings.

    Raises `InputError` when it has no effects of the camera.
    """
    effects = before.effects_to_check()
    without = {}
    used = [row for row in before.table['recordings'] if row.get('used')]
    for row in used if len(used) > 1 else []:  # A single recording cannot be left out.
        own, forms = row.get('effects_without'), row.get('forms_without', {})
        parts = isinstance(own, dict) and isinstance(forms, dict)
        if not parts or not isinstance(row.get('checksum'), str):
            continue
        left = {one.name: one for one in parse_effects({**own, **forms}) if one.role != 'pose'}
        alike = left.keys() == {one.name for one in effects} and all(
            left[one.name].forms.keys() == one.forms.keys() for one in effects
        )
        if alike:  # Maps have none.
            without[row['checksum']] = table_of(left.values())
    delay = time_offset_of(parse_effects(before.known)).delay_ns / 1e9
    if before.arrival is not None:
        delay = before.arrival.median
    return Known(table_of(effects), frozenset(before.checksums), without, delay)


def _check(seed: int, jobs: int, limit: float, mounting: tuple[float, float] | None) -> None:
    check_whole('seed', seed, 0)
    check_whole('jobs', jobs, 1)
    if not 0 < limit < math.inf:
        raise InputError(f'limit: must be seconds above 0, got {shown(limit)}')
    if mounting is not None:
        height, pitch = mounting
        if not (0 < height < _HIGHEST and abs(pitch) <= _STEEPEST):
            raise InputError(
                f'mounting: must be metres above 0 and below {_HIGHEST:g}, and degrees from '
                f'-{_STEEPEST:g} to {_STEEPEST:g}, got {shown(mounting)}'
            )
