"""What the ground truth of a campaign hides, as its ``truth.yaml`` says."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import is_regular_file, Limits, read_config
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError, shown, shown_path

TRUTH_FILE = 'truth.yaml'
# A row has about 40 values, with three planes 80: this fits thousands of recordings. Text: earlier
# versions stored commands of any length.
_LIMITS = Limits(32 << 20, 400_000, 2_000_000)


@dataclass(frozen=True)
class Undecided:
    """
    An effect that cannot be decided with this ground truth.

    `absorbed` is the fraction of its change that is in `clean_depth`, or that errors of the ground
    truth can explain; `settled_by` what would decide it. `reason` is why ground truth hides it by
    the way it was made; empty otherwise. `confounded`: an error of the ground truth looks like the
    effect, so that it explains what others do, and is not named. Otherwise the ground truth only
    covers an effect of typical strength, and a stronger one can be found.
    """

    effect: str
    absorbed: float
    settled_by: str
    reason: str = ''
    confounded: bool = False


def hidden_effects(folder: str | Path) -> list[Undecided]:
    """
    Return what `flexx2 gap truth` wrote down that the ground truth of a campaign hides.

    Without ``truth.yaml`` in the folder nothing is hidden. Rows without ``absorbed`` are left out:
    the diagnosis decides these from the accuracy of the ground truth. Raises `InputError` when the
    file cannot be read or does not say it as it should.
    """
    path = Path(folder) / TRUTH_FILE
    if not is_regular_file(path):
        return []
    rows = read_config(path, _LIMITS).get('cannot_decide', [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f'{shown_path(path)}: cannot_decide: must be a list of mappings')
    return [_hidden(path, row) for row in rows if 'absorbed' in row]


def _hidden(path: Path, row: dict[str, Any]) -> Undecided:
    name, absorbed = row.get('effect'), row['absorbed']
    if not isinstance(name, str) or name not in registry():
        raise InputError(f'{shown_path(path)}: effect: must be an effect, got {shown(name)}')
    if (
        isinstance(absorbed, bool)
        or not isinstance(absorbed, int | float)
        or not 0 <= absorbed <= 1
    ):
        raise InputError(
            f'{shown_path(path)}: absorbed: must be a fraction, 0 to 1, got {shown(absorbed)}'
        )
    settled_by, reason = (str(row.get(key, '')) for key in ('settled_by', 'reason'))
    confounded = row.get('confounded') is True
    return Undecided(str(name), float(absorbed), settled_by, reason, confounded)
