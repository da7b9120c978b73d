"""Time offset: stamps that are wrong, and images that arrive late."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from flexx2_sim_ros.effects.between import between, frames_around, is_late_nearer, share_of
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis, Searched
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.randomisation import Distribution
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.limits import is_finite
from flexx2_sim_ros.physics.frame_state import EffectProtocol, FrameState, Stage
import numpy as np

FRAMES_KEPT = 128


@dataclass(frozen=True)
class TimeOffset(Effect):
    """
    The age of an image: when the scene was seen, what the stamp says, when the image arrives.

    ``latency`` is the time from the exposure to the stamp: it changes what a stamped image shows.
    ``delay`` is the time from the stamp to the arrival: it changes nothing in the image. Who reads
    the image sees the scene as it was ``latency + delay`` ago.
    """

    name: ClassVar[str] = 'time_offset'
    stage: ClassVar[Stage] = Stage.GEOMETRY
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'wrong stamps: the image shows the scene as it was earlier'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = (
        'a VL53L5CX on a drone: 78 ms; modelling it reduced the error from 46.4 to '
        '25.1 mm. Here a quarter of it (assumed)'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('latency', (-0.08, -0.02, 0.01, 0.02, 0.04, 0.08, 0.16), -0.1, 0.25),
    )
    searched: ClassVar[Searched | None] = Searched(
        'latency',
        lambda found: (
            grid(
                'latency',
                (0.8 * found[0], found[0], 1.2 * found[0]),
                min(0.0, 1.5 * found[0]),
                max(0.0, 1.5 * found[0]),
                f'about {1e3 * found[0]:.0f} ms',
            ),
        ),
        lambda effect: (effect.strength * effect.latency,),
    )
    needs_motion: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'edges')
    family: ClassVar[str] = 'delay in time'
    compared: ClassVar[str] = 'latency'
    picture: ClassVar[Picture] = Picture('moving')
    batched: ClassVar[tuple[str, ...] | None] = ('history',)

    latency: float = parameter(0.020, -0.5, 1.0, 's', 'age of the scene at the stamp')
    delay: float = parameter(0.0, 0.0, 1.0, 's', 'time from the stamp to the arrival of the image')

    @property
    def latency_ns(self) -> int:
        """Return by how much the scene is older than the stamp, nanoseconds."""
        return round(self.strength * self.latency * 1e9)

    @property
    def delay_ns(self) -> int:
        """Return the time from the stamp to the arrival of the image, nanoseconds."""
        return round(self.strength * self.delay * 1e9)

    def apply(self, state: FrameState) -> None:
        """Show the scene of an earlier moment, from the clean frames seen so far."""
        kept: list[tuple[int, np.ndarray, np.ndarray]]
        kept = state.memory.kept.setdefault(self.name, [])
        if kept and kept[-1][1].shape != state.depth.shape:
            kept.clear()
        if kept and kept[-1][0] == state.stamp:
            kept.pop()
        kept.append((state.stamp, state.depth.copy(), state.reflectivity.copy()))
        moment = state.stamp - self.latency_ns
        while len(kept) > FRAMES_KEPT or (len(kept) > 2 and kept[1][0] <= moment):
            del kept[0]
        stamps = np.array([stamp for stamp, *_ in kept])
        early, late = frames_around(stamps, 0, len(kept), 0, len(kept), np.int64(moment))
        (start, depth, _), (end, other, _) = kept[early], kept[late]
        share = share_of(np.int64(moment - start), np.int64(end - start or 1))
        state.depth = between(depth, other, float(share), (end - start) * 1e-9)
        state.reflectivity = kept[late if is_late_nearer(share) else early][2]


def arriving_late(delay: Any) -> tuple[list[TimeOffset], list[Distribution]]:
    """
    Return the effect of images that arrive late, and how its delay is drawn.

    ``delay`` is in seconds, or the lowest and the highest. Raises InputError for anything else.
    """
    ends = delay if isinstance(delay, tuple | list) else (delay, delay)
    if len(ends) != 2 or not all(map(is_finite, ends)) or not 0 <= ends[0] <= ends[1] <= 1:
        raise InputError(
            'latency: must be seconds from 0 to 1, or the lowest and the highest, got '
            f'{shown(delay)}'
        )
    low, high = map(float, ends)
    found = [Distribution(TimeOffset.name, 'delay', low, high)] if low < high else []
    return [TimeOffset(latency=0.0, delay=low)], found


_NO_OFFSET = TimeOffset(latency=0.0)


def time_offset_of(effects: Iterable[EffectProtocol]) -> TimeOffset:
    """Return the `TimeOffset` among effects, or one that does nothing."""
    found = (effect for effect in effects if isinstance(effect, TimeOffset))
    return next(found, _NO_OFFSET)


def changing(effects: Iterable[EffectProtocol]) -> tuple[Any, ...]:
    """Return the effects but for a `TimeOffset` that leaves every image as it is."""
    return tuple(one for one in effects if not isinstance(one, TimeOffset) or one.latency_ns)
