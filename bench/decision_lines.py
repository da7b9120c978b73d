"""
The campaigns that the rule of the verdict was fitted to, in a small file of the repository.

It has what `decision_fit.campaign` reads of a line, so that the rule can be fitted and checked
again in a minute, without hours of diagnoses.
"""

import json
import lzma
from pathlib import Path

from flexx2_sim_ros.atomic import whole

KEPT = Path(__file__).parent / 'decisions.jsonl.xz'
_DIGITS = 6


def keep(lines, chosen, path=KEPT):
    """
    Write lines of `decision_campaigns.run`.

    * `lines`: of a run
    * `chosen`: the arguments that chose the campaigns
    """
    text = [json.dumps({'chosen': chosen}), *(json.dumps(_brief(line)) for line in lines)]
    data = lzma.compress(''.join(f'{one}\n' for one in text).encode(), preset=9)
    with whole(path) as part:
        part.write_bytes(data)


def kept_arguments(path=KEPT):
    """Return the arguments that chose the campaigns of the file."""
    with lzma.open(path, 'rt') as file:
        return str(json.loads(file.readline())['chosen'])


def _brief(line):
    table, realised = line['diagnosis'], line['realised']
    gap = table['gap']
    by = gap['measured_by']
    return {
        **{key: line[key] for key in ('part', 'number', 'planned', 'more', 'seconds', 'code')},
        'diagnosis': {
            'evidence': table['evidence'],
            'gap': {
                'measured_by': by,
                'shrink': _short(gap['shrink']),
                by: {'shrink_interval': _short(gap[by]['shrink_interval'])},
            },
        },
        'realised': realised and {'shrink': _short(realised['shrink'])},
    }


def _short(value):
    # A number, or several, or nothing.
    if isinstance(value, list):
        return [_short(one) for one in value]
    return round(value, _DIGITS) if isinstance(value, float) else value
