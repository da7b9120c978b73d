"""Motion artefact: raw frames taken one after the other."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math
from typing import Any, ClassVar

from flexx2_sim_ros.effects import passing
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Scale
from flexx2_sim_ros.effects.unwrapping import agree
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.fastmath import direction, shift_between
from flexx2_sim_ros.formulas.scalars import f32, most, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

TAPS = 4
DARKEST = f32(1e-3)  # reflectivity that the light of raw frames is compared with
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)
_TWO_PI = f32(2.0 * math.pi)
_STILL, _MOVING = np.uint8(1), np.uint8(2)


def tap_moment(tap: float, taps: float, acquisition: float, stamp_at: float) -> float:
    """
    Return when raw frame `tap` of `taps` is taken: 0 at the frame before, 1 at this one.

    It is never before 0. ``acquisition`` is the time that all of them take, over the time between
    two frames; ``stamp_at`` is when in it the stamp is, 0..1.
    """
    return most(_ONE - acquisition * (stamp_at - (tap + _HALF) / taps), _ZERO)


def tap_at(
    here: float,
    start: float,
    gain: float,
    other: float,
    other_light: float,
    when: float,
    moment: float,
    add: float,
    turns: float,
) -> tuple[float, float]:
    """
    Return cosine and sine of the phase at a moment, times the light.

    A surface moves and changes its colour evenly; another one comes into view at once.
    """
    late = moment - _ONE
    beyond = (when - _ONE) * (moment - when) > _ZERO
    seen = where(beyond, other, here - start * late)
    cosine, sine = direction(turns * (seen + add))
    # Long after the frame, light that falls evenly would be below 0.
    own_light = most(_ONE - (gain - _ONE) * late, _ZERO)
    light = where(beyond, other_light, own_light)
    return light * cosine, light * sine


def motion_shift(
    here: float,
    start: float,
    gain: float,
    other: float,
    other_light: float,
    when: float,
    m0: float,
    m1: float,
    m2: float,
    m3: float,
    wave_number: float,
    add: float,
) -> float:
    """
    Return the shift of a frequency whose four taps are taken one after the other, metres.

    The taps are cos(phase - k pi / 2); they give the phase.

    Parameters
    ----------
    here : float
        Depth, metres.
    start : float
        What was to be added to it in the frame before, metres.
    gain : float
        The light of the same surface in the frame before over that in this frame.
    other : float
        Depth of the surface that was in view before or comes into view, metres.
    other_light : float
        Its light, over that of the surface in this frame.
    when : float
        When they change places: before this frame below 1, after it above; 1 is never.
    m0, m1, m2, m3 : float
        When the taps are taken, see `tap_moment`.
    wave_number : float
        Radians of phase a metre.
    add : float
        The pixel's shift so far, metres.

    """
    turns = wave_number / _TWO_PI
    c0, _0 = tap_at(here, start, gain, other, other_light, when, m0, add, turns)
    _1, s1 = tap_at(here, start, gain, other, other_light, when, m1, add, turns)
    c2, _2 = tap_at(here, start, gain, other, other_light, when, m2, add, turns)
    _3, s3 = tap_at(here, start, gain, other, other_light, when, m3, add, turns)
    cosine, sine = direction(turns * (here + add))  # What a tap at this frame's time sees.
    return shift_between(c0 + c2, s1 + s3, cosine, sine, wave_number)


_find_passing = compiled(passing.find_passing)
_is_edge = compiled(passing.is_edge)
_is_level = compiled(passing.is_level)
_own_change = compiled(passing.own_change)
_resembles = compiled(passing.resembles)
_motion_shift = compiled(motion_shift)


@dataclass(frozen=True)
class MotionArtefact(Effect):
    """
    Raw frames taken one after the other.

    A surface that moves away or comes nearer gets a bias. Where an edge passes, raw frames see
    both of its sides: edges are found in the frame before, and go on at the same speed. If the
    frequencies see different sides, they agree on a distance that may be far from both.
    """

    name: ClassVar[str] = 'motion_artefact'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 5
    title: ClassVar[str] = (
        'raw frames taken one after the other: bias that grows with speed, errors at moving edges'
    )
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 44 mm RMS at 2 m/s and 125 ms; here 9 ms in Mode_9_30fps: 5 mm at 1 m/s'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        # What the driver stamps: the last raw frame, or the first.
        grid('stretch', (0.5, 1.0, 2.0), 0.0, 3.0, f'stamp at {stamp:g}', stamp_at=stamp)
        for stamp in (1.0, 0.0)
    )
    scale: ClassVar[Scale | None] = Scale(
        'duration of the raw frames, and the stamp',
        'stretch',
        3.0,
        ({'stamp_at': 1.0}, {'stamp_at': 0.0}),
    )
    needs_motion: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'edges')
    family: ClassVar[str] = 'sequence of raw frames'
    picture: ClassVar[Picture] = Picture('moving')
    stream: ClassVar[int] = 10
    batched: ClassVar[tuple[str, ...] | None] = ('motion',)

    stretch: float = parameter(1.0, 0.0, 20.0, '', 'factor on the duration of the raw frames')
    stamp_at: float = parameter(
        1.0,
        0.0,
        1.0,
        '',
        'when in that time the stamp is: 0 before the first raw frame, 1 after the last',
    )

    def constants(self) -> dict[str, float]:
        """Return the factor on the raw frames' duration, and when in it the stamp is."""
        return {'stretch': self.strength * self.stretch, 'stamp_at': self.stamp_at}

    def apply(self, state: FrameState) -> None:
        """Take each frequency's four taps at their own moments, and unwrap what comes out."""
        before: Any = state.memory.kept.get(self.name)
        shown = state.depth.shape
        rho = np.maximum(state.reflectivity, DARKEST)
        state.memory.kept[self.name] = (state.stamp, state.depth.copy(), rho)
        if (
            before is None
            or before[0] >= state.stamp
            or before[1].shape != shown
            or (
                np.array_equal(before[1].view(np.uint32), state.depth.view(np.uint32))
                and np.array_equal(before[2], rho)
            )
        ):
            return
        interval = (state.stamp - before[0]) * 1e-9
        duration = self.constants()['stretch'] * state.acquisition_seconds
        taps = TAPS * len(state.shifts)
        moments = on_images(tap_moment)(np.arange(taps), taps, duration / interval, self.stamp_at)
        moments = moments.astype(np.float32)
        images = tuple(
            np.ascontiguousarray(
                image if image.shape == shown else np.broadcast_to(image, shown), np.float32
            ).reshape(-1)
            for image in (before[1], state.depth, before[2], rho)
        )
        motion = np.empty((5, *shown), np.float32)
        # Where in its pixel an edge is, is not known: a random place.
        draw = partial(state.uniforms, self.stream)
        _find_motion(images, draw, np.float32(interval), moments[[0, -1]], motion)
        for index, (k, shift) in enumerate(zip(state.wave_numbers, state.shifts, strict=True)):
            own = moments[index * TAPS : (index + 1) * TAPS]
            _demodulate(state.depth, motion, own, np.float32(k), shift)
        # Frequencies that saw different surfaces.
        agree(state, np.flatnonzero(motion[-1] != _ONE))


