"""
What a real camera does and the noise model leaves out, as effects to switch on.

One module a family. An effect is a dataclass with one function; defining it in a module of this
package is all it takes: the registry finds it, and files, node parameters, documentation and
tests follow from it.
"""

from flexx2_sim_ros.effects.effect import Effect, Parameter
from flexx2_sim_ros.effects.registry import load_effects, parse_effects, registry, save_effects

__all__ = ['Effect', 'Parameter', 'load_effects', 'parse_effects', 'registry', 'save_effects']
