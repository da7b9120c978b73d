"""How far recordings and simulation are apart after a robot's own processing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.features import MEASURES
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.registration import Placed
from flexx2_sim_ros.gap.features.confirm import (
    Apart,
    apart_in,
    parts,
    placed_without,
    Seen,
    seen_in,
    simulated,
)
from flexx2_sim_ros.gap.features.simulation import PlacedScene, Scenes, warm_of
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
) -> Processed:
    """
    Process a recording and its simulations, and compare them; parameters as for `confirm.confirm`.

    The random numbers are those of `confirm.confirm`, too. `stages` is what the robot's program
    does to depth; metres throughout. Raises `InputError` when the images are too small for the
    stages, or too few depths are left.
    """
    side = ProcessedScene.of(scene, stages)

    def look(depth: np.ndarray) -> Seen:
        return seen_in(side.scene, side.depth(depth), effects)

    def look_at(where: PlacedScene, table: dict[str, Any]) -> list[Seen]:
        return [look(depth) for depth in simulated(where, table, seed)]

    real = look(scene.recording.depth)
    if not (real.measures.normal.sum(axis=1) > MEASURES.fewest).any():
        raise InputError(
            f'{scene.recording.name}: process: must leave more than {MEASURES.fewest} depths in a '
            'part of the image, got fewer'
        )
    before = look_at(placed_without(scene, bare), {})
    after = look_at(scene, effects) if effects else before
    apart = apart_in(real, before, after)

    def far(some: dict[str, Any]) -> np.ndarray:
        if len(some) in (0, len(effects)):
            return apart.far(int(bool(some)))
        return apart_in(real, before, look_at(scene, some)).far(1)

    return Processed(apart, parts(effects, far))


def process_both_or_why(scene: PlacedScene, **more: Any) -> Processed | str:
    """Return what `process_both` does, or why it cannot."""
    try:
        return process_both(scene, **more)
    except InputError as error:
        return str(error)


@dataclass(frozen=True)
class ProcessedScene:
    """
    The scene of a recording as the processed images show it.

    `scene` has the lens, the frames and the clean depth of the processed images; clean depth is
    processed as depth is. `unprocessed` is the recording's.
    """

    scene: PlacedScene
    stages: tuple[Stage, ...]
    unprocessed: PlacedScene

    @classmethod
    def of(cls, scene: PlacedScene, stages: Sequence[Stage]) -> 'ProcessedScene':
        """Return the processed scene of a recording."""
        recording, placed, chain = scene.recording, scene.placed, Chain(stages)
        height, width = recording.depth.shape[1:]
        lens = chain.lens(Intrinsics.from_matrix(recording.K, width, height))
        depth, frames, fresh = _run(stages, scene, recording.depth)
        if scene.moving:
            clean = _run(stages, scene, placed.clean)[0]
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
        made = PlacedScene(small, shown, Scenes(small, shown), warm_of(fresh))
        return cls(made, tuple(stages), scene)

    def depth(self, images: np.ndarray) -> np.ndarray:
        """Return processed images, (t, h, w), of those of the recording, (T, H, W)."""
        return _run(self.stages, self.unprocessed, images)[0]


def _picked(chain: Chain, image: Any, frames: np.ndarray) -> Any:
    # Images beside depth, at its pixels and of its frames.
    return None if image is None else chain.picked(at_frame(image, frames))


def _run(
    stages: Sequence[Stage], scene: PlacedScene, images: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Processed images, which frames they are of, and whether each is the first after a gap. After
    # a gap the program begins anew.
    recording, parts, stamps, fresh = scene.recording, [], [], []
    starts = np.union1d(0, np.flatnonzero(recording.fresh))
    for start, end in zip(starts, [*starts[1:], len(images)], strict=True):
        part, kept = Chain(stages).run(images[start:end], recording.stamp[start:end])
        parts.append(part)
        stamps.append(kept)
        fresh += [True] + [False] * (len(kept) - 1)
    frames = np.searchsorted(recording.stamp, np.concatenate(stamps))
    return np.concatenate(parts), frames, np.array(fresh)
