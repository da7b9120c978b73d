"""Errors of a recording's camera pose: how they change depth, and how they are fitted."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.camera import Camera, Intrinsics, Mode, Profile
from flexx2_sim_ros.effects.pose_error import PoseError
from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.prior import free_planes
from flexx2_sim_ros.gap.data.unknown import margin
from flexx2_sim_ros.physics.frame_state import FrameState, Memory, SPEED_OF_LIGHT
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.poses import depth_slopes, weighted_equations
from flexx2_sim_ros.physics.surface import tangents
from flexx2_sim_ros.profiles.sensor import Sensor
from flexx2_sim_ros.recording.opening import BAG_FILES
import numpy as np

# The six small motions, in metres and degrees.
NAMES = ('x', 'y', 'z', 'pitch_deg', 'yaw_deg', 'roll_deg')
STEPS, LIMITS = np.array(REGISTRATION.steps), np.array(REGISTRATION.limits)


def moved(
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    K: np.ndarray,  # noqa: N803
    mode: Mode,
    pose: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None]:
    """
    Return clean depth and reflectivity as seen from another pose, (6,) metres and degrees.

    `clean` is (H, W) or (T, H, W) float32 metres, `reflectivity` of the same shape or None; `K` is
    the (3, 3) camera matrix.
    """
    if not pose.any():
        return clean, reflectivity
    effect = PoseError(1.0, *(float(v) for v in np.clip(pose, -LIMITS, LIMITS)))
    depths = clean if clean.ndim == 3 else clean[None]
    albedo = np.ones((1, 1), np.float32) if reflectivity is None else reflectivity
    lens = Intrinsics.from_matrix(K, clean.shape[-1], clean.shape[-2])
    out, rho = np.empty_like(depths), []
    for t, depth in enumerate(np.ascontiguousarray(depths)):
        shade = at_frame(albedo, t)
        state = FrameState(mode, lens, 0, np.zeros(2, np.uint32), Memory(), depth, shade)
        effect.apply(state)
        out[t] = state.depth
        rho.append(state.reflectivity)
    shades = None if reflectivity is None else np.stack(rho)
    return (out, shades) if clean.ndim == 3 else (out[0], at_frame(shades, 0))


def unknown_border(pose: np.ndarray, clean: np.ndarray, K: np.ndarray) -> int:  # noqa: N803
    """
    Return the width of the border of a moved image that the given pose did not show, pixels.

    `pose` is as for `moved`, `clean` (..., H, W) metres.
    """
    distance = clean[clean > 0]
    if not pose.any() or not distance.size:
        return 0
    corner = math.hypot(clean.shape[-1], clean.shape[-2]) / 2
    turn = np.radians(np.abs(pose[3:]))
    step = np.abs(pose[:3]) / float(np.quantile(distance[::97], 0.02))
    focal = float(K[0, 0])
    shift = focal * (max(step[0], step[1]) + max(turn[0], turn[1])) + corner * (step[2] + turn[2])
    return min(math.ceil(shift), min(clean.shape[-2:]) // 8) + margin(1, clean.shape)


@dataclass(frozen=True)
class Differences:
    """
    Where a frame differs from its clean depth.

    * `error`: (H, W) measured minus clean depth, metres, NaN for pixels that are not used.
    * `clean`, `sigma`: (H, W) the clean depth and the standard deviation of errors, metres.
    * `others`: (m, H, W) metres: change of depth by effects at typical size. They are nuisance
      parameters, so that an effect is not mistaken for a motion.
    * `jump_slopes`: (6, N) pixels by which jumps are displaced; see `jump_shift.Jumps`.
    * `jump_shifts`: (N,) pixels by which the frame shows them displaced, NaN where it cannot be
      said.
    * `jump_others`: (m, N) pixels by which these effects displace them, 0 where it cannot be said.
    """

    error: np.ndarray
    clean: np.ndarray
    sigma: np.ndarray
    others: np.ndarray
    jump_slopes: np.ndarray
    jump_shifts: np.ndarray
    jump_others: np.ndarray


def fit_plane_motion(
    frames: Sequence[Differences],
    K: np.ndarray,  # noqa: N803
    spread: np.ndarray,
    shifts: np.ndarray,
    before: np.ndarray,
    profile: Profile,
    waves: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Fit a small motion of camera and planes to errors on surfaces, with an M-estimator.

    Return (n,) the motion, at most three standard deviations; (m,) the amount of each of their
    `others`; and (n,) the whole motion, with that of earlier rounds, under a prior three times as
    stiff. What surfaces leave open, such as a motion along surfaces that face the camera, the
    places of depth jumps decide.

    * `spread`: (n, n), as from `prior.factor`, of the motion: six of the camera, metres and
      degrees, and three for each plane.
    * `shifts`: (n - 6, H, W), as from `planes.plane_shifts`.
    * `before`: (n,) the motion that earlier rounds found.
    * `waves`: periods along the ray of biases that the recordings have besides, metres.
    """
    number = len(spread)
    fourths = [round(SPEED_OF_LIGHT / (8 * f), 4) for f in profile.modulation_hz]
    periods = [*fourths, *waves]
    sizes = np.array([*REGISTRATION.smooth, *[REGISTRATION.harmonic] * (2 * len(periods))])
    A, b = _weighted_design(frames, K, shifts, profile, periods)  # noqa: N806
    if not len(b):
        return np.zeros(number), np.zeros(len(frames[0].others)), before
    rest = number + len(sizes)
    amounts = np.full(len(frames[0].others), REGISTRATION.amounts)
    usual = np.concatenate([sizes, amounts, [REGISTRATION.jump_growth]])
    if free_planes(spread @ spread.T):  # They take all that they can.
        usual[:-1] = 0
    # In units of the priors' standard deviations, so that one ridge fits all of them.
    A = np.concatenate([spread.T @ A[:number], A[number:] * usual[:, None]])  # noqa: N806
    # Few pixels must not move a camera far.
    fewest = sum(one.error.size for one in frames) / REGISTRATION.fewest
    ridge = REGISTRATION.ridge * max(len(b), fewest) * np.eye(len(A))
    motion, weight, normal = _reweighted_least_squares(A, b, ridge)
    so_far, stiff = np.zeros(len(A)), REGISTRATION.sure * ridge
    so_far[:number] = np.linalg.pinv(spread) @ before
    sure = so_far + np.linalg.solve(normal + stiff, (A * weight) @ b - stiff @ so_far)
    bound = REGISTRATION.bound
    return (
        spread @ np.clip(motion[:number], -bound, bound),
        motion[rest:-1] * amounts,
        spread @ np.clip(sure[:number], -bound, bound),
    )


