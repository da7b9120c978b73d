"""Scenes and their true and nominal views, which do not depend on effects; cached on disk."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
import math
from pathlib import Path

from flexx2_sim_ros.atomic import output_folder, whole
import numpy as np
from study.blind.bounce import irradiance
from study.blind.internals import Internals
from study.blind.rooms import KINDS, make_scene, Scene
from study.blind.shapes import rotation
from study.blind.views import look, Optics, shared_optics, View

# Change it whenever the same seed gives other scenes, so that old caches are not used.
VERSION = 3
DEGREES_PER_MM = 0.125 / 2


@dataclass(frozen=True)
class SceneKey:
    """
    The definition of a set of scenes.

    * `pose_mm`: standard deviation of each recording's pose error along each axis, millimetres.
      The standard deviation of the angle about each axis is 0.0625 degrees per millimetre.
    * `width`, `height`: image size, pixels
    * `recordings`, `frames`: number of recordings, and of frames in each
    """

    usecase: str
    seed: int
    pose_mm: float = 2.0
    width: int = 224
    height: int = 172
    recordings: int = 8
    frames: int = 20

    @property
    def file_name(self) -> str:
        """Return a name for the cached file."""
        return (
            f'{self.usecase}-{self.seed}-{self.pose_mm:g}mm-{self.width}x{self.height}-'
            f'{self.recordings}x{self.frames}-v{VERSION}.npz'
        )


class SceneSet:
    """
    Scenes seen from the true poses of the camera and from those that the user knows.

    * `cache`: folder for rendered images. If it is left out, they are rendered each time.
    * `twists`: (R, 6) the nuisance pose errors: turns in radians, shifts in metres
    * `uptimes`: (R,) seconds since power-on at which each recording begins
    """

    def __init__(self, key: SceneKey, cache: Path | None = None) -> None:
        """Draw the scenes and nuisances; render nothing yet."""
        self.key = key
        self.optics: Optics = shared_optics(key.usecase, key.width, key.height)
        rng = np.random.default_rng([key.seed, 1])
        mode = self.optics.mode
        self.scenes: tuple[Scene, ...] = tuple(
            make_scene(KINDS[i % len(KINDS)], mode.range_max, rng) for i in range(key.recordings)
        )
        turn = math.radians(key.pose_mm * DEGREES_PER_MM)
        self.twists = rng.standard_normal((key.recordings, 6)) * (
            3 * [turn] + 3 * [key.pose_mm / 1000]
        )
        spread = np.linspace(math.log(20), math.log(5000), key.recordings)
        self.uptimes = np.exp(rng.permutation(spread) + rng.uniform(-0.2, 0.2, key.recordings))
        self._cache = cache
        self._bounced: np.ndarray | None = None

    def inside(self, internals: Internals) -> 'SceneSet':
        """Return the same scenes, seen by a camera with these internals."""
        if internals == self.optics.internals:
            return self
        other = copy(self)
        other.optics = replace(self.optics, internals=internals)
        other._bounced = None
        other.__dict__.pop('_views', None)
        return other

    def times(self) -> np.ndarray:
        """Return the (T,) times of the frames since the start of a recording, seconds."""
        return np.arange(self.key.frames) / self.optics.mode.rate_hz

    def view(
        self, recording: int, time: float, twist: np.ndarray, rays: np.ndarray | None = None
    ) -> View:
        """Render from the nominal path, moved by a (6,) twist in the camera's frame."""
        scene = self.scenes[recording]
        R, origin = scene.path.pose(time)
        pose = R @ rotation(twist[0], twist[1], twist[2]), origin + R @ twist[3:]
        return look(scene.solids, pose, self.optics, rays)

    @cached_property
    def _nominal(self) -> dict[str, np.ndarray]:
        # The nominal views do not depend on the pose error.
        return self.cached('nominal', lambda: self._render(0.0), pose=False)

    @cached_property
    def _true(self) -> dict[str, np.ndarray]:
        return self.cached('true', lambda: self._render(1.0))

    def _render(self, wrong: float) -> dict[str, np.ndarray]:
        views = [
            self.view(i, time, wrong * self.twists[i])
            for i in range(self.key.recordings)
            for time in self._distinct(i)
        ]
        return {
            'depth': np.stack([view.depth for view in views]),
            'reflectivity': np.stack([view.reflectivity for view in views]),
        }

    def cached(
        self, what: str, make: Callable[[], dict[str, np.ndarray]], *, pose: bool = True
    ) -> dict[str, np.ndarray]:
        """
        Return arrays from the cache; compute them first if they are missing.

        ``pose``: whether they depend on the pose error.
        """
        if self._cache is None:
            return make()
        key = self.key if pose else replace(self.key, pose_mm=0.0)
        path = self._cache / f'{what}-{key.file_name}'
        if path.is_file():
            with np.load(path, allow_pickle=False) as archive:
                return dict(archive)
        arrays = make()
        output_folder(self._cache)
        # Two processes may compute the same file; it is written whole or not at all.
        with whole(path) as part:
            np.savez(part, **arrays)  # type: ignore[arg-type]
        return arrays

    def _distinct(self, recording: int) -> np.ndarray:
        return self.times() if self.scenes[recording].path.moving else self.times()[:1]

    def slot(self, recording: int, frame: int) -> int:
        """Return the index of a frame's view among the distinct views of all recordings."""
        start = sum(len(self._distinct(i)) for i in range(recording))
        return start + (frame if self.scenes[recording].path.moving else 0)

    def clean(self, recording: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the user's depth and reflectivity, (H, W) or (T, H, W) of a moving camera."""
        start = self.slot(recording, 0)
        if not self.scenes[recording].path.moving:
            return self._nominal['depth'][start], self._nominal['reflectivity'][start]
        part = slice(start, start + self.key.frames)
        return self._nominal['depth'][part], self._nominal['reflectivity'][part]

    def true_view(self, recording: int, frame: int) -> View:
        """Return the view of the camera at its true pose."""
        slot = self.slot(recording, frame)
        if slot not in self._views:
            scene, time = self.scenes[recording], float(self.times()[frame])
            R, origin = scene.path.pose(time)
            twist = self.twists[recording]
            self._views.clear()  # Frames are read in order: one view is enough.
            self._views[slot] = View(
                self.optics,
                self._true['depth'][slot],
                self._true['reflectivity'][slot],
                scene.solids,
                R @ rotation(twist[0], twist[1], twist[2]),
                origin + R @ twist[3:],
                self.optics.rays,
                None if self._bounced is None else self._bounced[slot],
            )
        return self._views[slot]

    def prepare_bounces(self) -> None:
        """Compute the indirect light of all true views; slow unless it is cached."""
        mhz = self.optics.internals.mhz
        self._bounced = self.cached(
            f'bounce{mhz:g}' if mhz else 'bounce',
            lambda: {
                'irradiance': np.stack(
                    [
                        irradiance(self.true_view(i, frame))
                        for i in range(self.key.recordings)
                        for frame in range(len(self._distinct(i)))
                    ]
                )
            },
        )['irradiance']
        self._views.clear()

    @cached_property
    def _views(self) -> dict[int, View]:
        return {}
