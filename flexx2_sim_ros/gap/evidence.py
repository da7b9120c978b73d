"""One recording boiled down: what it shows, what the simulator shows, what each effect changes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.camera import Mode, Profile
from flexx2_sim_ros.gap.catalogue import Column, DRIFT_TAUS, NEEDS_MOTION
from flexx2_sim_ros.gap.covariates import look_at, Scene
from flexx2_sim_ros.gap.features import (
    accumulate,
    EXPECT,
    features,
    INVERSE,
    lattice_peak,
    lattice_spectrum,
    LAYOUT,
    SIZE,
    static_grain,
    Sums,
    VALID,
)
from flexx2_sim_ros.gap.measures import histogram, Measures
from flexx2_sim_ros.gap.pose import (
    base_camera,
    fit_plane_motion,
    moved,
    pose_effects,
    STEPS,
)
import numpy as np

MOST_FRAMES = 48
_EDGE_PIXELS = 0.4
_AT_EDGES, _AT_BENDS = (np.array([f.axis == axis for f in LAYOUT])
                        for axis in ('edge', 'concavity'))
_SEGMENT = 12
NULL_SEEDS = 4
# What else shifts whole surfaces, when the pose is looked for.
_LENS = dict.fromkeys(('focal', 'cx', 'cy', 'k1'), 0.0)
_NOT_POSE: tuple[dict[str, dict[str, float]], ...] = (
    {'multipath': {}}, {'stray_light': {}},
    *({'intrinsics_error': {**_LENS, name: value}}
      for name, value in (('focal', 0.005), ('cx', 0.7), ('cy', 0.7), ('k1', -0.01))))
_GRAIN = next(i for i, f in enumerate(LAYOUT) if f.channel == 'static_grain')
_ENOUGH_ALIKE = 12  # samples, where the random numbers are the same
_FEW = 8  # frames where a few are enough
_FEWEST = 5  # for a bias or a loss, which add no noise
_BIASES = frozenset({'along_ray', 'offset', 'wiggling', 'amplitude_bias', 'multipath',
                     'stray_light', 'intrinsics_error', 'pose_error', 'low_signal_dropout',
                     'grazing_dropout', 'saturation'})


@dataclass(frozen=True)
class Take:
    """
    What is needed of a recording.

    Attributes
    ----------
    name : str
        The file's.
    depth : numpy.ndarray
        (T, H, W) float32 metres, NaN where invalid.
    clean : numpy.ndarray
        (H, W) or (T, H, W) float32.
    reflectivity : numpy.ndarray or None
        Like ``clean``.
    K : numpy.ndarray
    stamp : numpy.ndarray
        (T,) int64 nanoseconds.
    fresh : numpy.ndarray
        (T,) bool, frames that do not follow the one before.
    uptime : float or None
        Mean seconds since power-on.
    mode : Mode
    profile : Profile or None

    """

    name: str
    depth: np.ndarray
    clean: np.ndarray
    reflectivity: np.ndarray | None
    K: np.ndarray  # noqa: N815
    stamp: np.ndarray
    fresh: np.ndarray
    uptime: float | None
    mode: Mode
    profile: Profile | None


@dataclass
class Evidence:
    """
    A recording's summary; all that is decided is decided from these.

    Attributes
    ----------
    name : str
    real, base, base_variance, noise : numpy.ndarray
        (SIZE,) features of the recording; mean of those of the base simulator, the variance of
        that mean; the variance of one simulated recording.
    nulls : numpy.ndarray
        (S, SIZE) the single simulations.
    columns : numpy.ndarray
        (C, SIZE) float32, what each simulated effect changes.
    pose_columns : numpy.ndarray
        (6, SIZE) per step of `pose.STEPS`.
    displaced : numpy.ndarray
        (SIZE,) variance from edges that are known to a part of a pixel only.
    pose : numpy.ndarray
        (6,) metres and degrees: how the real camera was moved, as first fitted.
    uptime : float or None
    step : float
        Lattice step that stands out, metres.
    grain, null_grain : numpy.ndarray
        (H, W) float16 static pattern in sigma, of the recording and of a simulated one.
    measures, base_measures : Measures
    sigma, counts : numpy.ndarray
        (BINS,) mean sigma_z, metres; pixels looked at.
    frames, moving : int, bool

    """

    name: str
    real: np.ndarray
    base: np.ndarray
    base_variance: np.ndarray
    noise: np.ndarray
    nulls: np.ndarray
    columns: np.ndarray
    pose_columns: np.ndarray
    displaced: np.ndarray
    pose: np.ndarray
    uptime: float | None
    step: float
    grain: np.ndarray
    null_grain: np.ndarray
    measures: Measures
    base_measures: list[Measures]
    sigma: np.ndarray
    counts: np.ndarray
    frames: int
    moving: bool


def scenes_of(take: Take, clean: np.ndarray, reflectivity: np.ndarray | None) -> list[Scene]:
    """Return the covariates of each frame, or of the one there is."""
    if clean.ndim == 2:
        return [look_at(clean, None, 0.0, reflectivity, take.K, take.mode)]
    out = []
    for t, image in enumerate(clean):
        # The first of a segment is compared with the one after it.
        other = t - 1 if not take.fresh[t] else min(t + 1, len(clean) - 1)
        interval = float(take.stamp[t] - take.stamp[other]) * 1e-9
        forward = interval < 0
        scene = look_at(image, clean[other] if interval else None, abs(interval),
                        None if reflectivity is None else
                        reflectivity if reflectivity.ndim == 2 else reflectivity[t],
                        take.K, take.mode)
        if forward:
            scene.bins[..., 8] = -1
        out.append(scene)
    return out


def register(take: Take, prior: np.ndarray) -> np.ndarray:
    """Return the small motion that best explains a recording, (6,) metres and degrees."""
    still = take.clean.ndim == 2
    chosen = [0] if still else sorted({round(x) for x in np.linspace(0, len(take.depth) - 1, 6)})
    pose = np.zeros(6)
    for _ in range(2):
        clean, reflectivity = moved(
            take.clean if still else take.clean[chosen],
            take.reflectivity if still or take.reflectivity is None
            or take.reflectivity.ndim == 2 else take.reflectivity[chosen],
            take.K, take.mode, pose)
        others = _typical_biases(take, clean, reflectivity, chosen)
        errors, depths, sigmas = [], [], []
        for i, t in enumerate(chosen):
            image = clean if still else clean[i]
            scene = look_at(image, None, 0.0, None, take.K, take.mode)
            with np.errstate(invalid='ignore'):
                if still:
                    count = np.isfinite(take.depth).sum(axis=0)
                    real = np.nansum(take.depth, axis=0) / np.maximum(count, 1)
                    real = np.where(count > 0.5 * len(take.depth), real, np.nan)
                else:
                    real = take.depth[t]
                error = real - image
                limit = 8 * scene.sigma + 0.02
                errors.append(np.where(scene.inside & (np.abs(error) < limit), error, np.nan))
            depths.append(image)
            sigmas.append(scene.sigma)
        step = fit_plane_motion(np.array(errors), np.array(depths), np.array(sigmas), take.K,
                                prior, others)
        pose = np.clip(pose + step, -3 * prior, 3 * prior)
    return pose


def _typical_biases(take: Take, clean: np.ndarray, reflectivity: np.ndarray | None,
                    chosen: Sequence[int]) -> np.ndarray:
    # (N, n, H, W) metres, without any noise of their own; and, if it moves, being 10 ms late.
    base, *changed = (
        base_camera(take.mode, take.profile, 0, effects).capture(
            clean, take.K, take.stamp[list(chosen)], reflectivity).depth
        for effects in ((), *_NOT_POSE))
    biases = [np.nan_to_num(one - base) for one in changed]
    if take.clean.ndim == 3:
        late = []
        for t in chosen:
            start, end = max(t - 1, 0), min(t + 1, len(take.clean) - 1)
            with np.errstate(invalid='ignore', divide='ignore'):
                change = take.clean[end] - take.clean[start]
                seconds = np.float32((take.stamp[end] - take.stamp[start]) * 1e-9)
                late.append(np.where(np.abs(change) < 0.1 * take.clean[t],
                                     np.float32(-0.010) * change / seconds, 0))
        biases.append(np.array(late))
    return np.stack(biases, axis=1)


def simulate(take: Take, clean: np.ndarray, reflectivity: np.ndarray | None, effects: Any,
             seed: int, part: np.ndarray | None = None) -> np.ndarray:
    """Return (T, H, W) depth as the simulator sees the recording's scene."""
    camera = base_camera(take.mode, take.profile, seed, effects)
    index = np.arange(len(take.depth)) if part is None else part
    return camera.capture(clean if clean.ndim == 2 else clean[index], take.K, take.stamp[index],
                          reflectivity if reflectivity is None or reflectivity.ndim == 2
                          else reflectivity[index]).depth


