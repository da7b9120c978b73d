"""Which effects have a form that can be fitted, and in which order."""

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.patch import COVARIATES
from flexx2_sim_ros.gap.forms import dropout, noise
from flexx2_sim_ros.gap.forms.bias import BIASES
from flexx2_sim_ros.gap.forms.geometry import is_fitted_with_poses
from flexx2_sim_ros.gap.forms.search import evaluations
from flexx2_sim_ros.gap.forms.work import Settings
from flexx2_sim_ros.physics.frame_state import Stage

PATTERN = 'fixed_pattern'


def calibratable(effects: Settings) -> list[str]:
    """Return which effects have a form, in the order in which they are fitted."""
    shaped = [name for name, kind in registry().items() if kind.shapes and name in effects]
    before = [name for name in shaped if registry()[name].stage <= Stage.PHASOR]
    after = [name for name in shaped if name not in before]
    places = *BIASES, PATTERN, noise.NAME, *dropout.KINDS
    others = [name for name in places if name in effects]
    return [*before, *others, *after]


def quickly_calibratable(effects: Settings) -> list[str]:
    """Return which effects have a form that is fitted without a search by simulation."""
    return [
        name
        for name in calibratable(effects)
        if is_fitted_with_poses(name) or not registry()[name].shapes
    ]


def rounds(effects: Settings) -> int:
    """Return about how often each recording is judged."""
    names = calibratable(effects)
    searched = [one for one in names if one not in quickly_calibratable(effects)]
    tried = sum(evaluations(registry()[name].shapes) for name in searched)
    return 1 + len(COVARIATES) + len(names) + tried
