"""Which recording would settle what a diagnosis leaves open."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import flexx2, Intrinsics, Profile
from flexx2_sim_ros.effects import of_role, registry
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.data.given import given_effects
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue, Column, nuisances, Term
from flexx2_sim_ros.gap.features.evidence import gather
from flexx2_sim_ros.gap.features.simulation import simulate
from flexx2_sim_ros.gap.inference.fitting import fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.planning.scenes import render, Scene, standard_scenes
from flexx2_sim_ros.gap.report.reading import Diagnosed, read_diagnosis
from flexx2_sim_ros.jobs import bind, workers
import numpy as np

Table = dict[str, dict[str, float]]
SCHEMA = 1
_FRAMES = 12
_SCALE = 0.5  # of the image: separations are to be compared, not to be exact
_NONE = 'none of them'


@dataclass(frozen=True)
class _Setting:
    # What all scenes are simulated with.
    usecase: str
    profile: Profile
    known: Mapping[str, Mapping[str, float]]
    prior: tuple[float, ...]
    seed: int


def suggest(
    diagnosis: str | Path,
    *,
    profile: Profile | None = None,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """
    Rank scenes by what a recording of them would tell about a diagnosis that is open.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    profile : Profile, optional
        The camera; the Flexx2 when left out.
    seed : int
        Of the simulations.
    jobs : int
        Processes.
    progress : callable, optional
        Called with what is being done, and the fraction that is done.

    Returns
    -------
    dict
        As ``next.json`` in ``docs/diagnosis.md``.

    Raises
    ------
    InputError
        When the diagnosis cannot be read or leaves nothing open.

    """
    before = read_diagnosis(Path(diagnosis))
    try:
        standing = explanations(before)
    except (KeyError, TypeError) as error:
        raise InputError(
            f'DIAGNOSIS: diagnosis.json: must be as flexx2 gap diagnose writes it, got no '
            f'{shown(error.args[0])}'
        ) from error
    camera = profile or flexx2()
    usecase = before.table.get('settings', {}).get('usecase')
    if not isinstance(usecase, str):
        raise InputError(
            f'DIAGNOSIS: settings: usecase: must be the mode, got {shown(usecase)}: diagnose again'
        )
    metres, degrees = before.pose_prior
    prior = (metres,) * 3 + (degrees,) * 3
    setting = _Setting(usecase, camera, before.known, prior, seed)
    scenes = standard_scenes(camera, camera.mode(usecase).range_max)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress('simulating scenes', done / len(scenes))

    with workers(jobs, None) as mapped:
        separations = mapped(bind(separation, setting=setting, standing=standing), scenes, step)
    rows = [
        _row(scene, found, list(standing))
        for scene, found in zip(scenes, separations, strict=True)
    ]
    return {
        'schema': SCHEMA,
        'explanations': standing,
        'ranking': sorted(rows, key=lambda row: -row['bits']),
        'most_bits': float(np.log2(len(standing))),
        'version': __version__,
    }


def explanations(before: Diagnosed) -> dict[str, Table]:
    """
    Return the sets of effects that are still possible, by a name for people.

    These are the effects that were chosen, each alternative in the place of what it replaces, each
    effect that the ground truth could not decide, at its typical strength, and none of them.

    Raises
    ------
    InputError
        When there is nothing to decide.

    """
    table, pose = before.table, of_role('pose').name
    chosen = {row['name']: row['parameters'] for row in table['effects']}
    sets = [chosen]
    for row in table['alternatives']:
        kept = {k: v for k, v in chosen.items() if k not in row['instead_of']}
        sets.append({**kept, row['name']: row['parameters']})
    sets += [
        {**chosen, row['name']: registry()[row['name']]().settings}
        for row in table['not_decidable']
    ]
    sets.append({})
    out: dict[str, Table] = {}
    for one in sets:
        effects = {name: dict(values) for name, values in one.items() if name != pose}
        out.setdefault(' + '.join(effects).replace('_', ' ') or _NONE, effects)
    if before.verdict == 'identified' and not (table['alternatives'] or table['not_decidable']):
        raise InputError('DIAGNOSIS: must leave something open, got one explanation: check it')
    if len(out) < 2:
        raise InputError(
            'DIAGNOSIS: must have alternatives or effects that are not decidable, got verdict '
            f'{shown(before.verdict)} without any'
        )
    return out


def separation(scene: Scene, setting: _Setting, standing: Mapping[str, Table]) -> np.ndarray:
    """
    Return how far explanations are apart in a recording of a scene.

    Parameters
    ----------
    scene : Scene
        What is recorded.
    setting : _Setting
        The camera and the diagnosis' settings.
    standing : mapping
        Effects by explanation.

    Returns
    -------
    numpy.ndarray
        (N, N) the diagnosis' loss of the difference of each pair, in which the pose, the
        brightness, edges and sigma are fitted.

    """
    wanted = nuisances().columns
    mode = setting.profile.mode(setting.usecase)
    columns = [c for c in catalogue((), bool(mode.modulation_hz))[0] if c.name in wanted]
    columns += [Column(name, table, few=False) for name, table in standing.items() if table]
    prior = np.array(setting.prior)
    model = Model(
        [gather(_recording(scene, setting), columns, setting.seed, prior)], columns, prior
    )
    shifts = [
        model.predict([_as_it_is(name)], np.ones((1, 1)))[0] if table else np.zeros((1, 1))
        for name, table in standing.items()
    ]
    out = np.zeros((len(shifts), len(shifts)))
    for i, one in enumerate(shifts):
        for j, other in enumerate(shifts[:i]):
            difference = np.broadcast_to(one - other, model.gap.shape)
            out[i, j] = out[j, i] = fit(model.as_if(difference), []).inside
    return out


def information(separations: np.ndarray) -> float:
    """
    Return the bits that a recording tells about explanations that are equally likely before.

    The lower bound of Kolchinsky and Tracey (Entropy 19, 361, 2017) for a mixture of normal
    distributions with one covariance, whose squared distances the separations stand for.

    Parameters
    ----------
    separations : numpy.ndarray
        (N, N) from `separation`.

    """
    return float(-np.log2(np.exp(-separations / 8).mean(axis=1)).mean())


def _as_it_is(name: str) -> Candidate:
    return Candidate(name, '', (Term(name, ((1.0, name),), 1.0, 1.0),), lambda values: {})


def _row(scene: Scene, separations: np.ndarray, names: list[str]) -> dict[str, Any]:
    i, j = np.unravel_index(int(separations.argmax()), separations.shape)
    return {
        'scene': scene.name,
        'words': scene.words,
        'bits': information(separations),
        'best_told_apart': sorted([names[i], names[j]]),
        'separations': separations.tolist(),
    }


def _recording(scene: Scene, setting: _Setting) -> RecordingData:
    # As the base simulator would record it.
    mode, lens = setting.profile.mode(setting.usecase), setting.profile.intrinsics
    matrix = lens.matrix.copy()
    matrix[:2] *= _SCALE
    matrix[:2, 2] += (_SCALE - 1) / 2
    small = Intrinsics.from_matrix(matrix, round(lens.width * _SCALE), round(lens.height * _SCALE))
    small = replace(small, distortion=lens.distortion)
    stamp = np.arange(_FRAMES) / mode.rate_hz
    clean, reflectivity = render(scene, small, stamp)
    fresh = np.zeros(_FRAMES, bool)
    fresh[0] = True
    recording = RecordingData(
        scene.name,
        np.broadcast_to(clean, (_FRAMES, *clean.shape[-2:])).copy(),
        clean,
        reflectivity,
        matrix,
        np.rint(stamp * 1e9).astype(np.int64),
        fresh,
        scene.uptime,
        mode,
        setting.profile,
        given=given_effects(setting.known, scene.uptime),
    )
    # Another seed than those that it is compared with.
    depth = simulate(recording, clean, reflectivity, (), setting.seed * 1000 + 900)
    return replace(recording, depth=depth)
