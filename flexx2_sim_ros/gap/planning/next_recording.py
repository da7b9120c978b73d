"""Rank recordings by how well they would decide what a diagnosis leaves open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import Camera, flexx2, Profile
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.gap.data.given import at_size, given_effects, Table
from flexx2_sim_ros.gap.data.hidden import hidden_effects
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.simulation import PlacedScene, with_uptime
from flexx2_sim_ros.gap.features.work import find, Progress, Simulator, stepper, summarise_all
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.planning.forecast import (
    check_open,
    DiagnosedRecordings,
    expect,
    Explanation,
    what_is_known,
)
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.truths import ALL_KINDS, smaller, TruthKind, write_recording
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.jobs import bind, here, Map, workers
from flexx2_sim_ros.recording import load_scene
import numpy as np

SCHEMA = 3
_SHOWN = 3  # number of suggestions with images
_ENOUGH = 0.9  # expected fraction right from which on one set-up is enough
_COMBINED = 4  # set-ups that are combined in pairs
_FRAMES = 12  # of a scene of the user's own that stands still
_AS_TOLD = TruthKind('own', 'as the file says', fitted=True)  # Registration finds its errors.
_REPLACED = 'depth', 'usecase', 'amplitude'  # keys of a scene's file


@dataclass(frozen=True, eq=False)
class Possible:
    """
    A recording that could be made next: a name for tables, and words what to set up.

    `path` is its simulated recording, or an existing one. `known` are effects of the camera in
    images of this size, parameters by name. `planned` is the planned recording, if it comes from
    the plan; `repeat`: it repeats an existing recording. `expected` is the expected decision after
    it, and `pair` are its summaries with two seeds, once it was simulated.
    """

    name: str
    words: str
    kind: TruthKind
    path: Path
    known: Table
    planned: PlannedRecording | None = None
    repeat: bool = False
    expected: Mapping[str, float] = field(default_factory=dict)
    pair: tuple[Evidence, ...] = ()

    @property
    def named(self) -> dict[str, str]:
        """Return name and ground truth, for tables."""
        return {'name': self.name, 'truth': self.kind.name}


@dataclass(frozen=True)
class PredictedView:
    """
    The images that each explanation predicts for a recording, (N, H, W) each.

    * `error`: mean of measured minus clean depth, metres; NaN where one of them is missing.
    * `noise`: standard deviation of that error over frames, metres; NaN as in `error`.
    * `valid`: fraction of frames with a depth; NaN where the ground truth is unknown.
    """

    possible: Possible
    error: np.ndarray
    noise: np.ndarray
    valid: np.ndarray


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
    chosen = _kinds_named(kinds or usual_kinds(before.table))
    plan = replace(plan, usecase=_usecase(before))
    with tempfile.TemporaryDirectory() as name, workers(jobs, None) as mapped:
        folder = Path(name)
        progress('reading the recordings', 0.0)
        known, repeated = _known(before, campaign, camera, seed, mapped, progress)
        given = known.simulator.known
        told = camera, given, seed
        possible = _of_plan(folder, plan, chosen, *told)
        own = [
            _of_scene(folder / f'own_{i}.npz', Path(scene), plan.usecase, *told)
            for i, scene in enumerate(scenes)
        ]
        again = [
            Possible(one.path.name, 'recorded before', _AS_TOLD, one.path, given, repeat=True)
            for one in repeated
        ]
        possible += [*own, *again]
        step = stepper(progress, 'simulating recordings', 0.2, 0.6, len(possible))
        outcomes = mapped(bind(_look_out, known=known), possible, step)
        for one, outcome in zip(possible, outcomes, strict=True):
            if one in own and isinstance(outcome, str):
                raise InputError(f'--scene: must be a usable scene, got {one.name}: {outcome}')
        rows = [one for one in outcomes if isinstance(one, Possible)]
        rows.sort(key=lambda row: _order(row.expected))
        new = [row for row in rows if not row.repeat]
        if not new:
            why = next((one for one in outcomes if isinstance(one, str)), 'none suits the truth')
            raise InputError(f'--plan: must have a recording that can be used, got none: {why}')
        best, expected = _suggestion(new, known, mapped, progress)
        first = [*best, *(row for row in new if row not in best)][:_SHOWN]
        views = [_look(row, known.standing, camera, seed) for row in first]
    return _table(rows, best, expected, known.standing), views


def _order(expected: Mapping[str, float]) -> tuple[float, float]:
    return -expected['right'], expected['wrong']


def _suggestion(
    new: Sequence[Possible], known: DiagnosedRecordings, mapped: Map, progress: Progress
) -> tuple[Sequence[Possible], Mapping[str, float]]:
    # The first set-up if that is enough, otherwise the best pair of the first few.
    if new[0].expected['right'] >= _ENOUGH or len(new) == 1:
        return new[:1], new[0].expected
    sets = list(combinations(new[:_COMBINED], 2))
    step = stepper(progress, 'combining recordings', 0.8, 0.2, len(sets))
    expected = mapped(bind(_together, known=known), sets, step)
    return min(zip(sets, expected, strict=True), key=lambda pair: _order(pair[1]))


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
    diagnosed = {row['name'] for row in before.table['recordings'] if row.get('used')}
    missing = sorted(diagnosed - {one.path.name for one in found})
    if missing:
        raise InputError(
            f'CAMPAIGN: must have the recordings that were diagnosed, got no {shown(missing[0])}'
        )
    without = {row['name'] for row in before.table.get('not_considered', [])}
    modulation = bool(found[0].mode.modulation_hz)
    columns, _ = catalogue(without, modulation)
    text = 'simulating what could explain the recordings'
    step = stepper(progress, text, 0.0, 0.2, len(found))
    prior = tuple(np.repeat(before.pose_prior, 3))
    simulator = Simulator(mapped, camera, given, seed, prior, columns)
    used, evidence, _ = summarise_all(campaign, found, left_out, simulator, step)
    hidden = tuple(one for one in hidden_effects(campaign) if one.effect not in without)
    simulator = replace(simulator, mapped=here)  # It is sent to other processes.
    told = simulator, (frozenset(without), modulation), hidden, before.pose_held
    known = what_is_known(DiagnosedRecordings(tuple(evidence), *told))
    if len(known.standing) < 2:
        name = known.standing[0].name
        raise InputError(f'DIAGNOSIS: must leave something open, got only {name}')
    return known, used


def _usecase(before: Diagnosed) -> str:
    usecase = before.table.get('settings', {}).get('usecase')
    if not isinstance(usecase, str):
        raise InputError(
            f'DIAGNOSIS: settings: usecase: must be the mode, got {shown(usecase)}: diagnose again'
        )
    return usecase


def usual_kinds(table: Mapping[str, Any]) -> list[str]:
    """Return the kinds of ground truth that the recordings of a ``diagnosis.json`` suggest."""
    truths = [row.get('truth') or {} for row in table['recordings'] if row.get('used')]
    kinds = ['tape', 'laser'] if any(one.get('planes') for one in truths) else []
    if any(one.get('pose') is not None and not one.get('planes') for one in truths):
        kinds.append('scan')
    return kinds or ['exact']


def _kinds_named(names: Sequence[str]) -> list[TruthKind]:
    by_name = {kind.name: kind for kind in ALL_KINDS}
    for name in names:
        if name not in by_name:
            raise InputError(f'--truth: must be among {", ".join(by_name)}, got {shown(name)}')
    return [by_name[name] for name in dict.fromkeys(names)]


def _of_plan(
    folder: Path, plan: Plan, kinds: Sequence[TruthKind], profile: Profile, known: Table, seed: int
) -> list[Possible]:
    # Writes the plan's recordings with each kind of ground truth that suits them.
    lens = smaller(profile.intrinsics, plan.scale)
    known = at_size(known, lens.height, lens.width)
    out = []
    for kind in kinds:
        for planned in filter(kind.suits, plan.recordings):
            path = folder / f'{planned.name}_{kind.name}.npz'
            write_recording(path, plan, planned, profile, kind, known, seed)
            out.append(Possible(planned.name, planned.set_up, kind, path, known, planned))
    return out


def _of_scene(
    written: Path, scene_file: Path, usecase: str, profile: Profile, known: Table, seed: int
) -> Possible:
    # Writes a simulated recording of a scene of the user; errors name the scene's file.
    scene = load_scene(scene_file)
    clean, stamp = scene.clean_depth, scene.stamp
    count = len(clean) if clean.ndim == 3 else _FRAMES
    if stamp is None or len(stamp) != count:
        stamp = np.arange(count) / profile.mode(usecase).rate_hz
    known = at_size(known, *clean.shape[-2:])
    device = Camera(usecase, profile=profile, effects=given_effects(known), seed=seed)
    depth = device.capture(clean, scene.K, stamp, scene.reflectivity).depth
    extra = scene.extra if clean.ndim == 3 else _of_still_scene(scene.extra)
    arrays: dict[str, Any] = {key: value for key, value in extra.items() if key not in _REPLACED}
    if scene.reflectivity is not None:
        arrays['reflectivity'] = scene.reflectivity
    arrays |= {'clean_depth': clean, 'K': scene.K, 'stamp': stamp, 'depth': depth}
    np.savez(written, **arrays, usecase=np.array(usecase))
    found = check(written, profile)
    if not isinstance(found, Found):
        raise InputError(found.replace(str(written), shown_path(scene_file)))
    words = f'the scene of {shown_path(scene_file)}'
    return Possible(scene_file.name, words, _AS_TOLD, written, known)


def _of_still_scene(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    # What belongs to single frames becomes that of the scene: it is simulated in another number
    # of frames.
    out = {key: value for key, value in arrays.items() if key != 'received'}
    if 'uptime' in out and out['uptime'].ndim == 1:
        out['uptime'] = out['uptime'][0]
    if 'known' in out and out['known'].ndim == 3:
        out['known'] = np.asarray(out['known'].all(axis=0))
    for key in ('clean_sigma', 'reflectivity_spread'):
        if key in out and out[key].ndim == 3:
            out[key] = out[key].max(axis=0)
    return out


def _look_out(possible: Possible, known: DiagnosedRecordings) -> Possible | str:
    # A recording with what is expected of it, or the reason why it cannot be used.
    told, never = known.simulator, possible.kind.never
    found = check(possible.path, told.profile)
    if not isinstance(found, Found):
        return found
    own = {one.name for one in known.standing if one.effects}
    columns = [
        # What the ground truth always hides shifts nothing.
        replace(c, effects={k: v for k, v in c.effects.items() if k not in never})
        if c.name in own
        else c
        for c in told.columns
    ]
    told = replace(told, columns=columns, known=possible.known)
    pair: list[Evidence] = []
    for seed in (told.seed, told.seed + 1):
        (one,) = replace(told, seed=seed).summaries([found])
        if isinstance(one, str):
            return one
        pair.append(one)
    simulated = replace(possible, pair=tuple(pair))
    return replace(simulated, expected=_together([simulated], known))


def _together(rows: Sequence[Possible], known: DiagnosedRecordings) -> dict[str, float]:
    # What is expected when these set-ups are recorded twice each.
    fitted = any(row.kind.fitted for row in rows)
    return expect(known, [row.pair for row in rows], fitted)


def _table(
    rows: Sequence[Possible],
    first: Sequence[Possible],
    expected: Mapping[str, float],
    standing: Sequence[Explanation],
) -> dict[str, Any]:
    baselines = {
        'random': [row.expected for row in rows if row.planned is not None],
        'repeat': [row.expected for row in rows if row.repeat],
    }
    return {
        'schema': SCHEMA,
        'explanations': {one.name: one.effects for one in standing},
        'probabilities': {one.name: float(one.weight) for one in standing},
        'suggestion': {'record': [row.named for row in first], **expected},
        'ranking': [
            {**row.named, 'words': row.words, **row.expected} for row in rows if not row.repeat
        ],
        'baselines': {
            name: {key: float(np.mean([one[key] for one in some])) for key in expected}
            for name, some in baselines.items()
            if some
        },
        'version': __version__,
    }


def _look(
    possible: Possible, standing: Sequence[Explanation], profile: Profile, seed: int
) -> PredictedView:
    # Simulates a recording with each explanation that stands.
    found = check(possible.path, profile)
    if not isinstance(found, Found):
        raise InputError(found)
    one = read(found, profile, possible.known)
    scene, images = PlacedScene.at(one, np.zeros(POSE)), []
    for explanation in standing:
        depth = scene.simulate(with_uptime(explanation.effects, one.uptime), seed)
        images.append(_images(depth - one.clean, np.isfinite(depth), one.truth.known))
    error, noise, valid = (np.array(some) for some in zip(*images, strict=True))
    return PredictedView(possible, error, noise, valid)


def _images(
    error: np.ndarray, seen: np.ndarray, known: np.ndarray | None
) -> tuple[np.ndarray, ...]:
    # (H, W) mean and standard deviation of (T, H, W) errors over frames, and the fraction of
    # frames with one; NaN where there is none or the ground truth is unknown.
    known = np.broadcast_to(True if known is None else known, seen.shape)
    errors, valid = np.ma.array(error, mask=~(seen & known)), np.ma.array(seen, mask=~known)
    images = errors.mean(axis=0), errors.std(axis=0), valid.mean(axis=0)
    return tuple(np.ma.filled(image.astype(float), np.nan) for image in images)
