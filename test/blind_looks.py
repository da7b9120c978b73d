"""What blind cameras see of small scenes, with effects and without."""

from functools import lru_cache

import numpy as np
from study.blind import BlindCamera, Case, Internals, SceneKey, SceneSet

BOARD, FORWARD, CORNER, CLOSE, SIDEWAYS, STAIRS, FAR, TURNING = range(8)
STILL = BOARD, CORNER, CLOSE, STAIRS


MODES = ('Mode_5_30fps', 'Mode_9_30fps')


@lru_cache(maxsize=4)
def scenes(usecase, pose_mm=0.0):
    """Return small scenes, rendered once."""
    return SceneSet(SceneKey(usecase, 5, pose_mm, 112, 86, frames=8))


class Look:
    """A camera's residuals on one recording, over the paper's sigma; (T, H, W)."""

    def __init__(self, effects, recording, usecase=MODES[0], inside=None):
        """Take the frames."""
        here = scenes(usecase)
        case = Case(here.key, dict(effects), 3, sigma_error=0.0, internals=inside or Internals())
        camera = BlindCamera(case, here)
        views = [here.true_view(recording, i) for i in range(here.key.frames)]
        self.depth = np.stack([frame.depth for frame in camera.frames(recording)])
        self.clean = np.stack([view.depth for view in views])
        self.sigma = np.stack([view.sigma for view in views])
        self.amplitude = np.stack([view.amplitude for view in views])
        self.cosine = np.stack([view.cosine for view in views])
        self.edge = np.stack([view.near_edge for view in views])
        self.error = self.depth - self.clean
        self.residual = np.where(self.sigma > 0, self.error / np.maximum(self.sigma, 1e-9), np.nan)
        self.invalid = np.isnan(self.depth)
        # Where the paper's sigma is a small share of the range: no phase but a Gaussian one.
        self.flat = ~self.edge & (self.sigma < 0.1) & (self.sigma > 0)

    def bias(self, where=None):
        """Return the median error on surfaces, metres."""
        chosen = self.flat if where is None else self.flat & where
        return float(np.nanmedian(self.error[chosen]))

    def spread(self):
        """Return the spread over time, in sigmas."""
        around = self.residual - np.nanmean(self.residual, axis=0)
        chosen = self.flat & np.isfinite(around)
        return float(np.clip(around[chosen], -6, 6).std() / np.sqrt(1 - 1 / len(around)))


@lru_cache(maxsize=16)
def plain(recording, usecase=MODES[0]):
    """Return what a camera without effects sees."""
    return Look({}, recording, usecase)


def correlation(one, other, where):
    chosen = where & np.isfinite(one) & np.isfinite(other)
    return float(np.corrcoef(one[chosen], other[chosen])[0, 1])