def with_uptime(effects: dict[str, dict[str, float]], uptime: float | None) -> dict[str, Any]:
    """Return effects with the recording's own time since power-on."""
    if 'warm_up_drift' not in effects or uptime is None:
        return effects
    return {**effects, 'warm_up_drift': {**effects['warm_up_drift'], 'uptime': uptime}}


def gather(take: Take, columns: Sequence[Column], seed: int, prior: np.ndarray) -> Evidence:
    """
    Look at a recording and simulate everything that could explain it.

    Parameters
    ----------
    take : Take
        The recording.
    columns : sequence of Column
        What to simulate.
    seed : int
        Of the simulations.
    prior : numpy.ndarray
        (6,) standard deviations of the pose error, metres and degrees.

    """
    pose = register(take, prior)
    clean, reflectivity = moved(take.clean, take.reflectivity, take.K, take.mode, pose)
    scenes = scenes_of(take, clean, reflectivity)
    moving = clean.ndim == 3
    warm = warm_of(take.fresh)
    real_sums = accumulate(take.depth, scenes, take.fresh, warm)
    null_sums, base_measures = [], []
    for k in range(NULL_SEEDS):
        depth = simulate(take, clean, reflectivity, (), seed * 1000 + k)
        null_sums.append(accumulate(depth, scenes, take.fresh, warm))
        base_measures.append(histogram(depth, scenes, null_sums[-1]))
    spectrum = np.mean([lattice_spectrum(one) for one in null_sums], axis=0)
    real, _ = features(real_sums, spectrum)
    pairs = [features(one, spectrum) for one in null_sums]
    nulls = np.array([values for values, _ in pairs])
    analytic = np.mean([variance for _, variance in pairs], axis=0)
    noise = _pooled_variance(nulls, analytic)

    simulated = [_Part(take, clean, reflectivity, scenes, frames, seed * 1000, spectrum, warm)
                 for frames in (_few_frames(take.fresh, moving, _FEWEST),
                                _few_frames(take.fresh, moving, _FEW),
                                np.arange(len(take.depth)))]
    shifts = np.zeros((len(columns), SIZE), np.float32)
    for i, column in enumerate(columns):
        if moving or not NEEDS_MOTION & column.effects.keys():
            kind = 0 if column.effects.keys() <= _BIASES else 1 if column.few else 2
            shifts[i] = simulated[kind].shift(with_uptime(column.effects, take.uptime))
            if kind == 1:  # Grain is noise that is left, and the more so the fewer frames.
                shifts[i, _GRAIN] *= nulls[0, _GRAIN] / max(simulated[1].base[_GRAIN], 1e-9)
    steps = np.array([[simulated[0].shift(pose_effects(i, sign)) for sign in (1, -1)]
                      for i in range(6)])
    pose_columns = (steps[:, 0] - steps[:, 1]) / 2
    return Evidence(
        take.name, real, nulls.mean(axis=0), noise / NULL_SEEDS, noise, nulls, shifts,
        pose_columns, _displaced(steps[3:5], take.K), pose, take.uptime,
        lattice_peak(lattice_spectrum(real_sums), spectrum)[1],
        static_grain(real_sums).astype(np.float16), static_grain(null_sums[0]).astype(np.float16),
        histogram(take.depth, scenes, real_sums), base_measures,
        _mean_sigma(real_sums), real_sums.bins[:, EXPECT].astype(np.float32), len(take.depth),
        moving)


