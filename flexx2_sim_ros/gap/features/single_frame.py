"""One frame of a recording, real and simulated, for the report."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
import numpy as np

_WIDEST = 224  # pixels; larger images are thinned out
_AXES = tuple(name for name in AXES if name != 'tile')


@dataclass(frozen=True)
class SingleFrame:
    """
    One frame, and the same simulated without and with effects.

    `index` is its place in the recording. `depth` is (3, h, w) float32 metres, NaN where invalid:
    real, without and with effects; at most 224 pixels wide and high. `places` is (h, w) int8 bin
    of each pixel along each of `AXES` but ``tile``, -1 for none.
    """

    index: int
    depth: np.ndarray
    places: dict[str, np.ndarray]


def single_frame(
    index: int, depths: Sequence[np.ndarray], scenes: Sequence[PixelCovariates]
) -> SingleFrame:
    """
    Put together what the report shows of a frame.

    `depths` are (H, W) metres: real, without and with effects; `scenes` is one, or one a frame.
    """
    scene = scenes[index] if len(scenes) > 1 else scenes[0]
    step = -(-max(scene.clean.shape) // _WIDEST)
    return SingleFrame(
        index,
        np.array([depth[::step, ::step] for depth in depths], np.float32),
        {name: scene.places(name)[::step, ::step].astype(np.int8) for name in _AXES},
    )
