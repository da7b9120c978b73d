"""The fraction of each effect that a kind of ground truth hides, from `bench.absorbed`."""

from collections.abc import Mapping
from typing import Any

from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.paths import config_dir

# From this fraction on, less than a tenth of an effect of typical strength remains visible.
_HIDDEN = 0.9
_CAPTURE = 'motion capture'
_CLOCK = 'motion capture of a known clock (--clock-offset)'
# Effects that a kind of ground truth always hides, with the reason.
_POSE = 'pose_error', 'the poses are fitted to these recordings'
_TIME = 'time_offset', 'each frame is placed where it was taken, whatever its stamp says'
_IN_CAMERA = 'pose_error', "the planes are in the camera's frame, so that they move with it"
_TAPE = 'a tape measure'
_BENDS = 'multipath'
_MOVING = 'time_offset', 'motion_artefact'


def absorbed(kind: str) -> dict[str, float]:
    """
    Return the fraction of each effect that is hidden in ``clean_depth``, by name.

    `kind` is ``scan``; ``single`` (a scan, recordings registered one by one); ``tape`` or
    ``planes`` (planes with and without measured distances). Effects that hardly change mean depth
    are left out; of another kind, nothing was measured.
    """
    table = read_section(config_dir() / 'absorbed.yaml', 'absorbed', dict)
    return {name: part for name, part in table.get(kind, {}).items() if name in registry()}


def mostly_hidden(kind: str) -> set[str]:
    """Return the effects that a kind of ground truth takes nearly all of; none if not measured."""
    return {name for name, part in absorbed(kind).items() if part >= _HIDDEN}


def never_decided(moving: bool, late: bool = False) -> list[dict[str, Any]]:
    """Return rows of ``cannot_decide`` for poses from the recordings; late: of a known clock."""
    rows = [_POSE, _TIME] if moving and not late else [_POSE]
    return [_row(effect, reason, 1.0) for effect, reason in rows]


def hidden_by_scan(
    moving: bool, late: bool, confounded: Mapping[str, str]
) -> list[dict[str, Any]]:
    """
    Return `never_decided`, and the effects that fitted poses absorb.

    What recordings do not tell from their poses (the effect, and why) is confounded: the poses
    then take what they take in a single recording.
    """
    rows = never_decided(moving, late)
    single = absorbed('single')
    known = [*(row['effect'] for row in rows), *[_TIME[0]] * late, *single]
    for effect, part in absorbed('scan').items():
        if part >= _HIDDEN and effect not in known and (moving or effect not in _MOVING):
            reason = f'the poses take {part:.0%} of it for theirs'
            rows.append(_row(effect, reason, min(part, 0.99)))
    rows += [_row(effect, why, min(single[effect], 0.99)) for effect, why in confounded.items()]
    return rows


def hidden_by_planes(taped: bool, square: bool) -> list[dict[str, Any]]:
    """Return rows of ``cannot_decide`` for planes with or without measured distance and angle."""
    rows = [_row(*_IN_CAMERA, 1.0)]
    if taped:
        return rows
    for effect, part in absorbed('planes').items():
        # What bends corners is seen where their angle is known.
        if part >= _HIDDEN and effect != _IN_CAMERA[0] and not (square and effect == _BENDS):
            reason = f'no distance was measured, and planes that move take {part:.0%} of it'
            rows.append(_row(effect, reason, round(part, 2), _TAPE))
    return rows


def _row(effect: str, reason: str, part: float, remedy: str = '') -> dict[str, Any]:
    remedy = remedy or (_CLOCK if effect == _TIME[0] else _CAPTURE)
    return {
        'effect': effect,
        'reason': f'{reason}; {remedy} would decide it',
        'absorbed': part,
        'settled_by': remedy,
    }
