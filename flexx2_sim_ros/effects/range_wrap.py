"""Range wrap: the ambiguity of phase."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis, Searched
from flexx2_sim_ros.effects.phasors import own_frequency
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, MHZ, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import ceiling, f32, floor, i32, nearest, root, size, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.philox import fill_normals, stamp_words
import numpy as np

_RARE = f32(6.0)  # sigmas of noise that are not looked into
_ZERO = f32(0.0)
_HALF = f32(0.5)
_NAN = f32(math.nan)
_LARGEST = f32(np.finfo(np.float32).max)


def widest_apart(spread: float, other: float, sigma: float) -> float:
    """
    Return how far noise may put the distances of two frequencies apart, metres.

    ``spread`` and ``other`` are the noise of each distance in sigmas of their mean, whose
    ``sigma`` is in metres.
    """
    return _RARE * root(spread * spread + other * other) * sigma


def is_apart(one: float, other: float, more: float, step: float) -> bool:
    """Say whether two distances, and ``more`` between them, are apart by half a lattice step."""
    return size(one - other) + more > _HALF * step


def misread(shift: float, spread: float, sigma: float, normal: float) -> float:
    """Return how far a frequency's distance is from the mean, metres, with its own noise."""
    return spread * sigma * normal + shift


def wrong_jump(
    errors: np.ndarray,
    spans: np.ndarray,
    weights: np.ndarray,
    count: int,
    ambiguity: float,
    here: float,
) -> float:
    """
    Return the jump to those whole wraps at which the frequencies' distances agree best, metres.

    For every whole wrap of the finest frequency the others' nearest wraps are taken. ``errors``
    are how far each frequency's distance is from their mean ``here``, ``spans`` the depth after
    which each phase repeats, ``ambiguity`` that after which all of them repeat together, all in
    metres; the jump stays within it. ``weights`` are those in the mean.
    """
    finest = i32(0)
    for f in range(count):
        if spans[f] < spans[finest]:
            finest = f
    last = i32(ceiling(ambiguity / spans[finest]))
    best = f32(_LARGEST)
    jump = f32(0.0)
    for wrap in range(-last, last + 1):
        first = errors[finest] + f32(wrap) * spans[finest]
        mean = f32(0.0)
        mean_jump = f32(0.0)
        for f in range(count):
            wrapped = nearest((first - errors[f]) / spans[f]) * spans[f]
            mean += weights[f] * (errors[f] + wrapped)
            mean_jump += weights[f] * wrapped
        there = here + mean_jump
        # No jump at all needs no room.
        if wrap == 0 or (there >= _ZERO and there < ambiguity):
            misfit = f32(0.0)
            for f in range(count):
                wrapped = nearest((first - errors[f]) / spans[f]) * spans[f]
                off = errors[f] + wrapped - mean
                misfit += weights[f] * (off * off)
            better = misfit < best
            best = where(better, misfit, best)
            jump = where(better, mean_jump, jump)
    return jump


def is_beyond(depth: float, z: float, ambiguity: float, range_max: float) -> bool:
    """Say whether a depth is outside the ambiguity range, or its surface outside the mode's."""
    return where(depth < _ZERO, True, where(depth >= ambiguity, True, z > range_max))


