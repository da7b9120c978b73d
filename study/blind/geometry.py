"""Effects on geometry: pose, intrinsics, latency, motion between exposures."""

from dataclasses import replace
import math

import numpy as np
from study.blind.frame import Effect, Frame, Shot
from study.blind.views import pixel_rays

_MANY = 256  # recordings for which a motion is drawn
_READOUT_S = 1e-3


class PoseError(Effect):
    """The camera of each recording has another pose than the user knows."""

    name = 'pose_error'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw a motion for each recording."""
        turn, shift = math.radians(0.75) * self.strength, 0.015 * self.strength
        self._twists = rng.standard_normal((_MANY, 6)) * (3 * [turn] + 3 * [shift])
        self.parameters = {'shift_sd': shift, 'turn_sd': turn}

    def aim(self, shot: Shot) -> None:
        """Add the motion."""
        shot.twist = shot.twist + self._twists[shot.recording]


class IntrinsicsError(Effect):
    """Focal lengths, centre and distortion differ from those that the user knows."""

    name = 'intrinsics_error'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw one lens."""
        focal, k1 = (self.strength * size * rng.choice((-1, 1)) for size in (0.01, 0.03))
        camera = self.optics.intrinsics
        pixels = self.strength * 1.5 * camera.width / 224
        angle = rng.uniform(0, 2 * math.pi)
        inside = self.optics.internals
        aspect, across = (self.strength * one for one in (inside.aspect, inside.tangential))
        self._rays = pixel_rays(
            replace(
                camera,
                fx=camera.fx * (1 + focal),
                fy=camera.fy * (1 + focal + aspect),
                cx=camera.cx + pixels * math.cos(angle),
                cy=camera.cy + pixels * math.sin(angle),
                distortion=(k1, 0.0, across, -across / 2, 0.0),
            )
        )
        self.parameters = {'focal': focal, 'centre_px': pixels, 'k1': k1}

    def aim(self, shot: Shot) -> None:
        """Use the true rays."""
        shot.rays = self._rays


class TimeOffset(Effect):
    """The image is older than its stamp says."""

    name = 'time_offset'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the latency."""
        self._latency = self.optics.internals.latency_s * self.strength
        self.parameters = {'latency': self._latency}

    def aim(self, shot: Shot) -> None:
        """Take the frame earlier on the path."""
        shot.time -= self._latency


class MotionArtefact(Effect):
    """The camera moves between its raw exposures."""

    name = 'motion_artefact'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the time between raw exposures."""
        longest = self.optics.mode.exposure_us[1] * 1e-6
        self._gap = self.strength * (longest + _READOUT_S)
        self.parameters = {'gap': self._gap}
        self._still: tuple[np.ndarray, float] | None = None

    def charge(self, frame: Frame) -> None:
        """Give each tap the light of its own time."""
        first = frame.look_later(0.0)
        if np.array_equal(first.origin, frame.look_later(self._gap).origin):
            return
        shape = frame.light.shape[1:]
        for j, K in enumerate(self.optics.wavenumbers):
            for k in range(4):
                order = 4 * j + k
                if not order:
                    continue
                later = frame.look_later(order * self._gap).light[j]
                change = (later - frame.view.light[j]).reshape(-1)[frame.source].reshape(shape)
                change = change * np.exp(1j * K * frame.jitter).astype(np.complex64)
                frame.taps[j, k] += (change * np.complex64(1j**k)).real
