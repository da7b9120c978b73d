"""Effects outside the catalogue: a diagnosis has to answer `unknown` or `partly`."""

import math

import numpy as np
from study.blind.frame import Effect, Frame
from study.blind.views import View

_GREY = 0.15  # 1/m^2: amplitude of a grey surface at a metre and a half


class RowBands(Effect):
    """Readout offsets that come and go in bands of rows."""

    name = 'row_bands'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw band height and pattern."""
        height = self.optics.shape[0]
        band = int(rng.integers(6, 15))
        pattern = rng.standard_normal(height // band + 1).repeat(band)[:height]
        self._size = 0.006 * self.strength * self.optics.wavenumbers[-1] * _GREY
        self._pattern = pattern
        self.parameters = {'size': 0.006 * self.strength}

    def charge(self, frame: Frame) -> None:
        """Offset one tap of each pair."""
        sway = 1 + 0.7 * frame.dice.standard_normal()
        offset = (2 * self._size * sway * self._pattern)[:, None].astype(np.float32)
        frame.taps[:, 0] += offset
        frame.taps[:, 3] += offset


class PixelDefects(Effect):
    """Clusters of dead and of hot pixels."""

    name = 'pixel_defects'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the positions."""
        height, width = self.optics.shape
        count = max(1, round(60 * self.strength * height * width / 38528))
        y, x = np.mgrid[:height, :width]
        self._dead, self._hot = np.zeros((2, height, width), bool)
        for cluster in range(count):
            place = rng.uniform(0, height), rng.uniform(0, width)
            inside = (y - place[0]) ** 2 + (x - place[1]) ** 2 < rng.uniform(0.8, 2.6) ** 2
            (self._dead if cluster % 2 else self._hot)[inside] = True
        self.parameters = {'clusters': count}

    def charge(self, frame: Frame) -> None:
        """Fill hot pixels with charge of their own."""
        size = 0.3 * frame.dice.standard_normal(frame.taps.shape).astype(np.float32)
        frame.taps += np.where(self._hot, size, 0)

    def report(self, frame: Frame) -> None:
        """Drop dead pixels."""
        frame.depth[self._dead] = np.nan


class EdgeDelay(Effect):
    """Delay that grows towards the image border: an emitter of many dots, a thick filter."""

    name = 'vignetting_delay'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the sign."""
        height, width = self.optics.shape
        y, x = np.mgrid[:height, :width]
        radius = np.hypot((y - height / 2) / (height / 2), (x - width / 2) / (width / 2))
        rim = 1 / (1 + np.exp(-(radius - 0.85) / 0.06))
        self._delay = (0.012 * self.strength * rng.choice((-1, 1)) * rim).astype(np.float32)
        self.parameters = {'rim': 0.012 * self.strength}

    def before(self, frame: Frame) -> None:
        """Delay."""
        frame.delay = frame.delay + self._delay


class Ghost(Effect):
    """A mirror image of the scene, by reflection between lens and sensor."""

    name = 'ghost'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the position of the ghost."""
        self._share = 0.02 * self.strength
        self._shift = tuple(int(v) for v in rng.integers(-6, 7, 2))
        self.parameters = {'share': self._share}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Add the ghost, delayed against the image."""
        late = np.exp(1j * 0.02 * self.optics.wavenumbers)[:, None, None]
        ghost = np.roll(light[:, ::-1, ::-1], self._shift, axis=(1, 2))
        return (light + self._share * late * ghost).astype(np.complex64)


class ClockJitter(Effect):
    """The phase-locked loop of the modulation settles differently in every frame."""

    name = 'clock_jitter'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the spread."""
        self._spread = 0.005 * self.strength
        self.parameters = {'spread': self._spread}

    def before(self, frame: Frame) -> None:
        """Delay the frame."""
        frame.delay = frame.delay + self._spread * frame.dice.standard_normal()


