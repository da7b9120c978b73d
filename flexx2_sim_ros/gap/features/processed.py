"""How far recordings and simulation are apart after a robot's own processing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.features import MEASURES
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.registration import Placed, RecordingData
from flexx2_sim_ros.gap.features.confirm import Apart, apart, measured_parts, seen_in
from flexx2_sim_ros.gap.features.simulation import PlacedScene, Scenes
from flexx2_sim_ros.processing import Chain, Stage
import numpy as np


class Processed(NamedTuple):
    """
    A recording against its simulations, all of them processed.

    `apart` is without and with the effects; `parts`, (4,), what each effect takes off: see
    `confirm.parts`.
    """

    apart: Apart
    parts: dict[str, np.ndarray]


def process_both(
    scene: PlacedScene,
    effects: dict[str, Any],
    stages: Sequence[Stage],
    seed: int,
    bare: np.ndarray | None = None,
) -> Processed | str:
    """
    Process a recording and its simulations, and compare them; parameters as for `confirm.confirm`.

    The random numbers are those of `confirm.confirm`, too. `stages` is what the robot's program
    does to depth; metres throughout. The result is the reason when the images are too small for
    the stages, or too few depths are left.
    """
    try:
        side = ProcessedScene.of(scene, stages)
    except InputError as error:
        return str(error)
    left = seen_in(side, side.recording.depth, effects).measures.normal.sum(axis=1)
    if not (left > MEASURES.fewest).any():
        return (
            f'{scene.recording.name}: process: must leave more than {MEASURES.fewest} depths in a '
            'part of the image, got fewer'
        )
    found = apart(side, effects, seed, bare)
    return Processed(found, measured_parts(side, effects, seed, found))


@dataclass(frozen=True)
class ProcessedScene(PlacedScene):
    """
    The scene of a recording as the processed images show it.

    It has the lens, the frames and the clean depth of the processed images; clean depth is
    processed as depth is. `unprocessed` is the recording's scene, which is simulated.
    """

    stages: tuple[Stage, ...]
    unprocessed: PlacedScene

    @classmethod
    def of(cls, scene: PlacedScene, stages: Sequence[Stage]) -> 'ProcessedScene':
        """Return the processed scene of a recording."""
        recording, placed, chain = scene.recording, scene.placed, Chain(stages)
        height, width = recording.depth.shape[1:]
        lens = chain.lens(Intrinsics.from_matrix(recording.K, width, height))
        depth, frames, fresh = _run(stages, recording, recording.depth)
        if scene.moving:
            clean = _run(stages, recording, placed.clean)[0]
        else:
            clean = chain.run(placed.clean[np.newaxis], [0])[0][0]
        light, known = (
            _picked(chain, image, frames) for image in (placed.reflectivity, placed.known)
        )
        border = math.ceil(placed.border * clean.shape[-1] / width)
        shown = Placed(clean, light, known, border)
        small = replace(
            recording,
            depth=depth,
            clean=clean,
            K=lens.matrix,
            stamp=recording.stamp[frames],
            fresh=fresh,
        )
        return cls(small, shown, Scenes(small, shown), tuple(stages), scene)

    def without(self, bare: np.ndarray | None) -> PlacedScene:
        """Return the scene to simulate where it is without effects."""
        return replace(self, unprocessed=self.unprocessed.without(bare))

    def simulate(self, effects: Any, seed: int) -> np.ndarray:
        """Return processed images, (t, h, w) metres, of the simulation with effects."""
        images = self.unprocessed.simulate(effects, seed)
        return _run(self.stages, self.unprocessed.recording, images)[0]


def _picked(chain: Chain, image: Any, frames: np.ndarray) -> Any:
    # Images beside depth, at its pixels and of its frames.
    return None if image is None else chain.picked(at_frame(image, frames))


def _run(
    stages: Sequence[Stage], recording: RecordingData, images: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Processed images, which frames they are of, and whether each is the first after a gap. After
    # a gap the program begins anew.
    parts, stamps, fresh = [], [], []
    starts = np.union1d(0, np.flatnonzero(recording.fresh))
    for start, end in zip(starts, [*starts[1:], len(images)], strict=True):
        part, kept = Chain(stages).run(images[start:end], recording.stamp[start:end])
        parts.append(part)
        stamps.append(kept)
        fresh += [True] + [False] * (len(kept) - 1)
    frames = np.searchsorted(recording.stamp, np.concatenate(stamps))
    return np.concatenate(parts), frames, np.array(fresh)
