"""Small groups of pixels that are alike, and what an effect changes in each."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES, ENDLESS
from flexx2_sim_ros.gap.data.covariates import PixelCovariates, sort_everywhere, speed_of
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.pixel_patterns import (
    add_errors,
    GROUP_FRAMES,
    GROUP_METRES,
    GROUP_NEIGHBOURS,
    GROUP_WIDTH,
)
import numpy as np

GROUP_CHANNELS = ('bias', 'log_variance', 'invalid', 'high', 'low', 'lag', 'neighbour')
GROUP_TOLERANCE = np.array([FEATURES.tolerances[name] for name in GROUP_CHANNELS])
_BINS = WHERE.groups  # distance, incidence, region, edge, dark
_SAMPLES = WHERE.samples
_PER_FRAME, _FEWEST = WHERE.pixels


@dataclass(frozen=True)
class PixelGroups:
    """
    The groups of a recording.

    * `count`: (N,) pixels, over all frames.
    * `effect`, `real`: (N, 7) what effects change and what the real camera shows beyond the plain
      simulation; `GROUP_CHANNELS`.
    * `bias`: (N,) how much farther the real camera's mean depth is, metres.
    * `limit`, `real_limit`: (N, 7) beyond which a difference matters and is no noise.
    * `samples`: (N, 12, A) int16: bins of some of their pixels along `ENDLESS`, -1 where there are
      fewer.
    """

    count: np.ndarray
    effect: np.ndarray
    real: np.ndarray
    bias: np.ndarray
    limit: np.ndarray
    real_limit: np.ndarray
    samples: np.ndarray


class GroupSums:
    """
    Which group each pixel belongs to, and sums over them.

    `clean` and `reflectivity` are (H, W) or (T, H, W) as the camera really stood, `scenes` their
    covariates; reflectivity may be None.
    """

    def __init__(
        self,
        recording: RecordingData,
        clean: np.ndarray,
        reflectivity: np.ndarray | None,
        scenes: Sequence[PixelCovariates],
    ) -> None:
        """Sort the pixels."""
        frames = clean if clean.ndim == 3 else clean[None]
        self._clean = np.ascontiguousarray(frames)
        self._sigma = np.array([scene.sigma for scene in scenes])
        self._count = math.prod(_BINS)
        self.samples = np.full((self._count, _SAMPLES, len(ENDLESS)), -1, np.int16)
        self._filled = np.zeros(self._count, np.int64)
        self._cells = np.empty(frames.shape, np.int32)
        rng = np.random.default_rng(0)
        for t, image in enumerate(frames):
            rho = at_frame(reflectivity, t)
            before = max(t - 1, 0)
            interval = float(recording.stamp[t] - recording.stamp[before]) * 1e-9
            with np.errstate(invalid='ignore'):
                speed = speed_of(image, frames[before], interval) if interval > 0 else None
            bins, incidence = sort_everywhere(
                image, speed, rho, recording.K, recording.mode.sensor, recording.axes
            )
            self._cells[t] = _cells(
                image, rho, incidence, bins, recording.mode.range_max, scenes[t].compared
            )
            if len(frames) == 1 or t % 3 == 0:
                self._sample(
                    self._cells[t], bins, rng, _SAMPLES if len(frames) == 1 else _SAMPLES // 4
                )

    def _sample(
        self, cells: np.ndarray, bins: np.ndarray, rng: np.random.Generator, most: int
    ) -> None:
        # Pixels group by group, shuffled within each.
        flat, rows = cells.ravel(), bins.reshape(len(bins), -1).T
        order = np.lexsort((rng.random(flat.size), flat))
        order = order[flat[order] >= 0]
        groups, first, number = np.unique(flat[order], return_index=True, return_counts=True)
        for i in range(most):
            left = (number > i) & (self._filled[groups] < _SAMPLES)
            self.samples[groups[left], self._filled[groups[left]]] = rows[order[first[left] + i]]
            self._filled[groups[left]] += 1

    def add(self, depth: np.ndarray) -> np.ndarray:
        """Return sums of (T, H, W) depth, (groups, GROUP_WIDTH)."""
        out = np.zeros((self._count, GROUP_WIDTH))
        add_errors(depth, self._clean, self._sigma, self._cells, out)
        return out

    def groups(
        self,
        real: np.ndarray,
        before: Sequence[np.ndarray],
        after: Sequence[np.ndarray],
        frames: int,
    ) -> PixelGroups:
        """
        Compare sums of the recording with those of simulations, all of so many `frames`.

        Each pair of simulations `before` and `after`, without and with effects, has the same
        random numbers.
        """
        enough = real[:, 0] >= max(_PER_FRAME * frames, _FEWEST)
        plain = [_features(sums[enough]) for sums in before]
        some = [_features(sums[enough]) for sums in after]
        own, number = _features(real[enough]), real[enough, 0]
        base = np.mean(plain, axis=0)
        edge = np.arange(self._count)[enough] // _BINS[4] % _BINS[3]
        alone = np.sqrt(2 * (1 + (WHERE.edge_pixels - 1) * edge) / number)[:, None]
        rates = base[:, 2:5]
        deviation = np.hstack(
            [
                np.exp(base[:, 1:2] / 2),
                np.full((len(base), 1), WHERE.deviation),
                np.sqrt(np.clip(rates * (1 - rates), 0, 1) + 1 / number[:, None]),
                np.ones((len(base), 2)),
            ]
        )
        noise = np.nan_to_num(WHERE.standard_errors * alone * deviation)
        # Common random numbers: fractions of lost or gross pixels have no noise.
        seen = np.where(np.isin(GROUP_CHANNELS, ('invalid', 'high', 'low')), 0, noise)
        few = (
            np.minimum(real[enough, 1], np.mean([sums[enough, 1] for sums in before], axis=0))
            < max(_PER_FRAME * frames, _FEWEST) / 3
        )

        def differences(values: np.ndarray, from_: np.ndarray) -> np.ndarray:
            out = np.nan_to_num(values - from_)
            # Too few valid pixels in one of them: only the fraction of invalid ones is compared.
            out[few] *= np.array(GROUP_CHANNELS) == 'invalid'
            return out

        def metres(sums: np.ndarray) -> np.ndarray:
            count, total = sums[enough, GROUP_METRES : GROUP_METRES + 2].T
            return np.where(few, 0, total / np.maximum(count, 1))

        return PixelGroups(
            number,
            np.mean([differences(a, b) for a, b in zip(some, plain, strict=True)], axis=0),
            differences(own, base),
            metres(real) - np.mean([metres(sums) for sums in before], axis=0),
            np.maximum(GROUP_TOLERANCE, seen),
            np.maximum(GROUP_TOLERANCE, noise),
            self.samples[enough],
        )


def _cells(
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    incidence: np.ndarray,
    bins: np.ndarray,
    farthest: float,
    compared: np.ndarray,
) -> np.ndarray:
    # (H, W) int32, -1 where nothing is or nothing is known.
    region = bins[ENDLESS.index('region')] - AXES['region'].start
    edge = bins[ENDLESS.index('edge')] >= 0
    dark = np.zeros(clean.shape, bool) if reflectivity is None else reflectivity < WHERE.dark
    far = np.clip(
        np.nan_to_num(clean) / min(farthest, WHERE.distances) * _BINS[0], 0, _BINS[0] - 0.01
    ).astype(int)
    cell = np.zeros(clean.shape, int)
    for index, count in zip(
        (far, np.digitize(incidence, WHERE.steep), region, edge, dark), _BINS, strict=True
    ):
        cell = cell * count + index
    with np.errstate(invalid='ignore'):
        return np.where(compared & np.isfinite(clean) & (clean > 0), cell, -1).astype(np.int32)


def _features(sums: np.ndarray) -> np.ndarray:
    # (N, 7), NaN for none.
    number, valid, total, square, high, low = sums.T[:GROUP_FRAMES]
    with np.errstate(divide='ignore', invalid='ignore'):
        mean = total / valid
        variance = np.maximum(square / valid - mean**2, 1e-4)
        return np.stack(
            [
                mean,
                np.log(variance),
                1 - valid / number,
                high / valid,
                low / valid,
                _correlation(sums, GROUP_FRAMES),
                _correlation(sums, GROUP_NEIGHBOURS),
            ],
            axis=1,
        )


def _correlation(sums: np.ndarray, start: int) -> np.ndarray:
    # Pearson's, (N,), of pairs; 0 where their errors are all alike.
    count, one, other, one2, other2, product = sums.T[start : start + 6]
    spread = np.sqrt(
        np.maximum(one2 - one**2 / count, 0) * np.maximum(other2 - other**2 / count, 0)
    )
    return np.where(
        spread > WHERE.least_variance * count, (product - one * other / count) / spread, 0
    )
