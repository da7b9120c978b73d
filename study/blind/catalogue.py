"""All effects by name."""

from collections.abc import Mapping

from flexx2_sim_ros.errors import InputError, shown
import numpy as np
from study.blind import electronics, geometry, lens, novel, processing
from study.blind.frame import Effect
from study.blind.views import Optics


def _by_name(*modules: object) -> Mapping[str, type[Effect]]:
    found = [
        value
        for module in modules
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Effect) and value.name
    ]
    return {effect.name: effect for effect in found}


CATALOGUE = _by_name(geometry, lens, electronics, processing)
NOVEL = _by_name(novel)


def make_effect(name: str, strength: float, rng: np.random.Generator, optics: Optics) -> Effect:
    """
    Create an effect of the catalogue or a novel one.

    * `name`: a key of `CATALOGUE` or `NOVEL`
    * `strength`: 1 is typical
    * `rng`: draws what differs between cameras

    Raises InputError for an unknown name.
    """
    known = {**CATALOGUE, **NOVEL}
    if name not in known:
        raise InputError(f'effect: must be one of {", ".join(known)}, got {shown(name)}')
    return known[name](strength, rng, optics)