def _find_motion(
    images: tuple[np.ndarray, ...],
    draw: Callable[[], np.ndarray],
    seconds: np.float32,
    ends: np.ndarray,
    motion: np.ndarray,
) -> None:
    # The images are flat: depth before and now, reflectivity before and now. Few edges move, and
    # only pixels near them are looked into.
    late, shape = images[1], motion.shape[1:]
    earliest, latest = _ONE - ends[0], ends[1] - _ONE
    _find_change(*images, seconds, motion.reshape(5, -1))
    edges = np.zeros((2, late.size), np.uint8)
    steps = 1, shape[1]
    for one, step in zip(edges, steps, strict=True):
        _find_edges(*images, step, one)
    edges[0].reshape(shape)[:, -1] = _STILL  # The next row is not beside it.
    moving = [np.flatnonzero(one == _MOVING) for one in edges]
    if not any(one.size for one in moving):
        return
    near = np.zeros((late.size, 4), np.uint16)
    reach = passing.edge_reach(earliest, latest)
    for side, step in enumerate(steps):
        _reach_out(edges[side], moving[side], step, reach, near[:, 2 * side : 2 * side + 2])
    pixels = np.flatnonzero(near.view(np.uint64))
    _pass_edges(*images, pixels, near, draw(), earliest, latest, motion)


@loop(error_model='numpy', fastmath=FAST)
def _find_change(early, late, early_rho, late_rho, seconds, motion):
    # No edge passes yet.
    for i in range(late.size):
        motion[0, i], motion[1, i] = _own_change(
            early[i], late[i], early_rho[i], late_rho[i], seconds
        )
        motion[2, i], motion[3, i], motion[4, i] = late[i], _ONE, _ONE


@loop(error_model='numpy', fastmath=FAST)
def _find_edges(early, late, early_rho, late_rho, step, edges):
    # Between each pixel and the one a step further.
    other, other_rho = late[step:], late_rho[step:]
    before, before_rho = early[step:], early_rho[step:]
    for i in range(other.size):
        by_colour = _is_level(late[i], other[i])
        still = _resembles(early[i], early_rho[i], late[i], late_rho[i], by_colour)
        still &= _resembles(before[i], before_rho[i], other[i], other_rho[i], by_colour)
        edge = _is_edge(late[i], other[i], late_rho[i], other_rho[i])
        edges[i] = (_STILL if still else _MOVING) if edge else 0


@loop()
def _reach_out(edges, moving, step, reach, near):
    # How many pixels away an edge that moves is, before and after it, if none is between.
    for i in moving:
        for k in range(1, reach + 1):
            j = i - (k - 1) * step
            if j < 0 or (k > 1 and edges[j]):
                break
            near[j, 0] = k
        for k in range(1, reach + 1):
            j = i + k * step
            if j >= edges.size or (k > 1 and edges[j - step]):
                break
            near[j, 1] = k


@loop(error_model='numpy', fastmath=FAST)
def _pass_edges(was, now, was_rho, now_rho, pixels, near, places, first, last, motion):
    h, w = places.shape
    for i in pixels:
        y, x, place = i // w, i % w, places[i // w, i % w]
        right, left, down, up = near[i, 0], near[i, 1], near[i, 2], near[i, 3]
        motion[2, y, x], motion[3, y, x], motion[4, y, x] = _find_passing(
            was, now, was_rho, now_rho, right, left, down, up, i, i, y, x, h, w, first, last, place
        )


@loop(error_model='numpy', fastmath=FAST)
def _demodulate(late, motion, moments, wave_number, shift):
    m0, m1, m2, m3 = moments
    for y in range(late.shape[0]):
        for x in range(late.shape[1]):
            here, add = late[y, x], shift[y, x]
            start, gain = motion[0, y, x], motion[1, y, x]
            other, light, when = motion[2, y, x], motion[3, y, x], motion[4, y, x]
            more = _motion_shift(
                here, start, gain, other, light, when, m0, m1, m2, m3, wave_number, add
            )
            shift[y, x] = add + more if here > _ZERO else add
