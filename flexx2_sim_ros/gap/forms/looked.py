"""The work on single recordings, for processes of their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.frames import at_frame, of_frames
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.data.prior import spread_of
from flexx2_sim_ros.gap.data.registration import RecordingData, register
from flexx2_sim_ros.gap.features.confirm import confirm, Outcome
from flexx2_sim_ros.gap.features.physical import (
    distances,
    fine_side,
    histogram,
    Measures,
    mismatch,
)
from flexx2_sim_ros.gap.features.simulation import PlacedScene, with_uptime
from flexx2_sim_ros.gap.forms.bias_fit import own_motion
from flexx2_sim_ros.gap.forms.binned import (
    Binned,
    KINDS,
    lost_in,
    NOISE,
    noise_in,
    pixel_errors,
    pixels_lost,
)
from flexx2_sim_ros.gap.forms.geometry import slopes_of
from flexx2_sim_ros.gap.forms.samples import Samples, samples_of, shift_alike, shift_of, shifters
from flexx2_sim_ros.gap.forms.scale import columns_of, ScaleColumns
import numpy as np

Settings = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Looked:
    """
    What is needed of a recording.

    * `registered`: (6 + 3 P,) its pose and planes before anything is known of its effects.
    * `samples`: errors on surfaces.
    * `binned`, `typical`: by effect of `binned.KINDS`: what its curve is the mean of, measured and
      simulated with the effects as diagnosed.
    * `shifts`: (N,) metres that each effect as diagnosed changes in the samples.
    * `uptime`: seconds since power-on at the first frame.
    * `shape`: height and width of its images.
    * `apart`: how far it is from its simulation with the effects as diagnosed; see `judge`.
    """

    found: Found
    registered: np.ndarray
    samples: Samples
    binned: dict[str, Binned]
    typical: dict[str, Binned]
    shifts: dict[str, np.ndarray]
    uptime: float | None
    shape: tuple[int, ...]
    apart: dict[str, float]


def look(
    job: tuple[Found, Settings, np.ndarray | None],
    profile: Profile | None,
    known: Table,
    prior: tuple[float, ...],
    seed: int,
) -> Looked | str:
    """
    Register a recording, and take samples, counts and what its effects change.

    With a motion, the recording is registered already, about there. The result is the reason if
    the recording cannot be used.
    """
    found, effects, begin = job
    try:
        recording = read(found, profile, known)
    except InputError as error:
        return str(error)
    own = with_uptime(effects, recording.uptime)
    if begin is None:
        begin, _ = register(recording, np.array(prior))
    motion, spread, scene = registered(recording, np.array(prior), own, begin)
    samples, shifts = _samples(scene, motion, spread, own)
    simulated = replace(recording, depth=scene.simulate(own, seed))
    measured, expected = (_measured(scene, one.depth) for one in (recording, simulated))
    lost = lost_in(scene), lost_in(replace(scene, recording=simulated))
    noise = noise_in(measured, expected, own)
    binned, typical = ({**dict.fromkeys(KINDS, lost[i]), NOISE: noise[i]} for i in (0, 1))
    return Looked(
        found,
        begin,
        samples,
        binned,
        typical,
        shifts,
        recording.uptime,
        recording.depth.shape[1:],
        _apart(measured, expected),
    )


def look_again(
    job: tuple[Looked, Settings], profile: Profile | None, known: Table, **_: Any
) -> Looked:
    """Return a recording with samples and shifts as they are with other settings of effects."""
    scene, motion, own = _settled(*job, profile, known)
    samples, shifts = _samples(scene, motion, job[0].samples.spread, own)
    return replace(job[0], samples=samples, shifts=shifts)


def look_at_pixels(
    job: tuple[Looked, Settings], profile: Profile | None, known: Table, **_: Any
) -> np.ndarray:
    """Return the errors of a recording's pixels that given settings of effects do not explain."""
    scene, _motion, own = _settled(*job, profile, known)
    return pixel_errors(scene, own)


def look_at_lost(
    job: tuple[Looked, Settings], profile: Profile | None, known: Table, **_: Any
) -> np.ndarray:
    """Return which share of the frames each pixel of a recording is lost in."""
    scene, _motion, _own = _settled(*job, profile, known)
    return pixels_lost(scene)


def look_at_scale(
    job: tuple[Looked, str], profile: Profile | None, known: Table, **_: Any
) -> ScaleColumns:
    """Return how the depth of a recording's samples changes with an effect's scale."""
    looked, effect = job
    scene = PlacedScene.at(read(looked.found, profile, known), looked.samples.motion)
    return columns_of(scene, looked.samples, effect)


