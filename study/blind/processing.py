"""Effects of the camera's processing: edges, unwrapping, dropouts, filters, storage."""

import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np
from study.blind.frame import Effect, Frame
from study.blind.lens import footprint_slope


class LateralNoise(Effect):
    """Edges move further than in the paper, sometimes much further."""

    name = 'lateral_noise'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the scale and the fraction of jumps."""
        self._scale, self._tails = 1 + 0.5 * self.strength, min(0.5 * self.strength, 1.0)
        self.parameters = {'factor': self._scale, 'tails': self._tails}

    def before(self, frame: Frame) -> None:
        """Set the scale and the tails of the edges."""
        frame.edge_scale *= self._scale
        frame.edge_tails = max(frame.edge_tails, self._tails)


class RangeWrap(Effect):
    """Unwrapping fails: light from beyond the range is accepted, the frequencies disagree."""

    name = 'range_wrap'

    def draw(self, rng: np.random.Generator) -> None:
        """Set how often one frequency wraps, and how much two frequencies disagree."""
        self._share, self._apart = min(0.5 * self.strength, 1.0), 3.0 * self.strength
        self.parameters = {'share': self._share}

    def mix(self, frame: Frame) -> None:
        """Choose wrong wraps."""
        K = self.optics.wavenumbers
        if len(K) > 1:
            spread = frame.seen(frame.view.sigma * frame.view.ray_length) * math.sqrt((K**2).sum())
            frame.disagreement += (
                self._apart * spread * frame.dice.standard_normal(spread.shape)
            ).astype(np.float32)
            return
        bright = frame.seen(frame.view.amplitude) > 0.01
        wraps = bright & (frame.dice.random(bright.shape) < self._share)
        frame.past_gate |= wraps
        middle = np.float32(self.optics.period / 2)
        frame.reference = np.where(wraps, middle, frame.reference).astype(np.float32)


class LowSignalDropout(Effect):
    """A comparator drops pixels whose measured amplitude is below its threshold."""

    name = 'low_signal_dropout'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw each pixel's threshold, 1/m^2."""
        usual = 0.04 if len(self.optics.wavenumbers) == 1 else 0.015
        self._threshold = usual * self.strength * self.optics.internals.light_scale
        self._thresholds = self._threshold * np.exp(0.2 * rng.standard_normal(self.optics.shape))
        self.parameters = {'amplitude': self._threshold}

    def mix(self, frame: Frame) -> None:
        """Drop pixels below their threshold."""
        flicker = np.exp(0.1 * frame.dice.standard_normal(self.optics.shape))
        frame.invalid |= np.abs(frame.phasors[0]) < self._thresholds * flicker


class RandomDropout(Effect):
    """Pixels are dropped whatever they see: lost packets, a busy processor; or they are dead."""

    name = 'random_dropout'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the fraction of the pixels."""
        self._lost = min(self.optics.internals.lost * self.strength, 0.95)
        if self.optics.internals.dead:
            self._dead = rng.random(self.optics.shape) < self._lost
        self.parameters = {'share': self._lost}

    def mix(self, frame: Frame) -> None:
        """Drop pixels."""
        if self.optics.internals.dead:
            frame.invalid |= self._dead
            return
        frame.invalid |= frame.dice.random(self.optics.shape) < self._lost


class MotionDropout(Effect):
    """Pixels that see another surface when the frame ends than when it began are dropped."""

    name = 'motion_dropout'
    _APART = 0.06  # metres between two surfaces

    def draw(self, rng: np.random.Generator) -> None:
        """Set how long a frame takes, seconds."""
        self._seconds = 0.015 * self.strength
        self.parameters = {'seconds': self._seconds}

    def mix(self, frame: Frame) -> None:
        """Drop pixels that changed their surface, half a frame before or after its stamp."""
        first, last = (frame.look_later(t).depth for t in (-self._seconds / 2, self._seconds / 2))
        with np.errstate(invalid='ignore'):
            frame.invalid |= np.abs(last - first) > self._APART


class GrazingDropout(Effect):
    """Pixels whose footprint spans too much depth lose contrast and are dropped."""

    name = 'grazing_dropout'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the largest span of depth, metres per pixel."""
        usual = 0.012 if len(self.optics.wavenumbers) == 1 else 0.03
        self._span = usual / max(self.strength, 1e-6)
        self.parameters = {'span': self._span}

    def mix(self, frame: Frame) -> None:
        """Drop pixels with a larger span."""
        span = frame.seen(footprint_slope(frame.view))
        flicker = np.exp(0.2 * frame.dice.standard_normal(span.shape))
        frame.invalid |= span * flicker > self._span