def folded(depth: float, ambiguity: float, chance: float, share: float) -> float:
    """
    Return a depth modulo the ambiguity; NaN where there is nothing to wrap, or it is noticed.

    Both are in metres. ``chance`` is the pixel's random number, 0..1, ``share`` the fraction that
    is not noticed.
    """
    wraps = floor(depth / ambiguity)
    wrapped = where(wraps == _ZERO, _NAN, depth - wraps * ambiguity)
    return where(chance > share, _NAN, wrapped)


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
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('noise and fraction', (Free('noise', 0.2, 10.0, log=True), Free('share', 0.0, 1.0))),
        Shape('fraction, one frequency', (Free('share', 0.0, 1.0), MHZ)),
    )
    searched: ClassVar[Searched | None] = Searched(
        'fold',
        lambda found: (
            grid(
                'share',
                (0.25, 0.5, 1.0),
                0.0,
                1.0,
                f'every {found[0]:.3g} m',
                mhz=SPEED_OF_LIGHT / (2e6 * found[0]),
            ),
        ),
    )
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
    noise: float | None = optional_number(
        '',
        0.0,
        50.0,
        'factor on the noise along the ray where frequencies are compared, in place of the '
        'strength; the fraction then holds for all wrong distances',
    )
    mhz: float | None = own_frequency()

    def constants(self) -> dict[str, float]:
        """Return the factor on sigma_z, and the fraction of wrapped returns."""
        return {'noise': self.strength, 'share': min(self.strength * self.share, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Take depth modulo the ambiguity; with several frequencies, unwrap wrongly first."""
        noise, share = self.rounded
        ray = np.ones((1, 1), np.float32)
        if self.noise is not None or self.mhz is not None:
            ray = ray_length(state.intrinsics.matrix, state.depth.shape).astype(np.float32)
        lengths = np.broadcast_to(ray, state.depth.shape)
        if self.mhz is not None:
            right = state.measured.copy()
            self._fold(state, np.float32(SPEED_OF_LIGHT / (2e6 * self.mhz)), share, lengths)
            # Within the range of the mode, what is not folded is resolved.
            kept = np.isnan(state.measured) & (state.depth <= np.float32(state.mode.range_max))
            state.measured[kept] = right[kept]
            return
        if len(state.mode.modulation_hz) > 1:
            factor = noise if self.noise is None else np.float32(self.noise)
            self._unwrap_wrongly(state, factor, lengths)
        self._fold(state, np.float32(state.ambiguity), share, lengths)

    def _fold(
        self, state: FrameState, ambiguity: np.float32, share: np.float32, lengths: np.ndarray
    ) -> None:
        # Take depth times `lengths` modulo the ambiguity.
        measured = state.measured
        flags, most = np.empty(measured.shape, np.bool_), np.float32(state.mode.range_max)
        _find_beyond(measured, lengths, state.depth, ambiguity, most, flags)
        beyond = np.flatnonzero(flags)
        if beyond.size:
            chances = state.uniforms(self.share_stream).reshape(-1)[beyond]
            ray = lengths.reshape(-1)[beyond]
            values = measured.reshape(-1)[beyond] * ray
            measured.reshape(-1)[beyond] = (
                on_images(folded)(values, ambiguity, chances, share) / ray
            )

    def _unwrap_wrongly(self, state: FrameState, noise: np.float32, lengths: np.ndarray) -> None:
        # How far each frequency's distance is from their weighted mean: by unequal shifts, and by
        # noise that falls as 1/f and leaves the mean's sigma as it is. All times `lengths`.
        frequencies = state.mode.modulation_hz
        ray = lengths.reshape(-1)
        light = (
            np.stack(state.shifts).reshape(len(frequencies), -1),
            ray,
            state.sigma.reshape(-1),
            noise,
            noise_shares(frequencies),
            _steps(frequencies),
        )
        # As long as no two of them are apart by half a step, all is well.
        flags = np.zeros(ray.size, np.bool_)
        _find_risky(*light, flags)
        risky = np.flatnonzero(flags)
        if not risky.size:
            return
        draws = np.empty((len(frequencies), ray.size), np.float32)
        fill_normals(state.key, *stamp_words(state.stamp), self.stream, draws.reshape(-1))
        errors = np.empty((risky.size, len(frequencies)), np.float32)
        apart = np.empty(risky.size, np.bool_)
        _misread_at(risky, *light, draws, errors, apart)
        pixels = risky[apart]
        values = state.measured.reshape(-1)[pixels] * ray[pixels]
        _unwrap(
            errors[apart],
            np.arange(pixels.size),
            np.array(state.spans, np.float32),
            np.array(state.weights, np.float32),
            np.float32(state.ambiguity),
            values,
        )
        if self.noise is not None:  # What is noticed is lost.
            chances = state.uniforms(self.share_stream).reshape(-1)[pixels]
            values[chances > self.rounded[1]] = np.nan
        state.measured.reshape(-1)[pixels] = values / ray[pixels]


def noise_shares(frequencies: Sequence[float]) -> np.ndarray:
    """Return the noise of each frequency's distance, in sigmas of their mean, float32."""
    hertz = np.array(frequencies)
    return (np.sqrt((hertz**2).sum()) / hertz).astype(np.float32)


def lattice_step(one: float, other: float) -> np.float32:
    """Return the lattice of distances that repeat after c/2f1 and c/2f2: c gcd / (2 f1 f2)."""
    common = math.gcd(round(one / 1e6), round(other / 1e6)) * 1e6
    return np.float32(SPEED_OF_LIGHT * common / (2.0 * one * other))


def any_apart(frequencies: Sequence[float], errors: np.ndarray) -> np.ndarray:
    """Return (N,) whether two of (F, N) distances, of F frequencies, are apart by half a step."""
    steps = _steps(frequencies)
    return np.any(
        [
            on_images(is_apart)(errors[i], errors[j], _ZERO, steps[i, j])
            for i in range(len(frequencies))
            for j in range(i)
        ],
        axis=0,
    )


def _steps(frequencies: Sequence[float]) -> np.ndarray:
    # (F, F) float32, `lattice_step` of each pair.
    return np.array([[lattice_step(one, other) for other in frequencies] for one in frequencies])


_wrong_jump = compiled(wrong_jump)
_is_beyond = compiled(is_beyond)
_is_apart = compiled(is_apart)
_misread = compiled(misread)
_widest_apart = compiled(widest_apart)


@loop(error_model='numpy')
def _find_beyond(measured, lengths, depth, ambiguity, range_max, beyond):
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            here = measured[y, x] * lengths[y, x]
            beyond[y, x] = _is_beyond(here, depth[y, x], ambiguity, range_max)


@loop(error_model='numpy')
def _find_risky(shifts, ray, sigma, noise, spreads, steps, risky):
    # Where noise may put two frequencies apart. shifts: (frequencies, pixels).
    for i in range(spreads.size):
        for j in range(i):
            for k in range(ray.size):
                more = _widest_apart(spreads[i], spreads[j], noise * sigma[k] * ray[k])
                one, other = shifts[i, k] * ray[k], shifts[j, k] * ray[k]
                risky[k] |= _is_apart(one, other, more, steps[i, j])


@loop(error_model='numpy')
def _misread_at(pixels, shifts, ray, sigma, noise, spreads, steps, normals, errors, apart):
    # errors: (pixels, frequencies).
    for n in range(pixels.size):
        k = pixels[n]
        spread = noise * sigma[k] * ray[k]
        wrong = False
        for i in range(spreads.size):
            errors[n, i] = _misread(shifts[i, k] * ray[k], spreads[i], spread, normals[i, k])
            for j in range(i):
                wrong |= _is_apart(errors[n, i], errors[n, j], _ZERO, steps[i, j])
        apart[n] = wrong


@loop(error_model='numpy')
def _unwrap(errors, pixels, spans, weights, ambiguity, measured):
    # errors: (pixels, frequencies).
    for i in range(pixels.size):
        here = measured[pixels[i]]
        measured[pixels[i]] = here + _wrong_jump(
            errors[i], spans, weights, spans.size, ambiguity, here
        )
