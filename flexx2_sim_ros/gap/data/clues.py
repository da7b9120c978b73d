"""What a recording shows of the inside of its camera, before anything is simulated."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.calibration.search import SEARCH
from flexx2_sim_ros.gap.data.covariates import log_amplitude, look_at, PixelCovariates
from flexx2_sim_ros.gap.data.frames import at_frame, looked_at, seen_at, surface_of
from flexx2_sim_ros.gap.data.pose import pose_columns
from flexx2_sim_ros.gap.data.registration import change_by_latency, frames_between, RecordingData
import numpy as np

RANGE, LINE = 6, 7  # columns of `Clues.own`: an offset of range, and in proportion to depth


@dataclass(frozen=True)
class Clues:
    """
    What one recording shows. Samples are pixels on surfaces, of the mean over a still scene.

    * `error`: (N,) metres, measured less clean depth.
    * `sigma`: (N,) metres, of the errors.
    * `own`: (N, 9) metres: what a small motion of the camera, an offset of range, a depth scale
      and a latency change.
    * `length`: (N,) length of each pixel's ray, as a multiple of its depth.
    * `distance`: (N,) metres along the ray.
    * `light`: (2, B, A) expected and lost depths, by the logarithm of the amplitude, see
      `light_edges`, and the angle of incidence, see `SEARCH.incidences`.
    * `folds`: (2, F) metres along the ray, true and measured, of pixels whose depth is too short
      by more than a decimetre.
    * `beyond`: how many pixels have a depth that is too long by as much.
    * `looked`: how many valid depths were looked at for both.
    * `late`: (L,) loss at each latency of `SEARCH.latencies` over that of the same frames at their
      stamps; empty for a still scene.
    * `lag`: age that a filter over frames gives to what moves, seconds, by how alike the frames of
      a still scene are; NaN where that is not known.
    """

    error: np.ndarray
    sigma: np.ndarray
    own: np.ndarray
    length: np.ndarray
    distance: np.ndarray
    light: np.ndarray
    folds: np.ndarray
    beyond: int
    looked: int
    late: np.ndarray
    lag: float


def light_edges() -> np.ndarray:
    """Return the limits of the bins of `Clues.light`, ln of 1/m^2."""
    low, high, step = SEARCH.light
    return np.arange(low, high + step / 2, step)


def latencies() -> np.ndarray:
    """Return the latencies that are tried, seconds."""
    low, high, step = SEARCH.latencies
    return np.arange(round(low / step), round(high / step) + 1) * step


def clues_of(recording: RecordingData) -> Clues:
    """Return what a recording shows of the inside of its camera."""
    frames = looked_at(len(recording.depth), recording.still)
    covers = [_cover(recording, t) for t in frames]
    samples = [
        _samples(recording, t, cover, SEARCH.samples // len(frames))
        for t, cover in zip(frames, covers, strict=True)
    ]
    error, sigma, own, length, distance = (
        np.concatenate(part) for part in zip(*samples, strict=True)
    )
    folds, beyond, looked = _folds(recording, frames, covers)
    return Clues(
        error,
        sigma,
        own,
        length,
        distance,
        _light(recording, frames, covers),
        folds,
        beyond,
        looked,
        _late(recording, frames, covers),
        _lag(recording, covers[0]),
    )


def _cover(recording: RecordingData, t: int) -> PixelCovariates:
    known = at_frame(recording.truth.known, t)
    clean, axes = at_frame(recording.clean, t), recording.axes
    return look_at(clean, None, 0.0, None, recording.K, recording.mode, axes, known=known)


def _samples(
    recording: RecordingData, t: int, cover: PixelCovariates, most: int
) -> tuple[np.ndarray, ...]:
    # The first five fields of `Clues` of one frame.
    clean = at_frame(recording.clean, t)
    error = seen_at(recording.depth, t, recording.still)[0] - clean
    limit = REGISTRATION.outlier_sigmas * cover.sigma + SEARCH.largest_error
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = (error / clean)[cover.inside]
        stretch = np.nanmedian(ratio) if np.isfinite(ratio).any() else 0.0
        good = cover.inside & (np.abs(error - stretch * clean) < limit)
    moves = pose_columns(clean, recording.K, recording.mode.sensor)
    late = np.zeros_like(clean)
    if not recording.still:
        late = change_by_latency(recording, [t], 0.0)[0]
    whole = np.stack([1 / cover.ray, clean, late])[:, ::2, ::2]
    own = np.concatenate([moves, whole])
    good = good[::2, ::2] & np.isfinite(own).all(axis=0)
    places = np.flatnonzero(good)
    places = places[:: max(len(places) // most, 1)]
    error, sigma, length, depth = (
        one[::2, ::2].reshape(-1)[places].astype(float)
        for one in (error, cover.sigma, cover.ray, clean)
    )
    return error, sigma, own.reshape(len(own), -1)[:, places].T, length, depth * length


def _light(
    recording: RecordingData, frames: list[int], covers: list[PixelCovariates]
) -> np.ndarray:
    edges = light_edges(), np.array(SEARCH.incidences)
    out = np.zeros((2, *(len(one) - 1 for one in edges)))
    for t, cover in zip(frames, covers, strict=True):
        clean = at_frame(recording.clean, t)
        surface = surface_of(clean, recording.K, recording.mode.sensor)
        with np.errstate(divide='ignore', invalid='ignore'):
            light = log_amplitude(surface, clean, at_frame(recording.reflectivity, t))
        depth = recording.depth if recording.still else recording.depth[t : t + 1]
        lost = np.isnan(depth).mean(axis=0)
        use = cover.inside & np.isfinite(light)
        light = np.clip(light[use], edges[0][0], edges[0][-1] - 1e-6)
        incidence = np.degrees(surface.incidence[use])
        out += [np.histogram2d(light, incidence, edges, weights=w)[0] for w in (None, lost[use])]
    return out


def _folds(
    recording: RecordingData, frames: list[int], covers: list[PixelCovariates]
) -> tuple[np.ndarray, int, int]:
    # `folds`, `beyond` and `looked`. Means over frames would mix whole and folded distances.
    still = recording.still
    some = range(min(SEARCH.fold_frames, len(recording.depth))) if still else frames
    parts, beyond, looked = [], 0, 0
    for i, t in enumerate(some):
        clean, cover = at_frame(recording.clean, t), covers[0 if still else i]
        with np.errstate(invalid='ignore'):
            far = cover.compared & (clean > recording.mode.range_max)
            gone = (clean - recording.depth[t]) * cover.ray
            use = (cover.inside | far) & np.isfinite(gone)
            least = np.maximum(REGISTRATION.outlier_sigmas * cover.sigma, SEARCH.least_fold)
            short, long = use & (gone > least), use & (gone < -least)
        true = (clean * cover.ray)[short]
        parts.append(np.stack([true, true - gone[short]]))
        beyond += int(long.sum())
        looked += int(use.sum())
    folds = np.concatenate(parts, axis=1)
    return folds[:, :: max(folds.shape[1] // SEARCH.most_folds, 1)], beyond, looked


def _late(
    recording: RecordingData, frames: list[int], covers: list[PixelCovariates]
) -> np.ndarray:
    # Loss at each latency over that of the same frames at their stamps, small motions fitted.
    if recording.still:
        return np.zeros(0)
    first, last = int(recording.stamp[0]), int(recording.stamp[-1])
    columns = [
        pose_columns(recording.clean[t], recording.K, recording.mode.sensor) for t in frames
    ]

    def loss(inside: list[int], latency: float) -> float:
        shown = frames_between(recording, [frames[i] for i in inside], latency)
        designs, errors = [], []
        for i, clean in zip(inside, shown, strict=True):
            error = (recording.depth[frames[i]] - clean) / covers[i].sigma
            good = (covers[i].inside & np.isfinite(error))[::2, ::2]
            good &= np.isfinite(columns[i]).all(axis=0)
            sigma = covers[i].sigma[::2, ::2][good]
            designs.append(columns[i][:, good] / sigma)
            errors.append(error[::2, ::2][good])
        design, error = np.concatenate(designs, axis=1), np.concatenate(errors)
        return _loss(design[:, ::4], error[::4]) if len(error) >= SEARCH.fewest else np.nan

    at_stamps: dict[tuple[int, ...], float] = {}
    out = []
    for latency in latencies():
        moments = [int(recording.stamp[t]) - round(latency * 1e9) for t in frames]
        inside = [i for i, m in enumerate(moments) if first <= m <= last]
        out.append(np.nan)
        if len(inside) < SEARCH.fewest_frames:
            continue
        same = tuple(inside)
        if same not in at_stamps:
            at_stamps[same] = loss(inside, 0.0)
        # Without noise there is nothing to explain.
        now = at_stamps[same]
        out[-1] = 1.0 if now <= SEARCH.least_loss else loss(inside, float(latency)) / now
    return np.array(out)


def _lag(recording: RecordingData, cover: PixelCovariates) -> float:
    # A recursive filter with weight w is late by w / (1 - w) frames. Two frames on, depths differ
    # by the factor 1 + w more in variance than from frame to frame.
    if not recording.still or len(recording.depth) < 3:
        return np.nan
    depth = recording.depth[:, cover.inside]
    near, far = (np.abs(depth[step:] - depth[:-step]) for step in (1, 2))
    if np.isfinite(near).sum() < SEARCH.fewest or np.isfinite(far).sum() < SEARCH.fewest:
        return np.nan
    beside, apart = np.nanmedian(near), np.nanmedian(far)
    if beside <= 0:
        return np.nan
    weight = float(np.clip((apart / beside) ** 2 - 1, 0.0, SEARCH.most_alike))
    return weight / (1 - weight) * float(np.median(np.diff(recording.stamp))) * 1e-9


def _loss(design: np.ndarray, error: np.ndarray) -> float:
    # Mean Cauchy loss of errors in sigma, small motions fitted.
    ridge = SEARCH.ridge * len(error) * np.diag(np.square(design).mean(axis=1) + 1e-12)
    rest = error
    for _ in range(SEARCH.steps):
        weight = 1 / (1 + (rest / SEARCH.scale) ** 2)
        normal = (design * weight) @ design.T + ridge
        rest = error - np.linalg.solve(normal, (design * weight) @ error) @ design
    return float(np.log1p((rest / SEARCH.scale) ** 2).mean())
