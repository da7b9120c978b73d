"""Fit how large an effect is that the poses of recordings hide, from how much they scatter."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.shapes import Scale
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.bias_fit import misfit, usual_factor
from flexx2_sim_ros.gap.forms.samples import Samples, shift_of
from flexx2_sim_ros.gap.forms.shape_search import lowest, Numbers
import numpy as np

_DIGITS = 4  # after the decimal point


@dataclass(frozen=True)
class ScaleColumns:
    """
    How the depth of one recording's samples changes with an effect's scale.

    (N,) `shifts`, metres at a scale of 1, for each variant. (N,) bool `surfaces`: the same surface
    is seen all the time; where an edge passes, the shift is not proportional to the scale.
    """

    shifts: tuple[np.ndarray, ...]
    surfaces: np.ndarray

    @property
    def none(self) -> bool:
        """Whether the effect shifts no surface here, as in a still scene."""
        shifts = (shift[self.surfaces] for shift in self.shifts)
        return not any((np.abs(shift) > FORMS.equal).any() for shift in shifts)


def columns_of(scene: PlacedScene, samples: Samples, effect: str) -> ScaleColumns:
    """Return how the depth of a recording's samples changes with an effect's `Scale`."""
    if registry()[effect].needs_motion and not scene.moving:
        nothing = np.zeros(len(samples.place))
        return ScaleColumns(tuple(nothing for _ in scale_of(effect).variants), nothing == 0)
    scale = scale_of(effect)
    every = [shift_of(scene, {effect: scale.settings(1.0, one)}) for one in scale.variants]
    given = shift_of(scene, {})
    frame = samples.place // given[0].size
    shifts = [(one - given).ravel()[samples.place].astype(np.float64) for one in every]
    return ScaleColumns(
        tuple(shifts), np.all([_is_rigid(one, samples.own[:POSE], frame) for one in shifts], 0)
    )


def _is_rigid(shift: np.ndarray, own: np.ndarray, frame: np.ndarray) -> np.ndarray:
    # Whether (N,) shifts are those of a rigid scene past which the camera moves: in each frame a
    # sum of what the six parts of a pose change, (6, N).
    fraction, least = FORMS.rigid
    out = np.zeros(len(shift), bool)
    for t in np.unique(frame):
        there = frame == t
        A, b = own[:, there], shift[there]
        weight = np.ones(len(b))
        for _ in range(FORMS.iterations):
            root = np.sqrt(weight)
            fitted = np.linalg.lstsq((A * root).T, b * root, rcond=None)[0] @ A
            off = np.abs(b - fitted)
            usual = max(float(np.median(off)), FORMS.equal)
            weight = 1 / (1 + (off / usual) ** 2) ** 2
        out[there] = off < np.maximum(fraction * np.abs(fitted), least)
    return out


def scale_of(effect: str) -> Scale:
    """Return which parameter of an effect is fitted."""
    scale = registry()[effect].scale
    assert scale is not None
    return scale


def pose_width(samples: Sequence[Samples], columns: Sequence[ScaleColumns]) -> float:
    """
    Return how wide the poses are that an effect does not change, as a fraction of their prior.

    A shift that all frames of a recording share looks like another pose. But then the poses of the
    recordings that have it are farther off than those of the others. 1 where there are too few
    others. The samples are with errors that other effects do not explain.
    """
    still = [one for one, own in zip(samples, columns, strict=True) if own.none]
    return usual_factor(still) if len(still) >= FORMS.fewest else 1.0


def fit_scale(
    effect: str, samples: Sequence[Samples], columns: Sequence[ScaleColumns]
) -> list[Numbers]:
    """
    Fit an effect's scale together with the poses, and choose its variant.

    The samples are with errors that other effects do not explain, and priors of the poses as wide
    as these usually are. Return settings fitted to all recordings, and to all but one, in the
    variant that suits all best.
    """
    scale = scale_of(effect)
    values = np.linspace(0.0, scale.most, FORMS.scales)
    losses = np.array(
        [_losses(one, own, values) for one, own in zip(samples, columns, strict=True)]
    )
    total = losses.sum(axis=0)
    variant = int(total.min(axis=1).argmin())
    return [
        scale.settings(round(_lowest(values, some[variant]), _DIGITS), scale.variants[variant])
        for some in (total, *(total - losses))
    ]


def _losses(samples: Samples, columns: ScaleColumns, values: np.ndarray) -> np.ndarray:
    # (V, K) of a recording, for each variant and value.
    if columns.none:
        return np.zeros((len(columns.shifts), len(values)))
    some = columns.surfaces
    kept = replace(
        samples, error=samples.error[some], sigma=samples.sigma[some], own=samples.own[:, some]
    )
    return np.array(
        [
            [misfit(kept, kept.error - value * shift[some]) for value in values]
            for shift in columns.shifts
        ]
    )


def _lowest(values: np.ndarray, losses: np.ndarray) -> float:
    k = int(losses.argmin())
    if not 0 < k < len(values) - 1:
        return float(values[k])
    return lowest(values[k - 1 : k + 2], losses[k - 1 : k + 2])
