"""What recordings have in common, pixel by pixel: a fixed pattern, or the very same noise."""

from collections.abc import Sequence

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
import numpy as np


def repeats(grains: Sequence[np.ndarray]) -> np.ndarray:
    """Return how alike each recording's static pattern is to the others' mean, (R,)."""
    out = np.full(len(grains), np.nan)
    if len(grains) < 2 or len({g.shape for g in grains}) > 1:
        return out
    stack = np.clip(np.array(grains, dtype=np.float32), -3, 3)
    good = np.isfinite(stack)
    filled = np.where(good, stack, 0)
    total, number = filled.sum(axis=0), good.sum(axis=0)
    for r in range(len(grains)):
        shared = good[r] & (number - good[r] >= max(1, (len(grains) - 1) // 2))
        if shared.sum() > 500:
            others = (total - filled[r])[shared] / (number - good[r])[shared]
            own = filled[r][shared]
            spread = own.std() * others.std()
            out[r] = (
                float(np.mean((own - own.mean()) * (others - others.mean())) / spread)
                if spread > 0
                else 0.0
            )
    return out


def fingerprint(depth: np.ndarray, scenes: Sequence[PixelCovariates]) -> np.ndarray:
    """
    Return what the first frame's noise is, by which the same noise is known in another recording.

    `depth` is (T, H, W) float32 metres, NaN where invalid. The result is (N,) float16, sigma: the
    first frame's errors less their mean over frames, of some of the pixels; NaN where there is
    none, all of them in a single frame.
    """
    clean = np.stack([scene.clean for scene in scenes])
    with np.errstate(invalid='ignore'):
        error = (depth - clean) / np.stack([scene.sigma for scene in scenes])
        noise = (error[0] - error.mean(axis=0)).ravel()
    if len(depth) < 2:
        noise = np.full_like(noise, np.nan)
    noise = noise[:: max(noise.size // FEATURES.same_noise_samples, 1)]
    return np.clip(noise, -6, 6).astype(np.float16)


def same_noise(fingerprints: Sequence[np.ndarray]) -> list[int | None]:
    """Return for each recording the first other one that has the very same noise, if any has."""
    out: list[int | None] = [None] * len(fingerprints)
    for size in {len(one) for one in fingerprints}:
        index = [i for i, one in enumerate(fingerprints) if len(one) == size]
        noise = np.array([fingerprints[i] for i in index], np.float32)
        known = np.isfinite(noise)
        noise = np.where(known, noise, 0)
        square = noise**2
        spread = np.sqrt((square @ known.T) * (known.astype(np.float32) @ square.T))
        number = known.astype(np.float32) @ known.T
        alike = (noise @ noise.T > FEATURES.same_noise * spread) & (
            number >= FEATURES.same_noise_fewest
        )
        np.fill_diagonal(alike, False)
        for i, row in zip(index, alike, strict=True):
            if row.any():
                out[i] = index[int(np.argmax(row))]
    return out
