"""How `flexx2 effects show` draws an effect, as plain data."""

from dataclasses import dataclass

from flexx2_sim_ros.errors import InputError

# What is drawn on the right: against the effect's covariate, along an image row, in two scenes, a
# histogram of the noise, depth across an edge, where edges are, minutes after power-on, while the
# camera moves, correlations between frames and between pixels, wrapped distances, steps.
PROFILES = (
    'covariate',
    'along_row',
    'two_scenes',
    'histogram',
    'across_edge',
    'edge_positions',
    'warming_up',
    'moving',
    'frames_alike',
    'neighbours_alike',
    'wrapped',
    'steps',
)
# ... and in the middle: the mean change, one frame's (the first, or where the camera is fastest),
# the ratio of standard deviations, pixels that are lost, depth where there should be none.
DIFFERENCES = ('mean', 'first', 'frame', 'spread', 'lost', 'beyond')
_BY_COVARIATE = {'image': 'along_row', 'edge': 'across_edge', 'time': 'moving'}
_BY_CHANNEL = {'validity': 'lost', 'noise': 'spread', 'bias': 'mean'}


@dataclass(frozen=True)
class Picture:
    """
    How an effect is drawn.

    Attributes
    ----------
    profile, difference : str
        Out of `PROFILES` and `DIFFERENCES`; empty: what suits the effect's covariate and the
        first channel that it changes.
    usecase : str
        Mode of the camera.
    seconds : float or None
        Time of the last frame; None: at the camera's rate.
    at_chart : bool
        Whether only the gray chart is looked at, which is all at one distance.

    """

    profile: str = ''
    difference: str = ''
    usecase: str = 'Mode_9_30fps'
    seconds: float | None = None
    at_chart: bool = False

    def __post_init__(self) -> None:
        """Reject kinds of pictures that do not exist."""
        for name, known in (('profile', PROFILES), ('difference', DIFFERENCES)):
            value = getattr(self, name)
            if value and value not in known:
                raise InputError(
                    f'picture.{name}: must be one of {", ".join(known)}, got {value!r:.80}'
                )

    def profile_for(self, covariate: str) -> str:
        """Return the profile of an effect with this covariate."""
        return self.profile or _BY_COVARIATE.get(covariate, 'covariate')

    def difference_for(self, changes: tuple[str, ...]) -> str:
        """Return the difference of an effect that changes these channels."""
        return self.difference or _BY_CHANNEL.get(changes[0] if changes else '', 'frame')