class Interference(Effect):
    """The light of another camera interferes in some frames, in stripes over the rows."""

    name = 'interference'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the beat."""
        self._size = 0.003 * self.strength
        self._stripes = rng.uniform(2, 6)
        self.parameters = {'amplitude': self._size}

    def before(self, frame: Frame) -> None:
        """Add the phasor of the other camera."""
        if frame.dice.random() < 0.4:
            return
        height = self.optics.shape[0]
        turn = (
            frame.dice.uniform(0, 2 * math.pi)
            + 2 * math.pi * self._stripes * np.arange(height)[:, None] / height
        )
        frame.light = frame.light + (self._size * np.exp(1j * turn)).astype(np.complex64)


class Specks(Effect):
    """Dust and rain close to the lens."""

    name = 'specks'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the number of specks."""
        self._count = 25 * self.strength
        self.parameters = {'count': self._count}

    def before(self, frame: Frame) -> None:
        """Put a speck in front of some pixels."""
        height, width = self.optics.shape
        light = frame.light.copy()
        for _ in range(frame.dice.poisson(self._count)):
            size = frame.dice.uniform(0.7, 2.5) * width / 224
            cy, cx = frame.dice.uniform(0, height), frame.dice.uniform(0, width)
            top, left = max(int(cy - size), 0), max(int(cx - size), 0)
            part = (slice(None), slice(top, int(cy + size) + 1), slice(left, int(cx + size) + 1))
            K = self.optics.wavenumbers[:, None, None]
            grain = 0.8 * np.exp(1j * K * frame.dice.uniform(0.15, 0.6))
            light[part] = 0.3 * light[part] + grain.astype(np.complex64)
        frame.light = light


