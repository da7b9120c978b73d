"""
Answers of simpler methods, for comparison.

All use the same features: errors divided by the sigma of the base model, by channel and bin of a
covariate, minus those of a simulation of the same scenes without effects.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.surface import analyse
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording import load_recording, Recording
import numpy as np
from study.blind import CATALOGUE

_FRAMES = 3
_BINS = 5
_CHANNELS = ('bias', 'spread', 'invalid', 'gross', 'frames', 'beside')
_AXES = ('distance', 'incidence', 'radius', 'amplitude', 'edge', 'uptime')
_TOLERANCE = {
    'bias': 0.10,
    'spread': 0.10,
    'invalid': 0.008,
    'gross': 0.004,
    'frames': 0.04,
    'beside': 0.04,
}
# The largest gaps, in tolerances, of cameras without effects whose pose is wrong by 2 mm and
# 0.125 degrees: the maximum of twelve development campaigns. Smaller gaps mean `none`.
_USUAL = np.array([20.0, 4.0, 1.0, 18.0, 2.0, 6.0])
_USUAL_BIC = 110.0  # the same limit for the gain in BIC
_USUAL_ACCURACY = 0.75  # the same limit for the accuracy of the classifier


@dataclass(frozen=True)
class _Scene:
    # Ground truth of a recording: clean depth and sigma (T or 1, H, W), the pixels that are used
    # (H W,), and their covariates (N, axes).
    clean: np.ndarray
    sigma: np.ndarray
    keep: np.ndarray
    covariates: np.ndarray


@dataclass(frozen=True)
class _Sample:
    # Pixels of one recording: residuals (T, N) over sigma, NaN invalid; beside (T, N) those of
    # the next pixel; covariates (N, axes).
    residual: np.ndarray
    beside: np.ndarray
    covariates: np.ndarray


def all_baselines(folder: Path, seed: int) -> dict[str, str]:
    """
    Return the answers of all baselines.

    `seed`: seed of the random answer and of the simulations. The answer of each baseline is the
    name of an effect, ``none`` or ``unknown``.
    """
    recordings = [load_recording(path) for path in sorted(folder.glob('*.npz'))]
    scenes = [_scene(recording) for recording in recordings]
    real = [
        _sample(scene, recording.depth)
        for scene, recording in zip(scenes, recordings, strict=True)
    ]
    plain = _simulated(recordings, scenes, (), seed)
    edges = _edges(real)
    places = [_places(scene, edges) for scene in scenes]
    base = _features(plain, places)
    gap = _features(real, places) - base
    rng = np.random.default_rng(seed)
    return {
        'largest gap': _largest(gap),
        'in-sample BIC': _bic(gap, _templates(recordings, scenes, places, base, seed)),
        'classifier': _classifier(real, plain, seed),
        'random': str(rng.choice([*sorted(CATALOGUE), 'none', 'unknown'])),
    }


def _simulate(recording: Recording, effects: Any, seed: int) -> np.ndarray:
    clean = recording.clean_depth
    if clean is None:
        raise InputError(f'{recording.path}: clean_depth: not in the file')
    known = recording.reflectivity
    frames = slice(0, _FRAMES)
    return (
        Camera(recording.usecase or '', effects=effects, seed=seed)
        .capture(
            clean[frames] if clean.ndim == 3 else clean,
            recording.K,
            recording.stamp_ns[frames],
            known[frames] if known is not None and known.ndim == 3 else known,
        )
        .depth
    )


def _simulated(
    recordings: list[Recording], scenes: list[_Scene], effects: Any, seed: int
) -> list[_Sample]:
    return [
        _sample(scene, _simulate(recording, effects, seed + 1))
        for recording, scene in zip(recordings, scenes, strict=True)
    ]


def _scene(recording: Recording) -> _Scene:
    clean = np.asarray(recording.clean_depth, np.float32)
    stack = clean[:_FRAMES] if clean.ndim == 3 else clean[None]
    height, width = clean.shape[-2:]
    camera = Intrinsics.from_matrix(recording.K, width, height)
    mode = Camera(recording.usecase or '').mode
    first = np.ascontiguousarray(stack[0])
    surface = analyse(first, camera, mode.sensor)
    sigma = np.nan_to_num(mode.noise.sigma_z(first, surface.incidence), nan=1.0)
    y, x = np.mgrid[:height, :width]
    jump = (surface.row_jumps + surface.column_jumps) > 0
    near = jump | np.roll(jump, 1, 0) | np.roll(jump, 1, 1) | np.roll(jump, 2, 1)
    known = recording.reflectivity
    rho = 0.6 if known is None else known[0] if known.ndim == 3 else known
    with np.errstate(divide='ignore', invalid='ignore'):
        amplitude = np.log10(np.maximum(rho * surface.cos_incidence / first**2, 1e-4))
    uptime = float(np.ravel(recording.extra.get('uptime', np.zeros(1)))[0])
    images = (
        first,
        surface.incidence,
        np.hypot(x - camera.cx, y - camera.cy),
        amplitude,
        near.astype(float),
        np.full(first.shape, uptime),
    )
    keep = (np.isfinite(first) & (first < mode.range_max)).ravel()
    return _Scene(
        stack,
        np.maximum(sigma, 1e-6),
        keep,
        np.stack([np.nan_to_num(image).ravel()[keep] for image in images], axis=1),
    )


def _sample(scene: _Scene, depth: np.ndarray) -> _Sample:
    depth = depth[:_FRAMES]
    residual = np.clip((depth - scene.clean) / scene.sigma, -6, 6)
    beside = np.roll(residual, -1, axis=2)
    return _Sample(
        residual.reshape(len(depth), -1)[:, scene.keep],
        beside.reshape(len(depth), -1)[:, scene.keep],
        scene.covariates,
    )


def _edges(samples: list[_Sample]) -> list[np.ndarray]:
    pooled = np.concatenate([sample.covariates[::7] for sample in samples])
    return [
        np.unique(np.quantile(pooled[:, k], np.linspace(0, 1, _BINS + 1)[1:-1]))
        if _AXES[k] != 'edge'
        else np.array([0.5])
        for k in range(len(_AXES))
    ]


def _places(scene: _Scene, edges: list[np.ndarray]) -> list[np.ndarray]:
    # The bins of the pixels along each axis.
    return [np.digitize(scene.covariates[:, k], cuts) for k, cuts in enumerate(edges)]


def _features(samples: list[_Sample], places: list[list[np.ndarray]]) -> np.ndarray:
    # (channels, axes, bins), in tolerances.
    out = np.zeros((len(_CHANNELS), len(_AXES), _BINS))
    sums = np.zeros((len(_AXES), _BINS, 9))
    for sample, bins in zip(samples, places, strict=True):
        e, b = sample.residual, sample.beside
        valid, pair = np.isfinite(e), np.isfinite(e) & np.isfinite(b)
        late = valid[1:] & valid[:-1]
        # Spread and correlations are over time, so an error of pose does not change them.
        mean_e, mean_b = (
            np.nan_to_num(image).sum(0) / np.maximum(np.isfinite(image).sum(0), 1)
            for image in (e, b)
        )
        zero = np.nan_to_num(e)
        around, other = np.nan_to_num(e - mean_e), np.nan_to_num(b - mean_b)
        parts = np.stack(
            [
                np.full(e.shape[1], len(e)),
                valid.sum(0),
                zero.sum(0),
                (around**2).sum(0),
                (np.abs(zero) >= 6).sum(0),
                late.sum(0),
                (around[1:] * around[:-1] * late).sum(0),
                pair.sum(0),
                (around * other * pair).sum(0),
            ],
            axis=1,
        ).astype(float)
        for k, place in enumerate(bins):
            for s in range(9):
                sums[k, :, s] += np.bincount(place, parts[:, s], _BINS)
    n, v = np.maximum(sums[..., 0], 1), np.maximum(sums[..., 1], 1)
    variance = np.maximum(sums[..., 3] / v, 1e-3)
    out[0], out[1] = sums[..., 2] / v, np.log(variance)
    out[2], out[3] = 1 - sums[..., 1] / n, sums[..., 4] / v
    out[4] = sums[..., 6] / np.maximum(sums[..., 5], 1) / variance
    out[5] = sums[..., 8] / np.maximum(sums[..., 7], 1) / variance
    out[:, sums[..., 0] < 200] = 0
    return out / np.array(list(_TOLERANCE.values()))[:, None, None]


def _largest(gap: np.ndarray) -> str:
    # The channel with the largest gap, and the axis along which it varies most.
    size = np.abs(gap).max(axis=(1, 2)) / _USUAL
    channel = int(size.argmax())
    if size[channel] < 1:
        return 'none'
    return _read(_CHANNELS[channel], _AXES[int(np.ptp(gap[channel], axis=1).argmax())])


def _read(channel: str, axis: str) -> str:
    # What a person would conclude from the largest gap alone.
    said = {reading: kind.name for kind in registry().values() for reading in kind.reads_as}
    return said.get((channel, axis), said[channel, ''])


def _bic(gap: np.ndarray, templates: Iterable[tuple[str, np.ndarray]]) -> str:
    # Fits a multiple of the change by each effect at its default parameters to all data.
    wanted = np.clip(gap, -30, 30).ravel()
    count = wanted.size
    scores = {'none': count * np.log((wanted**2).mean() + 1) - _USUAL_BIC}
    for name, template in templates:
        if template @ template < 1:  # It changes nothing in these scenes.
            continue
        size = float(template @ wanted) / float(template @ template)
        left = wanted - max(size, 0.0) * template
        scores[name] = count * np.log((left**2).mean() + 1) + np.log(count)
    return min(scores, key=lambda name: scores[name])


def _templates(
    recordings: list[Recording],
    scenes: list[_Scene],
    places: list[list[np.ndarray]],
    base: np.ndarray,
    seed: int,
) -> Iterator[tuple[str, np.ndarray]]:
    for name in sorted(CATALOGUE):
        samples = _simulated(recordings, scenes, {name: {'strength': 1.0}}, seed)
        yield name, np.clip(_features(samples, places) - base, -30, 30).ravel()


def _classifier(real: list[_Sample], plain: list[_Sample], seed: int) -> str:
    # A random forest distinguishes recordings from simulations; its most important features
    # give the answer.
    from sklearn.ensemble import RandomForestClassifier

    rows, labels = [], []
    rng = np.random.default_rng(seed)
    for label, samples in enumerate((plain, real)):
        for sample in samples:
            chosen = rng.integers(sample.residual.shape[1], size=600)
            e, b = sample.residual[:, chosen], sample.beside[:, chosen]
            mean = np.nan_to_num(e).mean(0)
            around, beside = np.nan_to_num(e - mean), np.nan_to_num(b - b.mean(0))
            rows.append(
                np.column_stack(
                    [
                        mean,
                        np.abs(around[1]),
                        np.isnan(e[1]),
                        np.abs(np.nan_to_num(e[1])) >= 6,
                        around[1] * around[0],
                        around[1] * beside[1],
                        sample.covariates[chosen],
                    ]
                )
            )
            labels.append(np.full(600, label))
    table, target = np.concatenate(rows), np.concatenate(labels)
    forest = RandomForestClassifier(
        60, min_samples_leaf=20, oob_score=True, n_jobs=1, random_state=seed % 2**31
    )
    forest.fit(table, target)
    if forest.oob_score_ < _USUAL_ACCURACY:
        return 'none'
    weight = forest.feature_importances_
    channels = len(_CHANNELS)
    return _read(
        _CHANNELS[int(weight[:channels].argmax())], _AXES[int(weight[channels:].argmax())]
    )
