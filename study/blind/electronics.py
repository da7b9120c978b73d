"""Effects of the sensor: delays, waveforms, charge, noise of the taps."""

import math

import numpy as np
from study.blind.frame import Effect, Frame


class Offset(Effect):
    """A delay of the reference clock changes all ranges by the same distance."""

    name = 'offset'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the sign."""
        self._delay = 0.01 * self.strength * rng.choice((-1, 1))
        self.parameters = {'bias': self._delay}

    def before(self, frame: Frame) -> None:
        """Delay."""
        frame.delay = frame.delay + in_range(frame, self._delay)


def in_range(frame: Frame, delay: np.ndarray | float) -> np.ndarray | float:
    """Return a delay in metres of range; an axial camera has it in metres of depth."""
    return delay * frame.view.ray_length if frame.optics.internals.axial else delay


class DepthScale(Effect):
    """The clock runs at another frequency than the camera believes: all ranges are scaled."""

    name = 'depth_scale'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the sign."""
        self._scale = 0.02 * self.strength * rng.choice((-1, 1))
        self.parameters = {'fraction': self._scale}

    def before(self, frame: Frame) -> None:
        """Delay in proportion to the path."""
        frame.delay = frame.delay + self._scale * frame.view.path


class Wiggling(Effect):
    """
    The correlation has third and fifth harmonics, and the pairs of taps differ.

    With four taps, the third and fifth harmonics cause errors with four periods per period of
    the phase; unequal pairs cause errors with two. With a period of its own, the error is a delay
    with one and two waves in this period: light that is reflected inside the camera.
    """

    name = 'wiggling'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the waveform and the gains of the pairs for each frequency."""
        K = self.optics.wavenumbers
        weights = K**2 / (K**2).sum()
        size = 0.006 * self.strength / np.sqrt((weights**2).sum())
        share = rng.uniform(0.3, 0.8, len(K))  # fraction of the variance that the harmonics cause
        error = size * K * math.sqrt(2)
        self._harmonics = (error * np.sqrt(share))[:, None] * np.array([[0.9, 0.43]])
        self._phases = rng.uniform(0, 2 * math.pi, (len(K), 2))
        self._pairs = 2 * error * np.sqrt(1 - share) * rng.choice((-1, 1), len(K))
        self.parameters = {'rms': 0.006 * self.strength}

    def before(self, frame: Frame) -> None:
        """Add the delay with a period of its own."""
        period = self.optics.internals.wave_m
        if period:
            turns = 2 * math.pi * frame.view.path / period
            one, other = self._phases[0]
            wave = 0.9 * np.cos(turns + one) + 0.43 * np.cos(2 * turns + other)
            delay = math.sqrt(2) * 0.006 * self.strength * wave
            frame.delay = frame.delay + in_range(frame, delay)

    def charge(self, frame: Frame) -> None:
        """Add harmonics and unequal gains to the taps."""
        if self.optics.internals.wave_m:
            return
        taps = frame.taps
        for j in range(len(taps)):
            phasor = 0.5 * (taps[j, 0] - taps[j, 2] + 1j * (taps[j, 3] - taps[j, 1]))
            size = np.abs(phasor)
            unit = phasor / np.maximum(size, 1e-12)
            for order, share, phase in zip(
                (3, 5), self._harmonics[j], self._phases[j], strict=True
            ):
                wave = unit**order * np.complex64(share * np.exp(1j * phase))
                for k in range(4):
                    taps[j, k] += size * (wave * np.complex64(1j ** (order * k))).real
            taps[j, 1::2] *= np.float32(1 + self._pairs[j])


class WarmUpDrift(Effect):
    """Laser driver (minutes) and board (tens of minutes) warm up."""

    name = 'warm_up_drift'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the sign and the two time constants."""
        self._bias = 0.015 * self.strength * rng.choice((-1, 1))
        self._fast, self._slow = rng.uniform(180, 360), rng.uniform(900, 1500)
        self.parameters = {'bias': self._bias, 'tau': 0.4 * self._fast + 0.6 * self._slow}

    def before(self, frame: Frame) -> None:
        """Delay by an amount that decays with the uptime."""
        cold = 0.4 * math.exp(-frame.uptime / self._fast) + 0.6 * math.exp(
            -frame.uptime / self._slow
        )
        frame.delay = frame.delay + in_range(frame, self._bias * cold)


class AmplitudeBias(Effect):
    """A tap that collects little charge transfers it late."""

    name = 'amplitude_bias'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the lag of an empty tap."""
        self._lag = 0.014 * self.strength * rng.uniform(0.9, 1.1)
        self.parameters = {'lag': self._lag}

    def charge(self, frame: Frame) -> None:
        """Let each tap lag by its own charge."""
        taps = frame.taps
        for j, K in enumerate(self.optics.wavenumbers):
            size = 0.5 * np.hypot(taps[j, 0] - taps[j, 2], taps[j, 3] - taps[j, 1])
            lag = self._lag * K / (1 + np.maximum(size + taps[j], 0) / self.optics.internals.knee)
            taps[j] += lag.astype(np.float32) * np.roll(taps[j], -1, axis=0)


class FixedPattern(Effect):
    """The clock arrives at each pixel with a delay of its column, its row and its own."""

    name = 'fixed_pattern'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the delays of one sensor."""
        height, width = self.optics.shape
        columns = np.cumsum(rng.standard_normal(width))
        columns -= np.convolve(np.pad(columns, 8, mode='edge'), np.ones(17) / 17, 'valid')
        pattern = (
            rng.standard_normal((height, width))
            + 0.8 * columns / columns.std()
            + 0.4 * rng.standard_normal((height, 1))
        )
        rms = 0.002 * self.strength
        self._delays = (rms * pattern / pattern.std()).astype(np.float32)
        self.parameters = {'rms': rms}

    def before(self, frame: Frame) -> None:
        """Delay each pixel."""
        frame.delay = frame.delay + self._delays


