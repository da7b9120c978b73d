"""The ambiguity of phase: wrapped and wrongly unwrapped distances."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.camera.exposure import Exposure, Stage
from flexx2_sim_ros.camera.philox import fill_normals, stamp_words, STREAM_WRAP, STREAM_WRAP_SHARE
from flexx2_sim_ros.effects.effect import Effect, parameter
import numpy as np


@dataclass(frozen=True)
class RangeWrap(Effect):
    """Distances that come back wrapped."""

    name: ClassVar[str] = 'range_wrap'
    stage: ClassVar[Stage] = Stage.WRAP
    title: ClassVar[str] = 'ambiguity of the phase: jumps by whole lattice steps'
    covariate: ClassVar[str] = 'distance'
    source: ClassVar[str] = 'c / 2f: 2.498 m at 60 MHz, 1.874 m at 80 MHz, 7.495 m at their beat'

    share: float = parameter(1.0, 0.0, 1.0, '', 'of what lies beyond the range and is not '
                             'recognised as such, at strength 1')

    def apply(self, exposure: Exposure) -> None:
        """Take depth modulo the ambiguity; with two frequencies, first choose the wrong wrap."""
        if len(exposure.mode.modulation_hz) > 1:
            self._unwrap_wrongly(exposure)
        ambiguity = np.float32(exposure.ambiguity)
        measured = exposure.measured
        with np.errstate(invalid='ignore'):
            unseen = ((measured < 0) | (measured >= ambiguity)
                      | (exposure.depth > np.float32(exposure.mode.range_max)))
        beyond = np.flatnonzero(unseen)
        if beyond.size:
            values = measured.reshape(-1)[beyond]
            wraps = np.floor(values / ambiguity)
            noticed = (exposure.uniforms(STREAM_WRAP_SHARE).reshape(-1)[beyond]
                       > np.float32(min(self.strength, 1.0) * self.share))
            values = values - wraps * ambiguity
            values[noticed | (wraps == 0)] = np.nan
            measured.reshape(-1)[beyond] = values

    def _unwrap_wrongly(self, exposure: Exposure) -> None:
        # Two frequencies f1, f2 = n1 g, n2 g repeat after B / n1 and B / n2, B = c / 2g. Their
        # distances, wrapped, differ by multiples of B / (n1 n2) if exact; what they differ by
        # beyond that is noise and unequal shifts. More than half a step picks the neighbour.
        f1, f2 = exposure.mode.modulation_hz[:2]
        common = math.gcd(round(f1), round(f2))
        n1, n2 = round(f1) // common, round(f2) // common
        beat = exposure.ambiguity
        step = beat / (n1 * n2)
        # Noise falls as 1/f; this is the difference's share that leaves the mean's sigma as is.
        spread = math.sqrt((f1 ** 2 + f2 ** 2) * (1 / f1 ** 2 + 1 / f2 ** 2))
        draws = np.empty(exposure.depth.shape, np.float32)
        low, high = stamp_words(exposure.stamp)
        fill_normals(exposure.key, low, high, STREAM_WRAP, draws.ravel())
        difference = (np.float32(self.strength * spread) * exposure.sigma * draws
                      + (exposure.shifts[0] - exposure.shifts[1]))
        wrong = np.flatnonzero(np.abs(difference) > np.float32(step / 2))
        steps = np.rint(difference.reshape(-1)[wrong] / step).astype(np.int32)
        # n2 k1 - n1 k2 = -steps says which whole wraps k1, k2 the neighbour has.
        k1 = (-steps * pow(n2, -1, n1)) % n1
        k2 = (n2 * k1 + steps) // n1
        w1, w2 = exposure.weights[:2]
        jump = (w1 * k1 / n1 + w2 * k2 / n2) * beat
        # The same jump, counted from the nearer side.
        jump = np.where(jump > beat / 2, jump - beat, jump)
        exposure.measured.reshape(-1)[wrong] += jump.astype(np.float32)
