"""How each pixel moves between two frames, and which edges pass it: shared by effects."""

from collections.abc import Callable
from functools import partial
from typing import Any

from flexx2_sim_ros.effects import passing
from flexx2_sim_ros.effects.effect import Effect
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import f32, most
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

TAPS = 4
DARKEST = f32(1e-3)  # reflectivity that the light of raw frames is compared with
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)
_STILL, _MOVING = np.uint8(1), np.uint8(2)


def tap_moment(tap: float, taps: float, acquisition: float, stamp_at: float) -> float:
    """
    Return when raw frame `tap` of `taps` is taken: 0 at the frame before, 1 at this one.

    It is never before 0. ``acquisition`` is the time that all of them take, over the time between
    two frames; ``stamp_at`` is when in it the stamp is, 0..1.
    """
    return most(_ONE - acquisition * (stamp_at - (tap + _HALF) / taps), _ZERO)


_find_passing = compiled(passing.find_passing)
_is_edge = compiled(passing.is_edge)
_is_level = compiled(passing.is_level)
_own_change = compiled(passing.own_change)
_resembles = compiled(passing.resembles)


def find_motion(
    state: FrameState, depth: np.ndarray, effect: Effect, stretch: float, stamp_at: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return when raw frames are taken, and how pixels move; None if nothing does, or in frame 1.

    Keeps the frame for the next call of the same `effect`. `depth` is that of the scene, (H, W)
    float32 metres; ``stretch`` is the factor on the duration of the raw frames, ``stamp_at`` when
    in it the stamp is.

    Returns
    -------
    moments : numpy.ndarray
        (taps,) float32, see `tap_moment`.
    motion : numpy.ndarray
        (5, H, W) float32: the depth before less that now, metres, and the light before over that
        now, of the same surface; depth, light and time of what is on the other side of an edge
        that passes, see `passing.find_passing`.

    """
    before: Any = state.memory.kept.get(effect.name)
    shown = depth.shape
    rho = np.maximum(state.reflectivity, DARKEST)
    state.memory.kept[effect.name] = (state.stamp, depth.copy(), rho)
    if (
        before is None
        or before[0] >= state.stamp
        or before[1].shape != shown
        or (
            np.array_equal(before[1].view(np.uint32), depth.view(np.uint32))
            and np.array_equal(before[2], rho)
        )
    ):
        return None
    seconds = (state.stamp - before[0]) * 1e-9
    taps = TAPS * len(state.shifts)
    acquisition = stretch * state.acquisition_seconds / seconds
    moments = on_images(tap_moment)(np.arange(taps), taps, acquisition, stamp_at)
    moments = moments.astype(np.float32)
    images = tuple(
        np.ascontiguousarray(
            image if image.shape == shown else np.broadcast_to(image, shown), np.float32
        ).reshape(-1)
        for image in (before[1], depth, before[2], rho)
    )
    motion = np.empty((5, *shown), np.float32)
    # Where in its pixel an edge is, is not known: a random place.
    draw = partial(state.uniforms, effect.stream)
    _find_motion(images, draw, np.float32(seconds), moments[[0, -1]], motion)
    return moments, motion


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
