"""The explanations that a diagnosis leaves open."""

from collections.abc import Mapping
from typing import Any

from flexx2_sim_ros.effects import of_role, registry
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.report.reading import Diagnosed

NONE = 'no effect'
Effects = dict[str, dict[str, Any]]


def explanations(before: Diagnosed) -> dict[str, Effects]:
    """
    Return the sets of effects that are still possible, by readable names.

    These are the chosen effects, each alternative (which replaces some of them), each effect that
    the ground truth could not decide (at typical strength), and no effect. Pose errors count as no
    effect.

    Raises
    ------
    InputError
        When the diagnosis leaves nothing open, or lacks a key.

    """
    try:
        sets = _sets(before.table)
    except (KeyError, TypeError) as error:
        raise InputError(
            f'DIAGNOSIS: diagnosis.json: must be as flexx2 gap diagnose writes it, got no '
            f'{shown(error.args[0])}'
        ) from error
    pose, out = of_role('pose').name, dict[str, Effects]()
    for one in sets:
        effects = {name: dict(values) for name, values in one.items() if name != pose}
        # The pose of each recording is fitted in any case, so a pose error looks like no effect.
        if effects not in out.values():
            out[' + '.join(one).replace('_', ' ') or NONE] = effects
    settled = not (before.table['alternatives'] or before.table['not_decidable'])
    if before.verdict == 'identified' and settled:
        raise InputError('DIAGNOSIS: must leave something open, got one explanation: check it')
    if len(out) < 2:
        raise InputError(
            'DIAGNOSIS: must have alternatives or effects that are not decidable, got verdict '
            f'{shown(before.verdict)} without any'
        )
    return out


def _sets(table: Mapping[str, Any]) -> list[Effects]:
    chosen = {row['name']: row['parameters'] for row in table['effects']}
    sets = [chosen]
    for row in table['alternatives']:
        kept = {k: v for k, v in chosen.items() if k not in row['instead_of']}
        sets.append({**kept, row['name']: row['parameters']})
    sets += [
        {**chosen, row['name']: registry()[row['name']]().settings}
        for row in table['not_decidable']
    ]
    return [*sets, {}]
