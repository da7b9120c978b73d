"""One frame: light, taps, phasors, range, depth; effects act between these steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from study.blind.edges import jitter_edges
from study.blind.sensor import demodulate, expose, unwrap
from study.blind.views import Optics, View


@dataclass
class Shot:
    """
    Where and when the camera takes a frame; geometric effects change it.

    * `recording`: index in the campaign
    * `time`: seconds since the recording began
    * `twist`: (6,) motion in the camera's own frame: three turns (radians), three shifts (metres)
    * `rays`: true rays; None for those of the intrinsics that the user knows
    """

    recording: int
    time: float
    twist: np.ndarray
    rays: np.ndarray | None = None


@dataclass
class Frame:
    """
    A frame while it is computed. Arrays are (H, W) unless noted.

    * `light`: (J, H, W) complex64 phasors on the sensor
    * `recording`, `index`: index of the recording, and of the frame in it
    * `uptime`: seconds since power-on
    * `dice`: random numbers of the effects; the base noise has its own
    * `look_later`: returns the `View` of the scene some seconds later
    * `delay`: extra path of each pixel, metres of range
    * `noise_gain`: factor on the noise of the taps, for the surface that is seen
    * `edge_scale`, `edge_tails`: see `jitter_edges`
    * `source`: (H * W,) int32, index of the pixel whose light each pixel gets
    * `taps`: (J, 4, H, W) float32
    * `phasors`: (J, H, W) complex64, computed from the taps
    * `reference`: range, metres; the unwrapped one is the nearest to it
    * `disagreement`: difference of the frequencies' phases, radians
    * `depth`: metres, NaN where invalid
    * `invalid`: bool, set by effects before depth is computed
    * `past_gate`: bool, pixels outside the range of the mode that the camera does not recognise as
      such
    """

    view: View
    light: np.ndarray
    recording: int
    index: int
    uptime: float
    dice: np.random.Generator
    look_later: Callable[[float], View]
    delay: Any = 0.0
    noise_gain: Any = 1.0
    edge_scale: float = 1.0
    edge_tails: float = 0.0
    source: np.ndarray = field(default_factory=lambda: np.empty(0, np.int32))
    taps: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))
    phasors: np.ndarray = field(default_factory=lambda: np.empty(0, np.complex64))
    jitter: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))
    reference: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))
    disagreement: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))
    depth: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))
    invalid: np.ndarray = field(default_factory=lambda: np.empty(0, bool))
    past_gate: np.ndarray = field(default_factory=lambda: np.empty(0, bool))

    @property
    def optics(self) -> Optics:
        """Return the camera."""
        return self.view.optics

    def seen(self, image: np.ndarray) -> np.ndarray:
        """Return an image of the scene with its edges displaced as in this frame."""
        return image.reshape(-1)[self.source].reshape(image.shape)


class Effect:
    """
    A deviation of a real camera from the model of the paper; this base class changes nothing.

    * `strength`: 1 is typical
    * `rng`: draws what differs between cameras
    * `parameters`: physical sizes by name, for the label
    """

    name: ClassVar[str] = ''

    def __init__(self, strength: float, rng: np.random.Generator, optics: Optics) -> None:
        """Set the strength and draw the parameters."""
        self.strength = strength
        self.optics = optics
        self.parameters: dict[str, float] = {}
        self.draw(rng)

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the parameters of this camera."""

    def start(self, recording: int) -> None:
        """Begin a recording: forget the previous one."""

    def aim(self, shot: Shot) -> None:
        """Change where and when the camera takes a frame."""

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Return the light that reaches the sensor; called once per view."""
        return light

    def before(self, frame: Frame) -> None:
        """Change light, delay, noise and edges of a frame."""

    def charge(self, frame: Frame) -> None:
        """Change the taps."""

    def mix(self, frame: Frame) -> None:
        """Change the phasors."""

    def report(self, frame: Frame) -> None:
        """Change the depth."""


def take(
    frame: Frame, effects: Sequence[Effect], noise: np.random.Generator, sigma_factor: float = 1.0
) -> Frame:
    """
    Compute a frame.

    * `frame`: with view and light; the other fields are computed
    * `effects`: in the order in which they are applied
    * `noise`: draws the base noise
    * `sigma_factor`: factor on the base noise; 1 is the noise of the paper

    Returns the same frame.
    """
    view, optics = frame.view, frame.optics
    shape, K = optics.shape, optics.wavenumbers
    count = shape[0] * shape[1]
    frame.invalid = np.zeros(shape, bool)
    frame.past_gate = np.zeros(shape, bool)
    frame.disagreement = np.zeros(shape, np.float32)
    for effect in effects:
        effect.before(frame)
    rows, columns = view.edges
    frame.source = jitter_edges(
        rows, columns, optics.mode.noise.sigma_x, frame.edge_scale, noise, frame.edge_tails
    )
    normals = noise.standard_normal((1 + 4 * len(K), count), np.float32)
    frame.jitter = np.empty(shape, np.float32)
    frame.taps = np.empty((len(K), 4, *shape), np.float32)
    phase_noise, path_noise = (np.float32(sigma_factor) * part for part in view.noise)
    gain = np.broadcast_to(np.asarray(frame.noise_gain, np.float32), shape)
    delay = np.broadcast_to(np.asarray(frame.delay, np.float32), shape)
    expose(
        frame.light.reshape(len(K), -1),
        frame.source,
        view.amplitude.ravel(),
        phase_noise.ravel(),
        path_noise.ravel(),
        np.ascontiguousarray(gain).ravel(),
        np.ascontiguousarray(delay).ravel(),
        K,
        normals,
        frame.jitter.ravel(),
        frame.taps.reshape(len(K), 4, -1),
    )
    for effect in effects:
        effect.charge(frame)
    frame.phasors = demodulate(frame.taps)
    frame.reference = frame.seen(view.path) + frame.jitter
    for effect in effects:
        effect.mix(frame)
    along = np.empty(count, np.float32)
    unwrap(
        np.ascontiguousarray(frame.phasors).reshape(len(K), -1),
        K,
        frame.reference.ravel(),
        frame.disagreement.ravel(),
        optics.period,
        along,
    )
    frame.depth = along.reshape(shape) / view.ray_length
    _gate(frame)
    for effect in effects:
        effect.report(frame)
    return frame


def _gate(frame: Frame) -> None:
    mode = frame.optics.mode
    true = frame.seen(frame.view.depth)
    with np.errstate(invalid='ignore'):
        inside = (true >= mode.range_min) & (true <= mode.range_max) | frame.past_gate
        inside &= (frame.depth >= mode.range_min) & (frame.depth <= mode.range_max)
    frame.depth[~inside | frame.invalid] = np.nan
