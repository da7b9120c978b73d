"""One recording boiled down: what it shows, what the simulator shows, what each effect changes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import ageing, Effect, loadable
from flexx2_sim_ros.gap.calibration.constants import FEATURES, SIMULATION
from flexx2_sim_ros.gap.data.covariates import Axes, look_at, PixelCovariates
from flexx2_sim_ros.gap.data.planes import PLANE_STEPS
from flexx2_sim_ros.gap.data.pose import base_camera, pose_effects
from flexx2_sim_ros.gap.data.prior import covariance_of, POSE
from flexx2_sim_ros.gap.data.registration import place, Placed, RecordingData, register
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.features import (
    accumulate,
    features,
    lattice_peak,
    lattice_spectrum,
    LAYOUT,
    SIZE,
    static_grain,
    Sums,
)
from flexx2_sim_ros.gap.features.grain import fingerprint
from flexx2_sim_ros.gap.features.kernels import EXPECT, INVERSE, VALID
from flexx2_sim_ros.gap.features.physical import histogram, Measures
from flexx2_sim_ros.recording.truth import Accuracy, accuracy_of
import numpy as np

_AT_EDGES, _AT_BENDS = (
    np.array([f.axis == axis for f in LAYOUT]) for axis in ('edge', 'concavity')
)
_GRAIN = next(i for i, f in enumerate(LAYOUT) if f.channel == 'static_grain')


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
    edge_columns : numpy.ndarray
        (2, SIZE) per pixel by which edges lie lower (as with pitch) or farther right (yaw).
    displaced : numpy.ndarray
        (SIZE,) variance from edges that are known to a part of a pixel only.
    plane_columns : numpy.ndarray
        (3 P, SIZE) per step of `planes.PLANE_STEPS`, of planes known within bounds only.
    truth_spread : numpy.ndarray
        (SIZE,) what errors of the ground truth as large as its standard deviation change.
    pose : numpy.ndarray
        (6,) metres and degrees: how the real camera was moved, as first fitted.
    sure_pose : numpy.ndarray
        (6,) what of it is beyond doubt.
    planes : numpy.ndarray
        (3 P,) metres and radians: how the planes were moved, as first fitted.
    covariance : numpy.ndarray or None
        Of both, as from `prior.covariance_of`.
    uptime : float or None
        Mean seconds since power-on.
    step : float
        Lattice step that stands out, metres.
    grain, null_grain : numpy.ndarray
        (H, W) float16 static pattern in sigma, of the recording and of a simulated one.
    fingerprint : numpy.ndarray
        (N,) float16 the first frame's noise; see `grain.fingerprint`.
    measures, base_measures : Measures
    sigma, counts : numpy.ndarray
        (BINS,) mean sigma_z, metres; pixels looked at.
    frames, moving : int, bool
    notes : tuple of str
        What of the recording was converted or assumed.
    axes : dict of str to Axis
        The camera's.
    accuracy : Accuracy
        Of its ground truth.

    """

    name: str
    real: np.ndarray
    base: np.ndarray
    base_variance: np.ndarray
    noise: np.ndarray
    nulls: np.ndarray
    columns: np.ndarray
    pose_columns: np.ndarray
    edge_columns: np.ndarray
    displaced: np.ndarray
    plane_columns: np.ndarray
    truth_spread: np.ndarray
    pose: np.ndarray
    sure_pose: np.ndarray
    planes: np.ndarray
    covariance: np.ndarray | None
    uptime: float | None
    step: float
    grain: np.ndarray
    null_grain: np.ndarray
    fingerprint: np.ndarray
    measures: Measures
    base_measures: list[Measures]
    sigma: np.ndarray
    counts: np.ndarray
    frames: int
    moving: bool
    notes: tuple[str, ...]
    axes: Axes
    accuracy: Accuracy


