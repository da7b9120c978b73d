"""Which effects have a form that can be fitted, and in which order."""

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.shapes import Shape
from flexx2_sim_ros.gap.forms import dropout, noise
from flexx2_sim_ros.gap.forms.bias import BIASES
from flexx2_sim_ros.gap.forms.geometry import is_fitted_with_poses
from flexx2_sim_ros.gap.forms.looked import Settings
from flexx2_sim_ros.gap.forms.shape_search import evaluations
from flexx2_sim_ros.physics.frame_state import Stage

PATTERN = 'fixed_pattern'


def calibratable(effects: Settings, quick: bool) -> list[str]:
    """
    Return which effects have a form, in the order in which they are fitted.

    If ``quick``, the form takes no search by simulation, or a quick one.
    """
    shaped = [
        name
        for name, kind in registry().items()
        if (kind.shapes or kind.scale) and name in effects
    ]
    before = [name for name in shaped if registry()[name].stage <= Stage.PHASOR]
    after = [name for name in shaped if name not in before]
    places = *BIASES, PATTERN, noise.NAME, *dropout.KINDS
    names = [*before, *(name for name in places if name in effects), *after]
    return [one for one in names if not (quick and is_searched(one)) or shapes_of(one, quick)]


def is_searched(effect: str) -> bool:
    """Return whether an effect's form is found by simulation."""
    return bool(registry()[effect].shapes) and not is_fitted_with_poses(effect)


def shapes_of(effect: str, quick: bool) -> tuple[Shape, ...]:
    """Return which shapes of an effect are searched for when a search is quick, or not."""
    shapes = registry()[effect].shapes
    return tuple(one for one in shapes if one.quick) if quick else shapes


def rounds(effects: Settings, quick: bool) -> int:
    """Return about how often each recording is judged to fit the forms of these effects."""
    names = calibratable(effects, quick)
    searched = [one for one in names if is_searched(one)]
    return len(names) + sum(evaluations(shapes_of(one, quick), quick) for one in searched)