def judge(
    job: tuple[Looked, Sequence[Settings]],
    profile: Profile | None,
    known: Table,
    seed: int,
    frames: int | None = None,
    settle_once: bool = False,
) -> list[dict[str, float]]:
    """
    Simulate a recording's scene with several settings of effects; return how far both are apart.

    Each settings get the pose that suits them best, and the same random numbers. With ``frames``
    only so many first frames are compared. With ``settle_once``, all settings get the pose that
    suits the first ones. Each result is `physical.distances` in small tiles, and ``mismatch``,
    which is `physical.mismatch`.
    """
    looked, several = job
    recording = _first_frames(read(looked.found, profile, known), frames)
    moving = recording.clean.ndim == 3
    out: list[dict[str, float]] = []
    before: Settings | None = None
    for effects in several:
        own = with_uptime(effects, recording.uptime)
        alike = before is not None and (settle_once or shift_alike(effects, before, moving))
        if not alike:
            scene = _settle_again(looked, recording, own)[1]
            real = _measured(scene, recording.depth)
        before = effects
        out.append(_apart(real, _measured(scene, scene.simulate(own, seed))))
    return out


def confirm_settled(
    job: tuple[Looked, Settings, Settings, bool, np.ndarray | None],
    profile: Profile | None,
    known: Table,
    seed: int,
) -> tuple[Outcome, np.ndarray]:
    """
    Compare a recording with its simulation, at the pose that suits the effects; see `confirm`.

    Return what is left of the gap, and (6 + 3 P,) this pose and the planes.
    """
    looked, effects, wrong, show, bare = job
    scene, motion, _ = _settled(looked, effects, profile, known)
    return confirm(scene, effects, wrong, seed, show, bare), motion


def _first_frames(recording: RecordingData, count: int | None) -> RecordingData:
    if count is None or len(recording.depth) <= count:
        return recording
    first = np.arange(count)
    return replace(
        recording,
        depth=recording.depth[:count],
        clean=at_frame(recording.clean, first),
        reflectivity=at_frame(recording.reflectivity, first),
        stamp=recording.stamp[:count],
        fresh=recording.fresh[:count],
        truth=of_frames(recording.truth, first),
    )


def _apart(real: Measures, simulated: Measures) -> dict[str, float]:
    return {**distances(real, simulated), 'mismatch': mismatch(real, simulated)}


def _measured(scene: PlacedScene, depth: np.ndarray) -> Measures:
    return histogram(depth, scene.covariates, scene.sums(depth), fine_side(len(depth)))


def registered(
    recording: RecordingData, prior: np.ndarray, effects: Settings, begin: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, PlacedScene]:
    """
    Find where the camera was if it has these effects, from the recording alone.

    Return the (6 + 3 P,) motion, its standard deviations as from `prior.factor`, and the scene
    there. `prior` is (6,) standard deviations of a pose whose covariance the recording does not
    give, metres and degrees; `begin` a motion that was found already.
    """
    # `_settle` corrects what the effects did to this motion, so it need not know them.
    if begin is None:
        begin, _ = register(recording, prior)
    spread = spread_of(recording.truth, prior)
    motion, scene = _settle(recording, begin, begin, spread, effects)
    return motion, spread, scene


def _settled(
    looked: Looked, effects: Settings, profile: Profile | None, known: Table
) -> tuple[PlacedScene, np.ndarray, Settings]:
    # The scene at the pose that suits the effects, this pose, and what the recording can have.
    recording = read(looked.found, profile, known)
    own = with_uptime(effects, recording.uptime)
    motion, scene = _settle_again(looked, recording, own)
    return scene, motion, own


def _settle_again(
    looked: Looked, recording: RecordingData, effects: Settings
) -> tuple[np.ndarray, PlacedScene]:
    samples = looked.samples
    if not shifters(effects, recording.clean.ndim == 3):  # It is settled already.
        return samples.motion, PlacedScene.at(recording, samples.motion)
    return _settle(recording, looked.registered, samples.motion, samples.spread, effects)


def _settle(
    recording: RecordingData,
    begin: np.ndarray,
    motion: np.ndarray,
    spread: np.ndarray,
    effects: Settings,
) -> tuple[np.ndarray, PlacedScene]:
    # Where the camera was if it has these effects, by a few steps of Gauss and Newton from
    # ``motion``. What surfaces leave open stays as in ``begin``, which is as from `register`.
    scene = PlacedScene.at(recording, motion)
    for _ in range(FORMS.steps):
        samples = samples_of(scene, motion, spread)
        motion = own_motion(samples, samples.error - _at_samples(scene, samples, effects), begin)
        scene = PlacedScene.at(recording, motion)
    return motion, scene


def _samples(
    scene: PlacedScene, motion: np.ndarray, spread: np.ndarray, effects: Settings
) -> tuple[Samples, dict[str, np.ndarray]]:
    # The samples of a recording, less what given effects change there, and `Looked.shifts`.
    samples = samples_of(scene, motion, spread)
    given = _at_samples(scene, samples, {})
    shifts = {
        name: _at_samples(scene, samples, {name: values}) - given
        for name, values in effects.items()
    }
    slopes = slopes_of(scene, samples.place, effects)
    return replace(samples, error=samples.error - given, slopes=slopes), shifts


def _at_samples(scene: PlacedScene, samples: Samples, effects: Settings) -> np.ndarray:
    return np.asarray(shift_of(scene, effects).ravel()[samples.place], np.float64)