def scenes_of(recording: RecordingData, placed: Placed) -> list[PixelCovariates]:
    """Return the covariates of each frame, or of the one there is."""
    K, mode = recording.K, recording.mode  # noqa: N806
    clean, rho, known, border = placed.clean, placed.reflectivity, placed.known, placed.border
    if clean.ndim == 2:
        return [look_at(clean, None, 0.0, rho, K, mode, recording.axes, border, known)]
    out = []
    for t, image in enumerate(clean):
        # The first of a segment has none before it.
        before = None if recording.fresh[t] or t == 0 else clean[t - 1]
        interval = float(recording.stamp[t] - recording.stamp[t - 1]) * 1e-9
        albedo, mask = (one if one is None or one.ndim == 2 else one[t] for one in (rho, known))
        out.append(look_at(image, before, interval, albedo, K, mode, recording.axes, border, mask))
    return out


def simulate(
    recording: RecordingData,
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    effects: Any,
    seed: int,
) -> np.ndarray:
    """Return (T, H, W) depth as the simulator sees the recording's scene."""
    camera = base_camera(recording.mode, recording.profile, seed, recording.name)
    if effects:  # The frames of a still scene have a lot in common.
        return CommonRandomNumbers(
            camera, clean, recording.K, recording.stamp, reflectivity
        ).depth(effects)
    return camera.capture(clean, recording.K, recording.stamp, reflectivity).depth


def with_uptime(effects: dict[str, dict[str, float]], uptime: float | None) -> dict[str, Any]:
    """Return effects with the recording's own time since power-on."""
    old = ageing(effects)
    if uptime is None:  # Nothing is known of it, so they explain nothing.
        return {name: values for name, values in effects.items() if name not in old}
    return {**effects, **{name: {**effects[name], 'uptime': uptime} for name in old}}