def _weighted_design(
    frames: Sequence[Differences],
    K: np.ndarray,  # noqa: N803
    shifts: np.ndarray,
    profile: Profile,
    periods: Sequence[float],
) -> tuple[np.ndarray, np.ndarray]:
    # (columns, N) design matrix and (N,) residuals, in standard deviations: every second pixel,
    # and all jumps. The last column is a growth of all surfaces that are in front.
    designs: list[np.ndarray] = []
    values: list[np.ndarray] = []
    for one in frames:
        error, noise = one.error[::2, ::2], one.sigma[::2, ::2]
        good = np.isfinite(error)
        biases = _others(one.clean, K, periods)
        if good.any():
            columns = np.concatenate(
                [
                    pose_columns(one.clean, K, profile.sensor),
                    shifts[:, ::2, ::2],
                    biases,
                    one.others[:, ::2, ::2],
                    np.zeros((1, *error.shape)),
                ]
            )
            designs.append(columns[:, good] / noise[good])
            values.append(error[good] / noise[good])
        used = np.isfinite(one.jump_shifts)
        none = np.zeros((len(shifts) + len(biases), used.sum()))
        columns = np.concatenate(
            [one.jump_slopes[:, used], none, one.jump_others[:, used], np.ones((1, used.sum()))]
        )
        designs.append(columns / REGISTRATION.jump_error)
        values.append(one.jump_shifts[used] / REGISTRATION.jump_error)
    A, b = np.concatenate(designs, axis=1), np.concatenate(values)  # noqa: N806
    keep = np.isfinite(A).all(axis=0)
    return A[:, keep], b[keep]


def _reweighted_least_squares(
    A: np.ndarray,  # noqa: N803
    b: np.ndarray,
    ridge: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Coefficients under a Cauchy loss whose scale shrinks; the last weights and normal matrix.
    coefficients = np.zeros(len(A))
    scale, shrink, last = REGISTRATION.scales
    for _ in range(REGISTRATION.iterations):
        weight = 1 / (1 + ((b - coefficients @ A) / scale) ** 2)
        normal, right = weighted_equations(A, weight, b)
        coefficients = np.linalg.solve(normal + ridge, right)
        scale = max(shrink * scale, last)
    return coefficients, weight, normal


def _others(
    depth: np.ndarray,
    K: np.ndarray,  # noqa: N803
    periods: Sequence[float],
) -> np.ndarray:
    # Nuisance columns of every second row and column: constant along the axis and the ray, log of
    # distance, and waves of some periods along the ray.
    length, depth = ray_length(K, depth.shape)[::2, ::2], depth[::2, ::2]
    turns = [2 * math.pi * depth * length / period for period in periods]
    return np.stack(
        [
            np.ones_like(depth),
            1 / length,
            np.log(np.maximum(depth, 0.1)),
            *(f(turn) for turn in turns for f in (np.sin, np.cos)),
        ]
    )


def pose_columns(depth: np.ndarray, K: np.ndarray, sensor: Sensor) -> np.ndarray:  # noqa: N803
    """
    Return how depth, (H, W) float32 metres, changes with a small motion of the camera.

    The result is (6, ceil(H / 2), ceil(W / 2)) of every other row and column: metres per metre and
    per degree; see `depth_slopes`.
    """
    inverse, across, down = tangents(depth, sensor)
    here, across, down = inverse[2:-2:2, 2:-2:2], across[::2, ::2], down[::2, ::2]
    height, width = depth.shape
    v, u = np.mgrid[:height:2, :width:2].astype(np.float32)
    u, v = u - np.float32(K[0, 2]), v - np.float32(K[1, 2])
    n = np.stack([K[0, 0] * across, K[1, 1] * down, here - u * across - v * down])
    ray = np.stack([u / K[0, 0], v / K[1, 1], np.ones_like(u)])
    with np.errstate(divide='ignore', invalid='ignore'):
        return depth_slopes(ray, n, 1 / here, math.radians(1))


def pose_effects(index: int, sign: int, size: float | None = None) -> tuple[PoseError]:
    """Return the effect that moves the camera along one axis, by `size` or by one step."""
    values = np.zeros(6)
    values[index] = sign * (STEPS[index] if size is None else size)
    return (PoseError(1.0, *(float(v) for v in values)),)


def base_camera(mode: Mode, profile: Profile | None, seed: int, recording: str) -> Camera:
    """
    Return a simulated camera in a mode, with noise that no other recording's simulation has.

    It is the Flexx2 if `profile` is None. The same recording as a file and as a bag has the same
    noise.
    """
    for suffix in ('.npz', *BAG_FILES):
        recording = recording.removesuffix(suffix)
    return Camera(mode.name, profile=profile, seed=seed, name=f'gap {recording}')