class TemporalFilter(Effect):
    """
    Phasors are averaged over frames; the average restarts when they jump.

    A filter of second order is two of first order in a row. A mean has the last frames with equal
    weights and does not restart.
    """

    name = 'temporal_filter'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the weight of past frames."""
        self._share = min(0.4 * self.strength, 0.9)
        self.parameters = {'share': self._share}
        self._past: list[np.ndarray] = []

    def start(self, recording: int) -> None:
        """Forget the previous recording."""
        self._past = []

    def mix(self, frame: Frame) -> None:
        """Average with past frames."""
        inside = self.optics.internals
        if inside.memory == 'mean':
            self._past = [*self._past, frame.phasors][-inside.memory_frames :]
            frame.phasors = np.mean(self._past, axis=0)
            return
        kept = []
        for order in range(2 if inside.memory == 'second' else 1):
            if self._past:
                frame.phasors = self._averaged(frame, self._past[order])
            kept.append(frame.phasors)
        self._past = kept

    def _averaged(self, frame: Frame, old: np.ndarray) -> np.ndarray:
        # The phasors of the frame, averaged with those before; restarts where they jump.
        new = frame.phasors
        turn = np.abs(np.angle(new * np.conj(old)))
        total = math.sqrt((self.optics.wavenumbers**2).sum())
        spread = frame.view.sigma * frame.view.ray_length * total
        goes_on = (turn < np.clip(9 * spread, 0.02, 1.5)).all(axis=0)
        share = np.where(goes_on, self._share, 0).astype(np.float32)
        return share * old + (1 - share) * new


class SpatialFilter(Effect):
    """A bilateral filter over phasors, five pixels wide; or a box, or a Gaussian, of any width."""

    name = 'spatial_filter'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the widths, pixels and metres."""
        self._width, self._gate = max(0.75 * math.sqrt(self.strength), 0.01), 0.06
        self.parameters = {'width_px': self._width}

    def mix(self, frame: Frame) -> None:
        """Smooth the phasors."""
        size = np.abs(frame.phasors)
        unit = frame.phasors / np.maximum(size, np.float32(1e-20))
        parts = np.concatenate([unit.real, unit.imag])
        inside = self.optics.internals
        if inside.window == 'median':
            return
        if inside.window != 'alike':
            # A fraction of the light, so that strength 0 changes nothing.
            mixed = unit + min(self.strength, 1.0) * (
                _windowed(unit, inside.window, inside.window_px) - unit
            )
            frame.phasors = mixed * (size / np.maximum(np.abs(mixed), np.float32(1e-20)))
            return
        out = np.empty_like(parts)
        smooth(
            parts,
            np.float32(self._width),
            np.float32(self._gate * self.optics.wavenumbers[0]),
            out,
        )
        mean = out[: len(unit)] + 1j * out[len(unit) :]
        frame.phasors = mean * (size / np.maximum(np.abs(mean), np.float32(1e-20)))

    def report(self, frame: Frame) -> None:
        """Take the median of the depths around; what is invalid counts as the pixel itself."""
        inside = self.optics.internals
        if inside.window != 'median':
            return
        here = frame.depth
        wide = np.pad(here, inside.window_px // 2, constant_values=np.nan)
        around = np.lib.stride_tricks.sliding_window_view(wide, (inside.window_px,) * 2)
        around = np.where(np.isnan(around), here[..., None, None], around)
        change = np.median(around, axis=(2, 3)) - here
        frame.depth = (here + min(self.strength, 1.0) * change).astype(np.float32)


def _windowed(unit: np.ndarray, shape: str, width: int) -> np.ndarray:
    # The (J, H, W) mean over a window around each pixel, edges repeated.
    half = width // 2
    places = np.arange(-half, half + 1)
    line = np.exp(-0.5 * (places / (width / 5)) ** 2) if shape == 'gauss' else np.ones(width)
    line /= line.sum()
    for axis in (1, 2):
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[axis] = (half, half)
        wide = np.pad(unit, pad, mode='edge')
        parts = (
            np.complex64(weight) * np.take(wide, np.arange(unit.shape[axis]) + k, axis=axis)
            for k, weight in enumerate(line)
        )
        unit = sum(parts, np.zeros_like(unit))
    return unit


@loop(fastmath=True)
def smooth(parts, width, gate, out):
    """
    Average unit phasors of pixels that are close in position and in phase.

    ``parts`` and ``out`` are (2 J, H, W) float32: real parts of the frequencies, then imaginary
    ones.
    """
    count, height, columns = parts.shape
    half = count // 2
    near = np.empty((5, 5), np.float32)
    for dy in range(5):
        for dx in range(5):
            near[dy, dx] = math.exp(-0.5 * ((dx - 2) ** 2 + (dy - 2) ** 2) / (width * width))
    steep = np.float32(1 / (gate * gate))
    out[:] = 0
    for y in range(height):
        for yy in range(max(y - 2, 0), min(y + 3, height)):
            for shift in range(-2, 3):
                place = near[yy - y + 2, shift + 2]
                for x in range(max(0, -shift), min(columns, columns - shift)):
                    # The distance of unit phasors, which is their angle if it is small.
                    re = parts[0, yy, x + shift] - parts[0, y, x]
                    im = parts[half, yy, x + shift] - parts[half, y, x]
                    falls = np.float32(1) + (re * re + im * im) * steep
                    weight = place / (falls * falls)
                    for p in range(count):
                        out[p, y, x] += weight * parts[p, yy, x + shift]


class Quantisation(Effect):
    """Fixed-point storage: some cameras round the phase, others the depth."""

    name = 'quantisation'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw whether phase or depth is rounded."""
        usual = 0.005 if len(self.optics.wavenumbers) == 1 else 0.01
        self._step = usual * self.strength
        self._of_phase = bool(rng.random() < 0.5)
        self.parameters = {'step': self._step, 'of_phase': float(self._of_phase)}

    def mix(self, frame: Frame) -> None:
        """Round the phases."""
        if self._of_phase and self._step:
            steps = (self._step * self.optics.wavenumbers)[:, None, None]
            angle = np.rint(np.angle(frame.phasors) / steps) * steps
            frame.phasors = (np.abs(frame.phasors) * np.exp(1j * angle)).astype(np.complex64)

    def report(self, frame: Frame) -> None:
        """Round the depth."""
        if not self._of_phase and self._step:
            frame.depth = (np.rint(frame.depth / self._step) * self._step).astype(np.float32)