class _Part:
    """Some of a recording's frames, to simulate effects on with the same random numbers."""

    def __init__(self, take: Take, clean: np.ndarray, reflectivity: np.ndarray | None,
                 scenes: list[Scene], frames: np.ndarray, seed: int, spectrum: np.ndarray,
                 warm: int) -> None:
        self._simulate = lambda effects: simulate(take, clean, reflectivity, effects, seed, frames)
        self._scenes = [scenes[t] for t in frames] if len(scenes) > 1 else scenes
        self._fresh = take.fresh[frames].copy()
        self._fresh[1:] |= np.diff(frames) != 1
        self._spectrum = spectrum
        self._warm = warm
        self.base = self._features(())

    def _features(self, effects: Any) -> np.ndarray:
        lattice = not effects or (isinstance(effects, dict) and 'quantisation' in effects)
        sums = accumulate(self._simulate(effects), self._scenes, self._fresh, self._warm, lattice,
                          len(self._scenes) > 1)
        return features(sums, self._spectrum, _ENOUGH_ALIKE)[0]

    def shift(self, effects: Any) -> np.ndarray:
        """Return what the effects change, 0 where that cannot be said."""
        return np.nan_to_num(self._features(effects) - self.base)


def _displaced(steps: np.ndarray, K: np.ndarray) -> np.ndarray:  # noqa: N803
    # Variance of features when each edge lies elsewhere by what no common motion takes off (warped
    # clean depth has no parallax): from what a step of pitch and yaw either way, (2, 2, SIZE),
    # changes. Near edges that nobody marked (sharp bends) only what is the same both ways.
    pixels = np.radians(STEPS[3:5]) * [K[1, 1], K[0, 0]]
    scale = np.square(_EDGE_PIXELS / pixels)
    whole = (scale[:, None] * np.square(steps).mean(axis=1)).mean(axis=0)
    even = (scale[:, None] * np.square(steps.mean(axis=1))).mean(axis=0)
    return np.where(_AT_EDGES, whole, np.where(_AT_BENDS, even, 0)).astype(np.float32)


