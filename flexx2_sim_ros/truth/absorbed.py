"""What each kind of ground truth hides of each effect, as `bench.absorbed` measured it."""

from functools import lru_cache
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.paths import config_dir

# From this fraction on, what is left of an effect of usual strength is less than a tenth of it.
_HIDDEN = 0.9
_CAPTURE = 'motion capture'
# What follows from how ground truth is made, with the reason.
_POSE = 'pose_error', 'the poses are fitted to these recordings'
_TIME = 'time_offset', 'each frame is placed where it was taken, whatever its stamp says'
_MOVING = 'time_offset', 'motion_artefact'


@lru_cache(maxsize=1)
def _table() -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = read_config(config_dir() / 'absorbed.yaml')['absorbed']
    return found


def absorbed(kind: str) -> dict[str, float]:
    """
    Return the fraction of each effect that is hidden in ``clean_depth``, by name.

    Parameters
    ----------
    kind : str
        ``scan``; ``tape`` or ``planes`` (planes with and without measured distances).

    Returns
    -------
    dict
        Without effects that change mean depth by next to nothing.

    """
    return {name: part for name, part in _table()[kind].items() if name in registry()}


def never_decided(moving: bool) -> list[dict[str, Any]]:
    """
    Return what no ground truth decides that takes its poses from the recordings themselves.

    Parameters
    ----------
    moving : bool
        Whether a recording of the campaign moves.

    Returns
    -------
    list of dict
        Rows of ``cannot_decide`` in ``truth.yaml``.

    """
    rows = [_POSE, _TIME] if moving else [_POSE]
    return [_row(effect, reason, 1.0) for effect, reason in rows]


def hidden_by_scan(moving: bool) -> list[dict[str, Any]]:
    """Return `never_decided`, and the effects that poses fitted to recordings take for theirs."""
    rows = never_decided(moving)
    known = [row['effect'] for row in rows]
    for effect, part in absorbed('scan').items():
        if part >= _HIDDEN and effect not in known and (moving or effect not in _MOVING):
            reason = f'the poses take {part:.0%} of it for theirs'
            rows.append(_row(effect, reason, min(part, 0.99)))
    return rows


def _row(effect: str, reason: str, part: float) -> dict[str, Any]:
    return {
        'effect': effect,
        'reason': f'{reason}; {_CAPTURE} would decide it',
        'absorbed': part,
        'settled_by': _CAPTURE,
    }