class AdcSteps(Effect):
    """Each eight columns share a converter whose codes have uneven widths."""

    name = 'adc_steps'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw each converter's steps."""
        width = self.optics.shape[1]
        self._phase = rng.uniform(0, 1, width // 8 + 1).repeat(8)[:width].astype(np.float32)
        self._size = 0.012 * self.strength * self.optics.wavenumbers[-1] * _GREY
        self.parameters = {'size': 0.012 * self.strength}

    def charge(self, frame: Frame) -> None:
        """Add the sawtooth error of uneven codes."""
        code = frame.taps / np.float32(0.06) + self._phase
        frame.taps += np.float32(2 * self._size) * (code - np.floor(code) - np.float32(0.5))


class Afterglow(Effect):
    """Bright surfaces leave charge that decays over some frames."""

    name = 'afterglow'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the fraction of charge that stays."""
        self._share = 0.2 * self.strength
        self._bright = 0.25 if len(self.optics.wavenumbers) == 1 else 0.06
        self._glow: np.ndarray | None = None
        self.parameters = {'share': self._share}

    def start(self, recording: int) -> None:
        """Forget the previous recording."""
        self._glow = None

    def before(self, frame: Frame) -> None:
        """Add the charge that previous frames left."""
        size = np.abs(frame.view.light)
        bright = frame.view.light * np.maximum(1 - self._bright / np.maximum(size, 1e-9), 0)
        if self._glow is None:
            self._glow = np.zeros_like(bright)
        frame.light = frame.light + np.complex64(self._share) * self._glow
        self._glow = 0.7 * self._glow + 0.3 * bright


class GlassPane(Effect):
    """A glass pane covers a part of the image: it reflects, dims and delays light."""

    name = 'glass_pane'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the pane of each recording; three in ten have none."""
        self._rng_seed = int(rng.integers(1 << 31))
        self.parameters = {'glint': 0.015 * self.strength}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Apply the pane."""
        height, width = self.optics.shape
        if self._edge is None:
            return light
        y, x = np.mgrid[:height, :width]
        inside = x > self._edge * width if self._right else x < self._edge * width
        K = self.optics.wavenumbers[:, None, None]
        facing = np.exp(-((y - height / 2) ** 2 + (x - width / 2) ** 2) / (0.5 * width) ** 2)
        glint = (
            self.parameters['glint']
            * facing
            * np.exp(1j * K * self._distance * self.optics.ray_length)
        )
        through = light * 0.8 * np.exp(1j * K * 0.003 * self.strength) + glint
        return np.where(inside, through, light).astype(np.complex64)

    def start(self, recording: int) -> None:
        """Take the pane of this recording."""
        rng = np.random.default_rng([self._rng_seed, recording])
        self._edge = rng.uniform(0.3, 0.7) if rng.random() < 0.7 else None
        self._right, self._distance = rng.random() < 0.5, rng.uniform(0.2, 0.5)


class Subsurface(Effect):
    """Light travels inside some materials before it returns: wax, foam, skin."""

    name = 'subsurface'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw which reflectivities are such materials."""
        self._delays = 0.015 * self.strength * (rng.permutation(10) < 4)
        self.parameters = {'depth': 0.015 * self.strength}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Delay the light of these materials."""
        material = np.minimum((view.reflectivity * 10).astype(int), 9)
        K = self.optics.wavenumbers[:, None, None]
        return (light * np.exp(1j * K * self._delays[material])).astype(np.complex64)


class Haze(Effect):
    """Fog between camera and scene absorbs light and reflects a part of it."""

    name = 'haze'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the extinction, 1/m, and tabulate the fog's phasor up to each range."""
        self._density = 0.0015 * self.strength
        step = 0.005
        self._ranges = np.arange(0.15, 8.0, step)
        K = self.optics.wavenumbers[:, None]
        glow = (
            self._density
            * np.exp(-2 * self._density * self._ranges)
            / self._ranges**2
            * np.exp(1j * K * self._ranges)
            * step
        )
        self._sums = np.cumsum(glow, axis=1)
        self.parameters = {'extinction': self._density}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Dim distant surfaces and add the light of the fog."""
        place = np.clip(np.searchsorted(self._ranges, view.path), 0, len(self._ranges) - 1)
        dim = np.exp(-2 * self._density * view.path)
        return (light * dim + self._sums[:, place]).astype(np.complex64)


class RepeatedFrames(Effect):
    """A late frame is replaced by the previous one."""

    name = 'repeated_frames'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the probability."""
        self._share = min(0.3 * self.strength, 0.9)
        self._before: np.ndarray | None = None
        self.parameters = {'share': self._share}

    def start(self, recording: int) -> None:
        """Forget the previous recording."""
        self._before = None

    def report(self, frame: Frame) -> None:
        """Repeat the previous frame, or keep this one."""
        if self._before is not None and frame.dice.random() < self._share:
            frame.depth = self._before.copy()
        self._before = frame.depth


class BlockCompression(Effect):
    """Depth is compressed in blocks of 8 x 8 pixels."""

    name = 'block_compression'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the quantiser and the cosine transform."""
        self._step = 0.012 * self.strength
        k, n = np.mgrid[:8, :8]
        self._basis = np.cos(math.pi * k * (2 * n + 1) / 16) * math.sqrt(0.25)
        self._basis[0] /= math.sqrt(2)
        self._coarse = self._step * (0.3 + 0.35 * (k + n))
        self.parameters = {'step': self._step}

    def report(self, frame: Frame) -> None:
        """Transform, round and transform back; invalid pixels stay invalid."""
        if not self._step:
            return
        height, width = (size // 8 * 8 for size in self.optics.shape)
        part = frame.depth[:height, :width]
        blocks = part.reshape(height // 8, 8, width // 8, 8).transpose(0, 2, 1, 3)
        valid = np.isfinite(blocks)
        count = np.maximum(valid.sum(axis=(2, 3), keepdims=True), 1)
        mean = np.where(valid, blocks, 0).sum(axis=(2, 3), keepdims=True) / count
        waves = self._basis @ np.where(valid, blocks, mean) @ self._basis.T
        waves = np.rint(waves / self._coarse) * self._coarse
        back = self._basis.T @ waves @ self._basis
        back = np.where(valid, back, np.nan).transpose(0, 2, 1, 3)
        frame.depth[:height, :width] = back.reshape(height, width)
