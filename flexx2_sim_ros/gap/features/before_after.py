"""Physical measures of the gap of one recording, without and with effects."""

from typing import Any

from flexx2_sim_ros.gap.calibration.features import SIMULATION
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.physical import distances, histogram, UNITS
from flexx2_sim_ros.gap.features.simulation import counts_edges, PlacedScene, with_uptime
import numpy as np


def before_after(
    recording: RecordingData,
    motions: tuple[np.ndarray, np.ndarray],
    effects: dict[str, dict[str, float]],
    seed: int,
) -> dict[str, list[float]]:
    """
    Compare a recording with the simulation of its scene, without and with effects.

    `motions` are (6 + 3 P,) where its camera and its planes are, fitted without and with the
    effects, as for `registration.place`. Neither simulation is compared at the pose that suits the
    other one. All simulations have common random numbers. Each of `physical.UNITS` gets three
    values: before, after, and the difference of two simulations with the effects.
    """
    seeds = [seed * 1000 + 500 + k for k in range(SIMULATION.confirm_seeds)]
    simulated = []
    gaps = []
    for motion, table in zip(motions, ({}, effects), strict=True):
        scene = PlacedScene.at(recording, motion)

        def look(depth: np.ndarray, scene: PlacedScene = scene) -> Any:
            sums = scene.sums(depth)
            return histogram(depth, scene.covariates, sums, at_edges=counts_edges(effects))

        real = look(recording.depth)
        own = with_uptime(table, recording.uptime)
        simulated = [look(scene.simulate(own, one)) for one in seeds]
        gaps.append([distances(real, one) for one in simulated])
    null = distances(simulated[1], simulated[0])
    return {
        unit: [*(float(np.mean([one[unit] for one in some])) for some in gaps), null[unit]]
        for unit in UNITS
    }
