"""Simulation of a recording's scene: without effects, and with effects (common random numbers)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import ageing, Effect, loadable
from flexx2_sim_ros.effects.patch import ResidualPatch
from flexx2_sim_ros.gap.calibration.features import FEATURES, SIMULATION
from flexx2_sim_ros.gap.data.covariates import look_at, PixelCovariates
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.given import together
from flexx2_sim_ros.gap.data.pose import base_camera
from flexx2_sim_ros.gap.data.registration import place, Placed, RecordingData
from flexx2_sim_ros.gap.data.unknown import PLANE_STEPS
from flexx2_sim_ros.gap.features.features import features, SIZE
from flexx2_sim_ros.gap.features.sums import accumulate, Sums
import numpy as np


@dataclass(frozen=True)
class PlacedScene:
    """
    A recording with its registered scene.

    `placed` is clean depth and reflectivity from the fitted pose; `covariates` is one for a still
    scene, otherwise one for each frame.
    """

    recording: RecordingData
    placed: Placed
    covariates: Sequence[PixelCovariates]

    @classmethod
    def at(cls, recording: RecordingData, motion: np.ndarray) -> 'PlacedScene':
        """Return the scene where the camera was moved by ``motion``, as for `place`."""
        placed = place(recording, motion)
        return cls(recording, placed, Scenes(recording, placed))

    def without(self, bare: np.ndarray | None) -> 'PlacedScene':
        """Return the scene to simulate where it is without effects, as for `confirm.confirm`."""
        return self if bare is None else PlacedScene.at(self.recording, bare)

    @property
    def moving(self) -> bool:
        """Return whether each frame has a clean image of its own."""
        return self.placed.clean.ndim == 3

    @property
    def warm(self) -> int:
        """Return how many frames a camera gets to settle in after each gap; they are left out."""
        fresh = self.recording.fresh
        return SIMULATION.settling if len(fresh) >= 6 and fresh.sum() <= len(fresh) / 6 else 0

    def sums(self, depth: np.ndarray) -> Sums:
        """Return the sums over (T, H, W) depth of this scene, metres."""
        return accumulate(depth, self.covariates, self.recording.fresh, self.warm)

    def simulate(self, effects: Any, seed: int) -> np.ndarray:
        """Return (T, H, W) metres, as the simulator with given and other effects sees it."""
        recording, placed = self.recording, self.placed
        camera = base_camera(recording.mode, recording.profile, seed, recording.name)
        scene = placed.clean, recording.K, recording.stamp, placed.reflectivity
        if recording.given:
            effects = together(recording.given, effects)
        if effects:  # Faster for a still scene, whose frames have much in common.
            return CommonRandomNumbers(camera, *scene).depth(effects)
        return camera.capture(*scene).depth


class Scenes(Sequence[PixelCovariates]):
    """Covariates of each frame, or of the image of a still scene, made when asked for."""

    def __init__(self, recording: RecordingData, placed: Placed) -> None:
        """Remember what they are made of."""
        self._recording, self._placed = recording, placed
        self._made: dict[int, PixelCovariates] = {}

    def __len__(self) -> int:
        """Return the number of clean images."""
        return 1 if self._placed.clean.ndim == 2 else len(self._placed.clean)

    def __getitem__(self, t: Any) -> Any:
        """Return the covariates of a clean image."""
        if not 0 <= t < len(self):
            raise IndexError(t)
        if t not in self._made:
            self._made[t] = self._make(int(t))
        return self._made[t]

    def _make(self, t: int) -> PixelCovariates:
        one, placed = self._recording, self._placed
        if placed.clean.ndim == 2:
            clean, before, interval = placed.clean, None, 0.0
        else:
            # The first frame of a segment has no frame before it.
            clean = placed.clean[t]
            before = None if one.fresh[t] or t == 0 else placed.clean[t - 1]
            interval = float(one.stamp[t] - one.stamp[t - 1]) * 1e-9
        albedo, known = (at_frame(one, t) for one in (placed.reflectivity, placed.known))
        return look_at(
            clean, before, interval, albedo, one.K, one.mode, one.axes, placed.border, known
        )


def with_uptime(effects: dict[str, dict[str, float]], uptime: float | None) -> dict[str, Any]:
    """Return effects with the recording's own time since power-on."""
    old = ageing(effects)
    if uptime is None:  # Nothing is known of it, so they explain nothing.
        return {name: values for name, values in effects.items() if name not in old}
    return {**effects, **{name: {**effects[name], 'uptime': uptime} for name in old}}


