"""A set of effects, really simulated: what is left of the gap then."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from flexx2_sim_ros.gap.calibration.features import SIMULATION
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.changes import count_changes
from flexx2_sim_ros.gap.features.features import features, lattice_spectrum, static_grain
from flexx2_sim_ros.gap.features.physical import distance, distances, histogram, Measures, UNITS
from flexx2_sim_ros.gap.features.pixel_groups import GroupSums, PixelGroups
from flexx2_sim_ros.gap.features.row_sums import EXPECT
from flexx2_sim_ros.gap.features.simulation import counts_edges, PlacedScene, with_uptime
from flexx2_sim_ros.gap.features.single_frame import single_frame, SingleFrame
from flexx2_sim_ros.gap.features.sums import Sums
import numpy as np


@dataclass(frozen=True)
class Outcome:
    """
    A recording against the simulation without and with a set of effects.

    Attributes
    ----------
    name : str
    physical : dict
        For each of `physical.UNITS`: before, after, and the difference of two simulations with
        the effects.
    gap : float
        `physical.distance` of the recording and the simulation without effects, less that of two
        simulations; in all of the image, jumps included.
    seen : numpy.ndarray
        (3, SIZE) float32 features of the recording, and simulated without and with the effects.
    noise : numpy.ndarray
        (SIZE,) float32 difference that noise alone makes between a recording and the mean of the
        simulations with the effects, estimated from the difference of two of these.
    counts : numpy.ndarray
        (BINS,) float32 pixels looked at.
    maps : dict of str to numpy.ndarray
        (h, w) images for the report: mean error in sigma of real, before and after.
    groups : PixelGroups
        What differs in small groups of pixels.
    changes : numpy.ndarray
        (2, BINS, CLASSES) what the effects change at single pixels, see `count_changes`.
    grain : numpy.ndarray
        (h, w) float16 static pattern simulated with the effects, in sigma.
    frame : SingleFrame or None
        A frame to show, if one was asked for.

    """

    name: str
    physical: dict[str, list[float]]
    gap: float
    seen: np.ndarray
    noise: np.ndarray
    counts: np.ndarray
    maps: dict[str, np.ndarray]
    groups: PixelGroups
    changes: np.ndarray
    grain: np.ndarray
    frame: SingleFrame | None


class _Look(NamedTuple):
    # A recording or a simulation of it.
    sums: Sums
    measures: Measures
    everywhere: Measures
    groups: np.ndarray
    depth: np.ndarray


def confirm(
    recording: RecordingData, motion: np.ndarray, effects: dict[str, Any], seed: int, show: bool
) -> Outcome:
    """
    Simulate a recording's scene with and without effects.

    Parameters
    ----------
    recording : RecordingData
        The recording.
    motion : numpy.ndarray
        (6 + 3 P,) where its camera and its planes really were, as for `registration.place`.
    effects : dict
        Parameters by effect.
    seed : int
        Of the simulations.
    show : bool
        Whether the outcome has a frame to show.

    """
    scene = PlacedScene.at(recording, motion)
    placed, scenes = scene.placed, scene.covariates
    grouped = GroupSums(recording, placed.clean, placed.reflectivity, scenes)

    middle = len(recording.depth) // 2
    at_edges = counts_edges(effects)

    def look(depth: np.ndarray) -> _Look:
        sums = scene.sums(depth)
        measures = histogram(depth, scenes, sums, at_edges=at_edges)
        everywhere = measures if at_edges else histogram(depth, scenes, sums)
        return _Look(sums, measures, everywhere, grouped.add(depth), depth)

    def several(table: dict[str, Any]) -> list[_Look]:
        own = with_uptime(table, recording.uptime)
        seeds = range(SIMULATION.confirm_seeds)
        return [look(scene.simulate(own, seed * 1000 + 500 + k)) for k in seeds]

    real = look(recording.depth)
    before = several({})
    after = several(effects) if effects else before
    spectrum = np.mean([lattice_spectrum(one.sums) for one in before], axis=0)
    own, _ = features(real.sums, spectrum)
    found = [[features(one.sums, spectrum)[0] for one in some] for some in (before, after)]
    # A recording and the mean of n simulations differ by less than two simulations.
    noise = (found[1][1] - found[1][0]) * np.sqrt((1 + 1 / len(after)) / 2)
    return Outcome(
        recording.name,
        _physical(real, before, after),
        _gap(real, before, after),
        np.array([own, *(np.mean(some, axis=0) for some in found)], np.float32),
        noise.astype(np.float32),
        real.sums.bins[:, EXPECT].astype(np.float32),
        {
            name: _map(one.sums)
            for name, one in (('real', real), ('before', before[0]), ('after', after[0]))
        },
        grouped.groups(
            real.groups,
            [one.groups for one in before],
            [one.groups for one in after],
            len(recording.depth),
        ),
        count_changes(before[0].depth, after[0].depth, scenes),
        static_grain(after[0].sums).astype(np.float16),
        single_frame(middle, [one.depth[middle] for one in (real, before[0], after[0])], scenes)
        if show
        else None,
    )


def _physical(
    real: _Look, before: Sequence[_Look], after: Sequence[_Look]
) -> dict[str, list[float]]:
    gaps = [[distances(real.measures, one.measures) for one in some] for some in (before, after)]
    # Simulated with the effects: effects that add noise put two simulations farther apart, too.
    gaps.append([distances(after[1].measures, after[0].measures)])
    return {unit: [float(np.mean([one[unit] for one in some])) for some in gaps] for unit in UNITS}


def _gap(real: _Look, before: Sequence[_Look], after: Sequence[_Look]) -> float:
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
