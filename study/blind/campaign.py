"""A campaign: recordings of a camera with effects, and the ground truth that its user has."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from flexx2_sim_ros.recording import RecordingWriter
import numpy as np
from study.blind.catalogue import make_effect
from study.blind.frame import Effect, Frame, Shot, take
from study.blind.internals import Internals
from study.blind.scene_set import SceneKey, SceneSet
from study.blind.views import View

# Called with the index of the recording and each frame that is taken.
Observer = Callable[[int, Frame], None]
_CLASSES = 12
_CAMERA_UNITS = 800.0  # gray values for an amplitude of 1 per square metre


@dataclass(frozen=True)
class Case:
    """
    The definition of a campaign.

    * `effects`: strength by name; empty for the camera of the paper
    * `seed`: seed of the noise, the effects and the nuisances
    * `reflectivity_error`, `sigma_error`: standard deviations of the logarithms of the errors in
      what the user knows
    * `internals`: what differs inside the camera from its profile
    """

    scenes: SceneKey
    effects: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    reflectivity_error: float = 0.2
    sigma_error: float = 0.05
    internals: Internals = Internals()


class BlindCamera:
    """
    The real camera of a case.

    * `scenes`: the scenes of the case, if several cases share them
    * `sigma_factor`: true sigma_z divided by that of the paper
    """

    def __init__(self, case: Case, scenes: SceneSet | None = None) -> None:
        """Draw the nuisances and the parameters of the effects of this camera."""
        self.case = case
        self.scenes = (scenes or SceneSet(case.scenes)).inside(case.internals)
        rng = np.random.default_rng([case.seed, 2])
        self.sigma_factor = float(np.exp(case.sigma_error * rng.standard_normal()))
        self._kept: View | None = None
        self._told = np.exp(case.reflectivity_error * rng.standard_normal(_CLASSES))
        self.stamps = rng.uniform(1e3, 1e5, case.scenes.recordings)
        self.effects: tuple[Effect, ...] = tuple(
            make_effect(
                name, strength, np.random.default_rng([case.seed, 3, k]), self.scenes.optics
            )
            for k, (name, strength) in enumerate(sorted(case.effects.items()))
        )
        if 'multipath' in case.effects:
            self.scenes.prepare_bounces()

    def frames(self, recording: int) -> Iterator[Frame]:
        """Take the frames of one recording."""
        case = self.case
        for effect in self.effects:
            effect.start(recording)
        scattered: tuple[View, np.ndarray] | None = None
        for index, time in enumerate(self.scenes.times()):
            shot = self._aim(recording, float(time))
            view = self._look(shot, index)
            if scattered is None or scattered[0] is not view:
                scattered = view, self._scatter(view)
            dice = np.random.default_rng([case.seed, 4, recording, index])
            frame = Frame(
                view,
                scattered[1],
                recording,
                index,
                float(self.scenes.uptimes[recording] + time),
                dice,
                partial(self._later, shot),
            )
            noise = np.random.Generator(np.random.SFC64([case.seed, 5, recording, index]))
            yield take(frame, self.effects, noise, self.sigma_factor)

    def _aim(self, recording: int, time: float) -> Shot:
        shot = Shot(recording, time, self.scenes.twists[recording].copy())
        for effect in self.effects:
            effect.aim(shot)
        return shot

    def _look(self, shot: Shot, index: int) -> View:
        scenes = self.scenes
        moving = scenes.scenes[shot.recording].path.moving
        as_ever = shot.rays is None and not (shot.twist - scenes.twists[shot.recording]).any()
        if as_ever and (not moving or shot.time == scenes.times()[index]):
            return scenes.true_view(shot.recording, index)
        if moving or not index or self._kept is None:
            self._kept = scenes.view(shot.recording, shot.time, shot.twist, shot.rays)
        return self._kept

    def _later(self, shot: Shot, later: float) -> View:
        return self.scenes.view(shot.recording, shot.time + later, shot.twist, shot.rays)

    def _scatter(self, view: View) -> np.ndarray:
        light = view.light
        for effect in self.effects:
            light = effect.scatter(view, light)
        return light

    def known_reflectivity(self, recording: int) -> np.ndarray:
        """Return the reflectivity that the user knows, with an error for each material."""
        _, true = self.scenes.clean(recording)
        told = self._told[np.minimum((true * _CLASSES).astype(int), _CLASSES - 1)]
        return np.clip(true * told, 0.01, 1.0).astype(np.float32)

    def record(
        self, folder: Path, observer: Observer | None = None, only: Sequence[int] | None = None
    ) -> None:
        """
        Write the recordings of the campaign: ``0.npz``, ``1.npz`` and so on.

        * `folder`: must exist
        * `observer`: called with every frame, for labels that need more than the recordings
        * `only`: which recordings to write; all when left out
        """
        key, scenes = self.case.scenes, self.scenes
        for i in range(key.recordings) if only is None else only:
            clean, _ = scenes.clean(i)
            gray = []
            with RecordingWriter(folder / f'{i}.npz', key.frames, key.height, key.width) as file:
                for frame in self.frames(i):
                    file.add_depth(frame.depth[None])
                    gray.append(np.abs(frame.phasors[0]) * np.float32(_CAMERA_UNITS))
                    if observer:
                        observer(i, frame)
                file.add_array('clean_depth', clean)
                file.add_array('K', scenes.optics.intrinsics.matrix)
                file.add_array('stamp', self.stamps[i] + scenes.times())
                file.add_array('usecase', scenes.optics.mode.name)
                file.add_array('reflectivity', self.known_reflectivity(i))
                file.add_array('uptime', scenes.uptimes[i] + scenes.times())
                moving = scenes.scenes[i].path.moving
                file.add_array('amplitude', np.stack(gray) if moving else np.mean(gray, axis=0))