class ExcessNoise(Effect):
    """The amplifiers are noisier than in the camera of the paper."""

    name = 'excess_noise'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the factor."""
        self._factor = 1 + 0.35 * self.strength
        self.parameters = {'factor': self._factor}

    def before(self, frame: Frame) -> None:
        """Increase the noise of the taps."""
        frame.noise_gain = frame.noise_gain * self._factor


class AmbientLight(Effect):
    """Sunlight on the surfaces adds shot noise that does not depend on the distance."""

    name = 'ambient_light'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the noise at amplitude 1, reflectivity 1: metres of range."""
        self._noise = 0.0008 * self.strength
        self.parameters = {'k': self._noise}

    def before(self, frame: Frame) -> None:
        """Add variance in proportion to the sunlight each surface returns."""
        view, K = frame.view, self.optics.wavenumbers
        total = math.sqrt((K**2).sum())
        with np.errstate(divide='ignore', invalid='ignore'):
            extra = (
                self._noise * total * np.sqrt(view.reflectivity) / view.amplitude / view.noise[0]
            )
        extra = np.nan_to_num(np.minimum(extra, 30))
        frame.noise_gain = np.sqrt(np.square(frame.noise_gain) + np.square(extra))


class PhaseNoiseWiggling(Effect):
    """The pairs of taps differ in noise, so that the noise of the range varies with the phase."""

    name = 'phase_noise_wiggling'

    def draw(self, rng: np.random.Generator) -> None:
        """Draw how much the pairs differ, and where each frequency has its lowest noise."""
        self._share = min(0.5 * self.strength, 0.95)
        self._turns = rng.uniform(0, 2 * math.pi, len(self.optics.wavenumbers))
        self.parameters = {'share': self._share}

    def before(self, frame: Frame) -> None:
        """Scale the variance of each frequency by its phase."""
        K = self.optics.wavenumbers
        variance = (
            sum(
                k**2 * (1 + self._share * np.cos(2 * k * frame.view.path + turn))
                for k, turn in zip(K, self._turns, strict=True)
            )
            / (K**2).sum()
        )
        frame.noise_gain = frame.noise_gain * np.sqrt(np.nan_to_num(variance, nan=1.0))


class HeavyTails(Effect):
    """A few random pixels get a packet of charge in one tap."""

    name = 'heavy_tails'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the fraction of pixels."""
        self._share = min(0.01 * self.strength, 0.2)
        self.parameters = {'share': self._share}

    def charge(self, frame: Frame) -> None:
        """Add the packets."""
        frequencies, _, height, width = frame.taps.shape
        hits = frame.dice.poisson(self._share * height * width)
        y, x = frame.dice.integers(height, size=hits), frame.dice.integers(width, size=hits)
        j, k = frame.dice.integers(frequencies, size=hits), frame.dice.integers(4, size=hits)
        spread = (
            math.sqrt(2 * frequencies)
            * frame.seen(frame.view.amplitude * frame.view.noise[0])[y, x]
        )
        frame.taps[j, k, y, x] += (9.0 * spread * frame.dice.standard_normal(hits)).astype(
            np.float32
        )


class Saturation(Effect):
    """The well is full: near, bright, or glossy surfaces that face the camera."""

    name = 'saturation'
    _GLOSS, _LOBE = 2.0, 0.1  # fraction of specular reflection; its width in radians

    def draw(self, rng: np.random.Generator) -> None:
        """Draw each pixel's full well, 1/m^2."""
        self._well = 5.2 / max(self.strength, 1e-6) * self.optics.internals.light_scale
        self._wells = (self._well * np.exp(0.08 * rng.standard_normal(self.optics.shape))).astype(
            np.float32
        )
        self.parameters = {'amplitude': self._well / 2}

    def before(self, frame: Frame) -> None:
        """Add specular reflection."""
        theta = np.arccos(np.clip(frame.view.cosine, 0, 1))
        shine = 1 + self._GLOSS * np.exp(-((theta / self._LOBE) ** 2)) * (
            frame.view.reflectivity > 0.45
        )
        frame.light = frame.light * shine.astype(np.float32)
        # Specular reflection shows speckles: more light, but the noise of the phase stays.
        frame.noise_gain = frame.noise_gain * shine / np.sqrt(0.5 + 0.5 * shine)

    def charge(self, frame: Frame) -> None:
        """Clip the taps and flag the pixels that were clipped."""
        taps = frame.taps
        size = 0.5 * np.hypot(taps[:, 0] - taps[:, 2], taps[:, 3] - taps[:, 1])[:, None]
        fill = (size + taps) / self._wells
        full = np.maximum(fill - 0.9, 0)
        taps -= self._wells * np.where(full > 0, full - 0.1 * np.tanh(full / 0.1), 0)
        frame.invalid |= (fill >= 1).any(axis=(0, 1))
        if self.optics.internals.bleed_px:
            whole = fill.max(axis=(0, 1))
            frame.invalid |= whole + _spilled(whole, self.optics.internals.bleed_px) >= 1


def _spilled(fill: np.ndarray, reach: float) -> np.ndarray:
    # (H, W) charge, in full wells, that wells get from those of their columns that overflow.
    rows = np.arange(len(fill))
    share = np.exp(-np.abs(rows[:, None] - rows) / reach)
    np.fill_diagonal(share, 0.0)
    spilled: np.ndarray = share @ np.maximum(fill - 1, 0)
    return spilled