def drift_factors(uptime: float | None) -> list[float]:
    """Return what share of the bias at power-on is left, for each of `DRIFT_TAUS`."""
    return [0.0 if uptime is None else float(np.exp(-uptime / tau)) for tau in DRIFT_TAUS]


def warm_of(fresh: np.ndarray) -> int:
    """Return how many frames a camera gets to settle in after each gap."""
    return 2 if len(fresh) >= 6 and fresh.sum() <= len(fresh) / 6 else 0


def _mean_sigma(sums: Sums) -> np.ndarray:
    with np.errstate(invalid='ignore', divide='ignore'):
        # Harmonic: a bias in metres is this times its mean in sigma.
        return (sums.bins[:, VALID] / sums.bins[:, INVERSE]).astype(np.float32)


def _pooled_variance(nulls: np.ndarray, analytic: np.ndarray) -> np.ndarray:
    # Few seeds say little about one feature, and much about how far all of its kind are from
    # what independent pixels would give.
    found = nulls.var(axis=0, ddof=1)
    with np.errstate(invalid='ignore'):
        blend = 0.5 * analytic + 0.5 * np.where(np.isfinite(found), found, analytic)
    return np.maximum(blend, 0.25 * analytic)


def _few_frames(fresh: np.ndarray, moving: bool, few: int) -> np.ndarray:
    count = len(fresh)
    if count <= few + 2:
        return np.arange(count)
    if not moving:
        return np.arange(few)
    half = few // 2 + 2
    middle = max(count // 2, half)
    return np.concatenate([np.arange(half), np.arange(middle, min(middle + half, count))])


def choose_frames(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which frames of a long recording are looked at, and which of these start afresh."""
    if count <= MOST_FRAMES:
        fresh = np.zeros(count, bool)
        fresh[:1] = True
        return np.arange(count), fresh
    starts = np.linspace(0, count - _SEGMENT, MOST_FRAMES // _SEGMENT).astype(int)
    chosen = np.unique(np.concatenate([np.arange(s, s + _SEGMENT) for s in starts]))
    fresh = np.ones(len(chosen), bool)
    fresh[1:] = np.diff(chosen) != 1
    return chosen, fresh


__all__ = ['Evidence', 'Sums', 'Take', 'choose_frames', 'gather', 'register', 'simulate']
