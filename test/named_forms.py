"""Forms of given effects, fitted to recordings as a diagnosis fits them."""

from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.data.registration import register
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named
from flexx2_sim_ros.gap.forms.looked import Simulator
from flexx2_sim_ros.gap.work import find
from flexx2_sim_ros.jobs import workers
import numpy as np

PRIOR = (0.01,) * 3 + (0.5,) * 3


def fitted_forms(recordings, named, quick=False):
    """Return the forms that a diagnosis with these effects would fit."""
    effects = parse_effects(named)
    with workers(1, None) as mapped:
        found, _ = find(recordings, None, mapped)
        motions = [register(read(one, None), np.array(PRIOR))[0] for one in found]
        return calibrate_named(
            found,
            motions,
            effects,
            [effects] * len(found),
            Simulator(mapped, None, {}, 0, PRIOR),
            lambda: None,
            quick,
        )
