"""A set of effects, really simulated: what is left of the gap then."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from flexx2_sim_ros.gap.calibration.features import SIMULATION
from flexx2_sim_ros.gap.features.features import features, lattice_spectrum, static_grain
from flexx2_sim_ros.gap.features.physical import (
    distance,
    distances,
    histogram,
    in_tolerances,
    Measures,
    NOISE,
    UNITS,
)
from flexx2_sim_ros.gap.features.pixel_groups import GroupSums, PixelGroups
from flexx2_sim_ros.gap.features.row_sums import EXPECT
from flexx2_sim_ros.gap.features.simulation import counts_edges, PlacedScene, with_uptime
from flexx2_sim_ros.gap.features.single_frame import single_frame, SingleFrame
from flexx2_sim_ros.gap.features.sums import Sums
import numpy as np


class Apart(NamedTuple):
    """
    How far a recording is from its simulations.

    `physical` has for each of `physical.UNITS`: before, after, and the difference of two
    simulations with the effects. `gap` is `physical.distance` of the recording and the simulation
    without effects, less that of two simulations; in all of the image, jumps included.
    """

    physical: dict[str, list[float]]
    gap: float

    def far(self, which: int) -> np.ndarray:
        """Return (4,) as from `how_far`: before (0), after (1), or of two simulations (2)."""
        return how_far({unit: several[which] for unit, several in self.physical.items()})


@dataclass(frozen=True)
class Outcome:
    """
    A recording against the simulation without and with a set of effects.

    * `apart`: at the fitted pose.
    * `elsewhere`: as it is expected in other scenes: with effects that are as wrong as their fit
      leaves open, at the pose that `OwnErrors.elsewhere` gives.
    * `seen`: (3, SIZE) float32 features of the recording, and simulated without and with the
      effects.
    * `noise`: (SIZE,) float32 difference that noise alone makes between a recording and the mean
      of the simulations with the effects, estimated from the difference of two of these.
    * `counts`: (BINS,) float32 pixels looked at.
    * `maps`: (h, w) images for the report: mean error in sigma of real, before and after.
    * `groups`: what differs in small groups of pixels.
    * `grain`: (h, w) float16 static pattern simulated with the effects, in sigma.
    * `frame`: a frame to show, if one was asked for.
    """

    name: str
    apart: Apart
    elsewhere: Apart
    seen: np.ndarray
    noise: np.ndarray
    counts: np.ndarray
    maps: dict[str, np.ndarray]
    groups: PixelGroups
    grain: np.ndarray
    frame: SingleFrame | None


class Seen(NamedTuple):
    """A recording or a simulation of it; ``measures`` at jumps only if effects change these."""

    sums: Sums
    measures: Measures
    everywhere: Measures


class _Look(NamedTuple):
    seen: Seen
    groups: np.ndarray
    depth: np.ndarray


def confirm(
    scene: PlacedScene,
    effects: dict[str, Any],
    wrong: dict[str, Any],
    seed: int,
    show: bool = False,
    bare: np.ndarray | None = None,
) -> Outcome:
    """
    Simulate a recording's scene with and without effects.

    * `scene`: from where its camera and its planes really were.
    * `effects`, `wrong`: parameters by effect; the same, as wrong as their fit leaves open.
    * `show`: whether the outcome has a frame to show.
    * `bare`: (6 + 3 P,) where the camera and the planes are without effects, if that is elsewhere:
      an effect moves planes that were not measured, and that is no gap to be closed.
    """
    recording, placed, scenes = scene.recording, scene.placed, scene.covariates
    grouped = GroupSums(recording, placed.clean, placed.reflectivity, scenes)
    middle = len(recording.depth) // 2

    def look(depth: np.ndarray) -> _Look:
        return _Look(seen_in(scene, depth, effects), grouped.add(depth), depth)

    real = look(recording.depth)
    before = [look(depth) for depth in simulated(scene.without(bare), {}, seed)]
    after = [look(depth) for depth in simulated(scene, effects, seed)] if effects else before
    spectrum = np.mean([lattice_spectrum(one.seen.sums) for one in before], axis=0)
    own, _ = features(real.seen.sums, spectrum)
    found = [[features(one.seen.sums, spectrum)[0] for one in some] for some in (before, after)]
    # A recording and the mean of n simulations differ by less than two simulations.
    noise = (found[1][1] - found[1][0]) * np.sqrt((1 + 1 / len(after)) / 2)
    far = near = apart_in(real.seen, [one.seen for one in before], [one.seen for one in after])
    if wrong != effects:
        others = [seen_in(scene, depth, effects) for depth in simulated(scene, wrong, seed)]
        far = apart_in(real.seen, [one.seen for one in before], others)
    return Outcome(
        recording.name,
        near,
        far,
        np.array([own, *(np.mean(some, axis=0) for some in found)], np.float32),
        noise.astype(np.float32),
        real.seen.sums.bins[:, EXPECT].astype(np.float32),
        {
            name: _map(one.seen.sums)
            for name, one in (('real', real), ('before', before[0]), ('after', after[0]))
        },
        grouped.groups(
            real.groups,
            [one.groups for one in before],
            [one.groups for one in after],
            len(recording.depth),
        ),
        static_grain(after[0].seen.sums).astype(np.float16),
        single_frame(middle, [one.depth[middle] for one in (real, before[0], after[0])], scenes)
        if show
        else None,
    )


def apart(
    scene: PlacedScene, effects: dict[str, Any], seed: int, bare: np.ndarray | None = None
) -> Apart:
    """Return how far a recording is from its simulations; parameters and seeds as of `confirm`."""

    def look(where: PlacedScene, table: dict[str, Any]) -> list[Seen]:
        return [seen_in(scene, depth, effects) for depth in simulated(where, table, seed)]

    before = look(scene.without(bare), {})
    after = look(scene, effects) if effects else before
    return apart_in(seen_in(scene, scene.recording.depth, effects), before, after)


def measured_parts(
    scene: PlacedScene, effects: dict[str, Any], seed: int, known: Apart
) -> dict[str, np.ndarray]:
    """
    Return what each effect takes off the distance of a recording and its simulation; see `parts`.

    The random numbers are those of `confirm`; `known` is what it found in this scene.
    """
    real = seen_in(scene, scene.recording.depth, effects)

    def far(some: dict[str, Any]) -> np.ndarray:
        if len(some) in (0, len(effects)):
            return known.far(int(bool(some)))
        seen = [seen_in(scene, depth, effects) for depth in simulated(scene, some, seed)]
        return apart_in(real, seen, seen).far(0)

    return parts(effects, far)


def parts(
    effects: dict[str, Any], far: Callable[[dict[str, Any]], np.ndarray]
) -> dict[str, np.ndarray]:
    """
    Return what each effect takes off a distance; these parts add up to what all take off.

    The effects are switched on one after the other, in their order and in the reverse. The part of
    each is the mean of what the distance falls by then: Shapley's value from two of all orders.
    `far` returns the distance with some of them.
    """
    names, out = list(effects), dict[str, np.ndarray]()
    known = cache(lambda on: far({name: effects[name] for name in names if name in on}))
    for order in (names, names[::-1]):
        some = [frozenset(order[:count]) for count in range(len(names) + 1)]
        for name, less, more in zip(order, some, some[1:], strict=False):
            out[name] = out.get(name, 0.0) + (known(less) - known(more)) / 2
    return out


def how_far(gaps: Mapping[str, float]) -> np.ndarray:
    """
    Return how far a recording is from a simulation, (4,), from their `physical.distances`.

    The values are `physical.distance`; of it, depth in millimetres and lost pixels in percent; and
    the difference of the noise and its correlations, in tolerances.
    """
    noise = in_tolerances(gaps, NOISE)
    return np.array([distance(gaps), gaps['wasserstein_mm'], 100 * gaps['invalid_rate'], noise])


def far_in_all(scene: PlacedScene, effects: dict[str, Any], seed: int) -> float:
    """Return `physical.distance` and noise of a recording and its simulation, in tolerances."""
    depth = next(simulated(scene, effects, seed))
    real, other = (
        histogram(one, scene.covariates, scene.sums(one)) for one in (scene.recording.depth, depth)
    )
    gaps = distances(real, other)
    return distance(gaps) + in_tolerances(gaps, NOISE)


def simulated(scene: PlacedScene, table: dict[str, Any], seed: int) -> Iterator[np.ndarray]:
    """Yield the depth that the simulator sees with effects, with a few seeds."""
    own = with_uptime(table, scene.recording.uptime)
    for k in range(SIMULATION.confirm_seeds):
        yield scene.simulate(own, seed * 1000 + 500 + k)


def seen_in(scene: PlacedScene, depth: np.ndarray, effects: dict[str, Any]) -> Seen:
    """Return the measures of depth that may have these effects."""
    at_edges = counts_edges(effects)
    sums = scene.sums(depth)
    measures = histogram(depth, scene.covariates, sums, at_edges=at_edges)
    everywhere = measures if at_edges else histogram(depth, scene.covariates, sums)
    return Seen(sums, measures, everywhere)


def apart_in(real: Seen, before: Sequence[Seen], after: Sequence[Seen]) -> Apart:
    """Return how far a recording is from simulations without and with effects."""
    return Apart(_physical(real, before, after), _gap(real, before, after))


def _physical(real: Seen, before: Sequence[Seen], after: Sequence[Seen]) -> dict[str, list[float]]:
    gaps = [[distances(real.measures, one.measures) for one in some] for some in (before, after)]
    # Simulated with the effects: effects that add noise put two simulations farther apart, too.
    gaps.append([distances(after[1].measures, after[0].measures)])
    return {unit: [float(np.mean([one[unit] for one in some])) for some in gaps] for unit in UNITS}


def _gap(real: Seen, before: Sequence[Seen], after: Sequence[Seen]) -> float:
    gap = np.mean([distance(distances(real.everywhere, one.everywhere)) for one in before])
    return float(gap) - distance(distances(after[1].everywhere, after[0].everywhere))


def _map(sums: Sums) -> np.ndarray:
    # Mean error in sigma, at most 56 pixels wide.
    with np.errstate(invalid='ignore', divide='ignore'):
        step = max(sums.mean.shape[2] // 56, 1)
        height, width = (n // step * step for n in sums.mean.shape[1:])
        parts = [
            a[:height, :width].reshape(height // step, step, width // step, step).sum((1, 3))
            for a in (sums.mean[0], sums.sigma)
        ]
        return (parts[0] / parts[1]).astype(np.float16)
