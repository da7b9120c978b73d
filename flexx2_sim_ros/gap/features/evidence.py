"""One recording as numbers: what it shows, what the simulator shows, what each effect changes."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

from flexx2_sim_ros.gap.calibration.features import SIMULATION
from flexx2_sim_ros.gap.data.axes import AXES, Axes
from flexx2_sim_ros.gap.data.pose import pose_effects
from flexx2_sim_ros.gap.data.prior import covariance_of, POSE
from flexx2_sim_ros.gap.data.registration import RecordingData, register
from flexx2_sim_ros.gap.features.catalogue import Column
from flexx2_sim_ros.gap.features.features import (
    features,
    lattice_peak,
    lattice_spectrum,
    LAYOUT,
    SIZE,
    static_grain,
)
from flexx2_sim_ros.gap.features.grain import fingerprint
from flexx2_sim_ros.gap.features.row_sums import INVERSE, N_ERROR
from flexx2_sim_ros.gap.features.search import Found, of_registration
from flexx2_sim_ros.gap.features.simulation import (
    definitions,
    few_frames,
    PartialSimulation,
    PlacedScene,
    with_uptime,
)
from flexx2_sim_ros.gap.features.sums import Sums
from flexx2_sim_ros.recording.truth import Accuracy, accuracy_of
import numpy as np

_AT_EDGES, _AT_BENDS = (
    np.array([f.axis == axis for f in LAYOUT]) for axis in ('edge', 'concavity')
)
_GRAIN = next(i for i, f in enumerate(LAYOUT) if f.channel == 'static_grain')
# How many frames are simulated with an effect.
_FEWEST, _FEW, _ALL = range(3)


@dataclass
class Evidence:
    """
    A recording's summary; all that is decided is decided from these.

    * `real`, `base`, `noise`: (SIZE,) features of the recording; mean of those of the base
      simulator; the variance of one simulated recording.
    * `nulls`: (S, SIZE) the single simulations.
    * `columns`: (C, SIZE) float32, what each simulated effect changes.
    * `pose_columns`: (6, SIZE) per step of `pose.STEPS`.
    * `edge_columns`: (2, SIZE) per pixel by which edges lie lower (as with pitch) or farther right
      (yaw).
    * `displaced`: (SIZE,) variance from edges that are known to a part of a pixel only.
    * `plane_columns`: (3 P, SIZE) per step of `planes.PLANE_STEPS`, of planes known within bounds
      only.
    * `truth_spread`: (SIZE,) what errors of the ground truth as large as its standard deviation
      change.
    * `pose`: (6,) metres and degrees: how the real camera was moved, as first fitted.
    * `sure_pose`: (6,) what of it is beyond doubt.
    * `planes`: (3 P,) metres and radians: how the planes were moved, as first fitted.
    * `covariance`: of both, as from `prior.covariance_of`.
    * `uptime`: mean seconds since power-on.
    * `step`: lattice step that stands out, metres.
    * `grain`, `null_grain`: (H, W) float16 static pattern in sigma, of the recording and of a
      simulated one.
    * `fingerprint`: (N,) float16 the first frame's noise; see `grain.fingerprint`.
    * `sigma`: (BINS,) mean sigma_z of the depths that are compared, metres.
    * `compared`: depths on surfaces that are compared: see `covariates.trusted_sigma`.
    * `notes`: what of the recording was converted or assumed.
    * `accuracy`: of its ground truth.
    * `checksum`: SHA-256 of its measured depth.
    """

    name: str
    real: np.ndarray
    base: np.ndarray
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
    sigma: np.ndarray
    compared: int
    frames: int
    moving: bool
    notes: tuple[str, ...]
    axes: Axes
    accuracy: Accuracy
    checksum: str


@dataclass(frozen=True)
class _Base:
    # S simulations without effects: depth of the last one, sums, mean spectrum of depths,
    # (S, SIZE) features, and (SIZE,) variance of the features between simulations.
    depth: np.ndarray
    sums: list[Sums]
    spectrum: np.ndarray
    features: np.ndarray
    noise: np.ndarray


def gather(
    recording: RecordingData,
    columns: Sequence[Column],
    seed: int,
    prior: np.ndarray,
    found: Found = MappingProxyType({}),
    motion: np.ndarray | None = None,
) -> Evidence:
    """
    Look at a recording and simulate everything that could explain it.

    `prior` is (6,) standard deviations of the pose error, metres and degrees; `found` what is
    known of the camera's inside, as from `search.search`; `motion` (6 + 3 P,) where its camera and
    its planes are. It is registered when left out.
    """
    if motion is None:
        motion, sure = register(recording, prior, *of_registration(found))
    else:
        sure = motion
    scene = PlacedScene.at(recording, motion)
    sums = scene.sums(recording.depth)
    base = _simulate_base(scene, seed)
    return Evidence(
        name=recording.name,
        real=features(sums, base.spectrum)[0],
        base=base.features.mean(axis=0),
        noise=base.noise,
        nulls=base.features,
        **_simulate_changes(scene, columns, seed, base),
        truth_spread=_truth_spread(scene, base, seed),
        pose=motion[:POSE],
        sure_pose=sure[:POSE],
        planes=motion[POSE:],
        covariance=covariance_of(recording.truth),
        uptime=_mean_uptime(recording),
        step=lattice_peak(lattice_spectrum(sums), base.spectrum)[1],
        grain=static_grain(sums).astype(np.float16),
        null_grain=static_grain(base.sums[0]).astype(np.float16),
        fingerprint=fingerprint(recording.depth, scene.covariates),
        sigma=_mean_sigma(sums),
        compared=int(sums.bins[AXES['all'].start, N_ERROR]),
        frames=len(recording.depth),
        moving=scene.moving,
        notes=recording.notes,
        axes=recording.axes,
        accuracy=accuracy_of(recording.truth),
        checksum=recording.checksum,
    )


def _simulate_base(scene: PlacedScene, seed: int) -> _Base:
    sums = []
    for k in range(SIMULATION.null_seeds):
        depth = scene.simulate((), seed * 1000 + k)
        sums.append(scene.sums(depth))
    spectrum = np.mean([lattice_spectrum(one) for one in sums], axis=0)
    pairs = [features(one, spectrum) for one in sums]
    values = np.array([one for one, _ in pairs])
    analytic = np.mean([variance for _, variance in pairs], axis=0)
    return _Base(depth, sums, spectrum, values, _pooled_variance(values, analytic))


def _simulate_changes(
    scene: PlacedScene, columns: Sequence[Column], seed: int, base: _Base
) -> dict[str, np.ndarray]:
    # Those fields of `Evidence` that are changes of features.
    recording, moving = scene.recording, scene.moving
    count = len(recording.depth)
    shifts = np.zeros((len(columns), SIZE), np.float32)
    for kind, frames, settling in (
        (_ALL, np.arange(count), scene.warm),
        (_FEW, few_frames(count, moving, *SIMULATION.few), 0),
        (_FEWEST, few_frames(count, moving, *SIMULATION.fewest), 0),
    ):
        part = PartialSimulation(scene, frames, seed * 1000, base.spectrum, settling)
        for i, column in enumerate(columns):
            still = not all(one.needs_motion for one in definitions(column.changed))
            if _kind(column) == kind and (moving or still):
                shifts[i] = part.shift(
                    with_uptime(column.effects, recording.uptime), column.without
                )
                if kind == _FEW:  # Fewer frames leave more noise in the grain, so it is scaled.
                    less = base.features[0, _GRAIN] / max(part.base[_GRAIN], 1e-9)
                    shifts[i, _GRAIN] *= less if np.isfinite(less) else 0  # too few pixels
        # The fewest frames are enough for a change of geometry. In a moving scene, other frames
        # show other surfaces at the same place of the image.
        if kind == (_ALL if moving else _FEWEST):
            poses, edges = _pose_changes(part, recording)
    return {
        'columns': shifts,
        'pose_columns': poses,
        'edge_columns': (edges[:, 0] - edges[:, 1]) / 2,
        'displaced': _displaced(edges),
        'plane_columns': part.plane_columns(recording.plane_shifts),
    }


def _pose_changes(
    part: PartialSimulation, recording: RecordingData
) -> tuple[np.ndarray, np.ndarray]:
    # (6, SIZE) change per step of the pose; (2, 2, SIZE) change by one pixel of pitch and of yaw,
    # in both directions.
    steps = np.array([[part.shift(pose_effects(i, sign)) for sign in (1, -1)] for i in range(6)])
    # A whole pixel, because a smaller turn may leave an edge between the same two pixels.
    pixel = np.degrees(1 / np.array([recording.K[1, 1], recording.K[0, 0]]))
    edges = np.array(
        [[part.shift(pose_effects(3 + i, sign, pixel[i])) for sign in (1, -1)] for i in range(2)]
    )
    return (steps[:, 0] - steps[:, 1]) / 2, edges


def _truth_spread(scene: PlacedScene, base: _Base, seed: int) -> np.ndarray:
    # (SIZE,) change of features by errors of the ground truth of one standard deviation.
    wrong = [
        features(scene.sums(one), base.spectrum)[0] - base.features[-1]
        for one in _wrong_truth(base.depth, scene.recording.truth.clean_sigma, scene.moving, seed)
    ]
    return np.sqrt(np.square(np.nan_to_num(wrong)).sum(axis=0, initial=0) + np.zeros(SIZE))


def _mean_uptime(recording: RecordingData) -> float | None:
    if recording.uptime is None:
        return None
    return recording.uptime + float((recording.stamp - recording.stamp[0]).mean()) * 1e-9


def _kind(column: Column) -> int:
    kinds = definitions(column.changed)
    if all(kind.smooth for kind in kinds):
        return _FEWEST
    return _FEW if column.few and not any(kind.needs_motion for kind in kinds) else _ALL


def _displaced(edges: np.ndarray) -> np.ndarray:
    # Variance of features if each edge is displaced by an amount that no common motion removes,
    # because a clean image that was moved has edges at whole pixels. It follows from the change by
    # one pixel of pitch and yaw in both directions, (2, 2, SIZE). At sharp bends, which are not
    # marked as edges, only the part that is equal in both directions counts.
    scale = SIMULATION.edge_error**2
    whole = scale * np.square(edges).mean(axis=(0, 1))
    even = scale * np.square(edges.mean(axis=1)).mean(axis=0)
    return np.where(_AT_EDGES, whole, np.where(_AT_BENDS, even, 0)).astype(np.float32)


def _wrong_truth(
    depth: np.ndarray, sigma: np.ndarray | None, moving: bool, seed: int
) -> list[np.ndarray]:
    # Depth as it would be measured if the ground truth were wrong by one standard deviation: once
    # all pixels in one direction, once each pixel independently (still scenes: the same in all
    # frames).
    if sigma is None or not sigma.any():
        return []
    shape = depth.shape if moving else depth.shape[1:]
    draw = np.random.default_rng(seed).standard_normal(shape, np.float32)
    return [depth + sigma, depth + draw * sigma]


def _mean_sigma(sums: Sums) -> np.ndarray:
    with np.errstate(invalid='ignore', divide='ignore'):
        # Harmonic mean: a bias in metres is this value times the mean bias in sigma.
        return (sums.bins[:, N_ERROR] / sums.bins[:, INVERSE]).astype(np.float32)


def _pooled_variance(nulls: np.ndarray, analytic: np.ndarray) -> np.ndarray:
    # A few seeds give a poor estimate of the variance of one feature. It is blended with the
    # analytic variance for independent pixels.
    weight, least = SIMULATION.pooled
    found = nulls.var(axis=0, ddof=1)
    with np.errstate(invalid='ignore'):
        found = np.where(np.isfinite(found), found, analytic)
        blend = weight * analytic + (1 - weight) * found
    return np.maximum(blend, least * analytic)
