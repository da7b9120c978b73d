"""
What a real camera does and the noise model leaves out, as effects to switch on.

One file an effect: a dataclass that says all that there is to say about it. The registry finds
those in this package, and those of other packages through the entry point group
``flexx2_sim_ros.effects``; see ``CONTRIBUTING.md``.
"""

from flexx2_sim_ros.effects.effect import Effect, Parameter
from flexx2_sim_ros.effects.randomisation import Distribution, Randomisation
from flexx2_sim_ros.effects.registry import (
    aged,
    ageing,
    load_effects,
    load_randomisation,
    loadable,
    of_role,
    parse_effects,
    registry,
    save_effects,
    save_randomisation,
)

__all__ = [
    'Distribution',
    'Effect',
    'Parameter',
    'Randomisation',
    'aged',
    'ageing',
    'load_effects',
    'load_randomisation',
    'loadable',
    'of_role',
    'parse_effects',
    'registry',
    'save_effects',
    'save_randomisation',
]