def gather(
    recording: RecordingData, columns: Sequence[Column], seed: int, prior: np.ndarray
) -> Evidence:
    """
    Look at a recording and simulate everything that could explain it.

    Parameters
    ----------
    recording : RecordingData
        The recording.
    columns : sequence of Column
        What to simulate.
    seed : int
        Of the simulations.
    prior : numpy.ndarray
        (6,) standard deviations of the pose error, metres and degrees.

    """
    motion, sure = register(recording, prior)
    placed = place(recording, motion)
    clean, reflectivity = placed.clean, placed.reflectivity
    scenes = scenes_of(recording, placed)
    moving = clean.ndim == 3
    warm = warm_of(recording.fresh)
    real_sums = accumulate(recording.depth, scenes, recording.fresh, warm)
    null_sums, base_measures = [], []
    for k in range(SIMULATION.null_seeds):
        depth = simulate(recording, clean, reflectivity, (), seed * 1000 + k)
        null_sums.append(accumulate(depth, scenes, recording.fresh, warm))
        base_measures.append(histogram(depth, scenes, null_sums[-1]))
    plain = depth
    spectrum = np.mean([lattice_spectrum(one) for one in null_sums], axis=0)
    real, _ = features(real_sums, spectrum)
    pairs = [features(one, spectrum) for one in null_sums]
    nulls = np.array([values for values, _ in pairs])
    analytic = np.mean([variance for _, variance in pairs], axis=0)
    noise = _pooled_variance(nulls, analytic)
    wrong = [
        features(accumulate(one, scenes, recording.fresh, warm), spectrum)[0] - nulls[-1]
        for one in _wrong_truth(plain, recording.truth.clean_sigma, moving, seed)
    ]

    count = len(recording.depth)
    shifts = np.zeros((len(columns), SIZE), np.float32)
    for kind, (frames, settling) in enumerate(
        (
            (_few_frames(count, moving, *SIMULATION.fewest), 0),
            (_few_frames(count, moving, *SIMULATION.few), 0),
            (np.arange(count), warm),
        )
    ):
        part = _Part(
            recording, clean, reflectivity, scenes, frames, seed * 1000, spectrum, settling
        )
        for i, column in enumerate(columns):
            still = not all(one.needs_motion for one in _definitions(column.effects))
            if _kind(column) == kind and (moving or still):
                shifts[i] = part.shift(with_uptime(column.effects, recording.uptime))
                if kind == 1:  # Grain is noise that is left, and the more so the fewer frames.
                    less = nulls[0, _GRAIN] / max(part.base[_GRAIN], 1e-9)
                    shifts[i, _GRAIN] *= less if np.isfinite(less) else 0  # too few pixels
        if kind == 0:
            plane_columns = part.plane_columns(recording.plane_shifts)
            steps = np.array(
                [[part.shift(pose_effects(i, sign)) for sign in (1, -1)] for i in range(6)]
            )
            # By a whole pixel: nothing less moves an edge that lies between pixels.
            pixel = np.degrees(1 / np.array([recording.K[1, 1], recording.K[0, 0]]))
            edges = np.array(
                [
                    [part.shift(pose_effects(3 + i, sign, pixel[i])) for sign in (1, -1)]
                    for i in range(2)
                ]
            )
    pose_columns = (steps[:, 0] - steps[:, 1]) / 2
    return Evidence(
        recording.name,
        real,
        nulls.mean(axis=0),
        noise / SIMULATION.null_seeds,
        noise,
        nulls,
        shifts,
        pose_columns,
        (edges[:, 0] - edges[:, 1]) / 2,
        _displaced(edges),
        plane_columns,
        np.sqrt(np.square(np.nan_to_num(wrong)).sum(axis=0, initial=0) + np.zeros(SIZE)),
        motion[:POSE],
        sure[:POSE],
        motion[POSE:],
        covariance_of(recording.truth, prior),
        None
        if recording.uptime is None
        else recording.uptime + float((recording.stamp - recording.stamp[0]).mean()) * 1e-9,
        lattice_peak(lattice_spectrum(real_sums), spectrum)[1],
        static_grain(real_sums).astype(np.float16),
        static_grain(null_sums[0]).astype(np.float16),
        fingerprint(recording.depth, scenes),
        histogram(recording.depth, scenes, real_sums),
        base_measures,
        _mean_sigma(real_sums),
        real_sums.bins[:, EXPECT].astype(np.float32),
        len(recording.depth),
        moving,
        recording.notes,
        recording.axes,
        accuracy_of(recording.truth),
    )


def _kind(column: Column) -> int:
    # How many frames it takes: the fewest, a few, all.
    kinds = _definitions(column.effects)
    if all(kind.smooth for kind in kinds):
        return 0
    return 1 if column.few and not any(kind.needs_motion for kind in kinds) else 2


def _definitions(effects: Any) -> list[type[Effect]]:
    # Of effects by name, or of the effects themselves.
    known = loadable()
    return [known[one] if isinstance(one, str) else type(one) for one in effects]


