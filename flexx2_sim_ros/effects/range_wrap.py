"""Range wrap: the ambiguity of phase."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
from flexx2_sim_ros.physics.philox import fill_normals, stamp_words
from numba import njit
import numpy as np

RARE = 6.0  # sigmas of noise that are not looked into


@dataclass(frozen=True)
class RangeWrap(Effect):
    """
    Distances that come back wrapped.

    With two frequencies the camera takes those whole wraps at which its two distances agree best.
    Noise that puts them apart by more than half a step of their lattice (0.62 m with 80 and
    60 MHz) makes it take the neighbour: the distance at 80 MHz jumps by 1.87 m, that at 60 MHz by
    2.50 m, and their mean, weighted as their noise asks for, by 2.10 m.
    """

    name: ClassVar[str] = 'range_wrap'
    stage: ClassVar[Stage] = Stage.WRAP
    title: ClassVar[str] = 'ambiguity of the phase: jumps by whole lattice steps'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('validity', 'outliers')
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'c / 2f: 2.498 m at 60 MHz, 1.874 m at 80 MHz, 7.495 m at their beat'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (grid('strength', (0.5, 1.0, 2.0), 0.0, 3.0),)
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'wraps of the phase'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('gross', 'distance'),)
    picture: ClassVar[Picture] = Picture('wrapped', 'beyond', usecase='Mode_5_30fps')
    stream: ClassVar[int] = 5
    share_stream: ClassVar[int] = 9
    batched: ClassVar[tuple[str, ...] | None] = ()

    share: float = parameter(
        1.0,
        0.0,
        1.0,
        '',
        'fraction of returns from beyond the range that are not recognised, at strength 1',
    )

    def apply(self, state: FrameState) -> None:
        """Take depth modulo the ambiguity; with several frequencies, unwrap wrongly first."""
        if len(state.mode.modulation_hz) > 1:
            self._unwrap_wrongly(state)
        ambiguity = np.float32(state.ambiguity)
        measured = state.measured
        with np.errstate(invalid='ignore'):
            unseen = (
                (measured < 0)
                | (measured >= ambiguity)
                | (state.depth > np.float32(state.mode.range_max))
            )
        beyond = np.flatnonzero(unseen)
        if beyond.size:
            values = measured.reshape(-1)[beyond]
            wraps = np.floor(values / ambiguity)
            noticed = state.uniforms(self.share_stream).reshape(-1)[beyond] > np.float32(
                min(self.strength * self.share, 1.0)
            )
            values = values - wraps * ambiguity
            values[noticed | (wraps == 0)] = np.nan
            measured.reshape(-1)[beyond] = values

    def _unwrap_wrongly(self, state: FrameState) -> None:
        # How far each frequency's distance is from their weighted mean: by unequal shifts, and by
        # noise that falls as 1/f and leaves the mean's sigma as it is.
        frequencies = state.mode.modulation_hz
        norm = math.sqrt(sum(f * f for f in frequencies))
        spreads = np.array([norm / f for f in frequencies], np.float32)
        pairs = [
            (
                i,
                j,
                math.hypot(spreads[i], spreads[j]),
                lattice_step(frequencies[i], frequencies[j]),
            )
            for i in range(len(frequencies))
            for j in range(i)
        ]
        sigma = np.float32(self.strength) * state.sigma.reshape(-1)
        shifts = [shift.reshape(-1) for shift in state.shifts]
        # As long as no two of them are apart by half a step, all is well.
        risky = np.flatnonzero(
            np.any(
                [
                    np.abs(shifts[i] - shifts[j]) + np.float32(RARE * spread) * sigma > step / 2
                    for i, j, spread, step in pairs
                ],
                axis=0,
            )
        )
        if not risky.size:
            return
        draws = np.empty((len(frequencies), state.depth.size), np.float32)
        fill_normals(state.key, *stamp_words(state.stamp), self.stream, draws.reshape(-1))
        errors = spreads[:, None] * sigma[risky] * draws[:, risky] + np.stack(
            [shift[risky] for shift in shifts]
        )
        apart = np.any(
            [np.abs(errors[i] - errors[j]) > step / 2 for i, j, _, step in pairs], axis=0
        )
        _unwrap(
            errors[:, apart],
            risky[apart],
            np.array(state.spans, np.float32),
            np.array(state.weights, np.float32),
            np.float32(state.ambiguity),
            state.measured.reshape(-1),
        )


def lattice_step(one: float, other: float) -> np.float32:
    """Return the lattice of distances that repeat after c/2f1 and c/2f2: c gcd / (2 f1 f2)."""
    common = math.gcd(round(one / 1e6), round(other / 1e6)) * 1e6
    return np.float32(SPEED_OF_LIGHT * common / (2.0 * one * other))


@njit(cache=True)
def _unwrap(errors, pixels, spans, weights, ambiguity, measured):
    # For every whole wrap of the finest frequency the others' nearest; of all these the one at
    # which the distances agree best, within the ambiguity. errors: (frequencies, pixels).
    finest = int(np.argmin(spans))
    most = int(np.ceil(ambiguity / spans[finest]))
    for i in range(pixels.size):
        here = measured[pixels[i]]
        best, jump = np.float32(np.inf), np.float32(0.0)
        for wrap in range(-most, most + 1):
            first = errors[finest, i] + np.float32(wrap) * spans[finest]
            mean, mean_jump = np.float32(0.0), np.float32(0.0)
            for f in range(spans.size):
                wrapped = np.rint((first - errors[f, i]) / spans[f]) * spans[f]
                mean += weights[f] * (errors[f, i] + wrapped)
                mean_jump += weights[f] * wrapped
            misfit = np.float32(0.0)
            for f in range(spans.size):
                wrapped = np.rint((first - errors[f, i]) / spans[f]) * spans[f]
                misfit += weights[f] * (errors[f, i] + wrapped - mean) ** 2
            # No jump at all needs no room.
            fits = wrap == 0 or 0 <= here + mean_jump < ambiguity
            if fits and misfit < best:
                best, jump = misfit, mean_jump
        measured[pixels[i]] = here + jump