def few_frames(count: int, moving: bool, few: int, stretches: int, length: int) -> np.ndarray:
    """Return some of a recording's frames: the first ones, or stretches of a moving scene."""
    if count <= stretches * length:
        return np.arange(count)
    if not moving:
        return np.arange(few)
    starts = ((2 * np.arange(stretches) + 1) * count // (2 * stretches)).clip(max=count - length)
    return np.unique(starts[:, None] + np.arange(length))


def definitions(effects: Any) -> list[type[Effect]]:
    """Return the definitions of effects that are given by name or as they are."""
    known = loadable()
    return [known[one] if isinstance(one, str) else type(one) for one in effects]


def counts_edges(effects: Any) -> bool:
    """
    Return whether errors at jumps and sharp bends count in the gap that effects are to remove.

    They do where an effect changes edges, and where no effect is known or only a correction
    without a cause. Any other effect leaves the errors that a fitted pose has there, which would
    seem to be left of the gap.
    """
    known = [kind for kind in definitions(effects) if kind.name != ResidualPatch.name]
    return not known or any('edges' in kind.changes for kind in known)


class PartialSimulation:
    """
    Some of a recording's frames, (N,) `frames`, simulated with common random numbers.

    `spectrum` is that of the base simulator's depths, see `features`; `warm` frames after a gap
    are left out. `base` is (SIZE,) features without effects but the given ones.
    """

    def __init__(
        self, scene: PlacedScene, frames: np.ndarray, seed: int, spectrum: np.ndarray, warm: int
    ) -> None:
        """Simulate without effects."""
        recording = scene.recording
        self._common = CommonRandomNumbers(
            base_camera(recording.mode, recording.profile, seed, recording.name),
            at_frame(scene.placed.clean, frames),
            recording.K,
            recording.stamp[frames],
            at_frame(scene.placed.reflectivity, frames),
        )
        scenes = scene.covariates
        self._scenes = [scenes[t] for t in frames] if len(scenes) > 1 else scenes
        self._fresh = recording.fresh[frames].copy()
        self._fresh[1:] |= np.diff(frames) != 1
        self._spectrum = spectrum
        self._warm = warm
        self._given = recording.given
        self._plain = self._common.depth(self._given)
        self.base = self._features(self._plain, True)

    def _features(self, depth: np.ndarray, lattice: bool) -> np.ndarray:
        sums = accumulate(
            depth, self._scenes, self._fresh, self._warm, lattice, len(self._scenes) > 1
        )
        return features(sums, self._spectrum, FEATURES.enough_alike)[0]

    def shift(self, effects: Any, without: Sequence[str] = ()) -> np.ndarray:
        """Return what effects change, and the lack of given ones; 0 where it cannot be said."""
        given = tuple(one for one in self._given if one.name not in without)
        depth = self._common.depth(together(given, effects) if given else effects)
        if all(
            np.array_equal(one.view(np.int32), other.view(np.int32))
            for one, other in zip(depth, self._plain, strict=True)
        ):
            return np.zeros(SIZE)
        lattice = any(kind.lattice for kind in definitions([*effects, *without]))
        return np.nan_to_num(self._features(depth, lattice) - self.base)

    def plane_columns(self, shifts: np.ndarray | None) -> np.ndarray:
        """Return what steps of planes change, (3 P, SIZE); so small, they leave noise as it is."""
        if shifts is None:
            return np.zeros((0, SIZE))
        steps = np.resize(PLANE_STEPS, len(shifts)).astype(np.float32)
        both = np.array(
            [
                [self._features(self._plain + sign * shift, False) for sign in (1, -1)]
                for shift in steps[:, None, None] * shifts
            ]
        )
        return np.nan_to_num((both[:, 0] - both[:, 1]) / 2)