class _Part:
    """Some of a recording's frames, to simulate effects on with the same random numbers."""

    def __init__(
        self,
        recording: RecordingData,
        clean: np.ndarray,
        reflectivity: np.ndarray | None,
        scenes: list[PixelCovariates],
        frames: np.ndarray,
        seed: int,
        spectrum: np.ndarray,
        warm: int,
    ) -> None:
        if reflectivity is not None and reflectivity.ndim == 3:
            reflectivity = reflectivity[frames]
        self._retakes = CommonRandomNumbers(
            base_camera(recording.mode, recording.profile, seed, recording.name),
            clean if clean.ndim == 2 else clean[frames],
            recording.K,
            recording.stamp[frames],
            reflectivity,
        )
        self._scenes = [scenes[t] for t in frames] if len(scenes) > 1 else scenes
        self._fresh = recording.fresh[frames].copy()
        self._fresh[1:] |= np.diff(frames) != 1
        self._spectrum = spectrum
        self._warm = warm
        self._plain = self._retakes.depth(())
        self.base = self._features(self._plain, True)

    def _features(self, depth: np.ndarray, lattice: bool) -> np.ndarray:
        sums = accumulate(
            depth, self._scenes, self._fresh, self._warm, lattice, len(self._scenes) > 1
        )
        return features(sums, self._spectrum, FEATURES.enough_alike)[0]

    def shift(self, effects: Any) -> np.ndarray:
        """Return what the effects change, 0 where that cannot be said."""
        depth = self._retakes.depth(effects)
        if all(
            np.array_equal(one.view(np.int32), other.view(np.int32))
            for one, other in zip(depth, self._plain, strict=True)
        ):
            return np.zeros(SIZE)
        lattice = any(kind.lattice for kind in _definitions(effects))
        return np.nan_to_num(self._features(depth, lattice) - self.base)

    def plane_columns(self, shifts: np.ndarray | None) -> np.ndarray:
        """Return what steps of planes change, (3 P, SIZE); so small, they leave noise as it is."""
        if shifts is None:
            return np.zeros((0, SIZE))
        steps = np.resize(PLANE_STEPS, len(shifts)).astype(np.float32)
        both = np.array(
            [
                [self._features(self._plain + sign * shift, False) for sign in (1, -1)]
                for shift in steps[:, None, None] * shifts
            ]
        )
        return np.nan_to_num((both[:, 0] - both[:, 1]) / 2)


def _displaced(edges: np.ndarray) -> np.ndarray:
    # Variance of features when each edge lies elsewhere by what no common motion takes off (warped
    # clean depth has no parallax): from what a pixel of pitch and yaw either way, (2, 2, SIZE),
    # changes. Near edges that nobody marked (sharp bends) only what is the same both ways.
    scale = SIMULATION.edge_error**2
    whole = scale * np.square(edges).mean(axis=(0, 1))
    even = scale * np.square(edges.mean(axis=1)).mean(axis=0)
    return np.where(_AT_EDGES, whole, np.where(_AT_BENDS, even, 0)).astype(np.float32)


def _wrong_truth(
    depth: np.ndarray, sigma: np.ndarray | None, moving: bool, seed: int
) -> list[np.ndarray]:
    # Depth as measured where the truth is wrong by one standard deviation: all of it to one side,
    # and each pixel by itself (of a scene that stands still, the same in all frames).
    if sigma is None or not sigma.any():
        return []
    shape = depth.shape if moving else depth.shape[1:]
    draw = np.random.default_rng(seed).standard_normal(shape, np.float32)
    return [depth + sigma, depth + draw * sigma]


def warm_of(fresh: np.ndarray) -> int:
    """Return how many frames a camera gets to settle in after each gap."""
    return SIMULATION.settling if len(fresh) >= 6 and fresh.sum() <= len(fresh) / 6 else 0


def _mean_sigma(sums: Sums) -> np.ndarray:
    with np.errstate(invalid='ignore', divide='ignore'):
        # Harmonic: a bias in metres is this times its mean in sigma.
        return (sums.bins[:, VALID] / sums.bins[:, INVERSE]).astype(np.float32)


def _pooled_variance(nulls: np.ndarray, analytic: np.ndarray) -> np.ndarray:
    # Few seeds say little about one feature, and much about how far all of its kind are from
    # what independent pixels would give.
    weight, least = SIMULATION.pooled
    found = nulls.var(axis=0, ddof=1)
    with np.errstate(invalid='ignore'):
        found = np.where(np.isfinite(found), found, analytic)
        blend = weight * analytic + (1 - weight) * found
    return np.maximum(blend, least * analytic)


def _few_frames(count: int, moving: bool, few: int, stretch: int) -> np.ndarray:
    if count <= 2 * stretch:
        return np.arange(count)
    if not moving:
        return np.arange(few)
    starts = count // 4, min(3 * count // 4, count - stretch)
    return np.unique([np.arange(start, start + stretch) for start in starts])


__all__ = ['Evidence', 'Sums', 'RecordingData', 'gather', 'register', 'simulate']
