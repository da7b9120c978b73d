"""
Campaigns in which the named effects, simulated, are expected to make the gap larger.

Reads the campaigns that the rule of the verdict was fitted to (``bench/decisions.jsonl.xz``) and
prints those with a reduction below 0, with what was realised in other scenes where that is known.
``THRESHOLDS.larger`` lies between those with a true effect and the others.

python -m bench.gap_larger
"""

from bench.decision_lines import KEPT
from bench.journal import entries


def main() -> None:
    """Print the campaigns, the smallest reduction first."""
    rows = [line for line in entries(KEPT) if _is_larger(line['diagnosis'])]
    print(
        '| campaign | group | effects | named | predicted | realised |\n|---|---|---|---|---|---|'
    )
    for line in sorted(rows, key=lambda one: float(one['diagnosis']['gap']['shrink'])):
        planned, table = line['planned'], line['diagnosis']
        true = ', '.join(f'{name} {value}' for name, value in planned['effects'].items())
        named = ', '.join(row['name'] for row in table['effects'])
        realised = (line['realised'] or {}).get('shrink')
        print(
            f'| {line["index"]} | {planned["group"]} | {true} | {named} | '
            f'{table["gap"]["shrink"]:.2f} | {"" if realised is None else f"{realised:.2f}"} |'
        )


def _is_larger(table: dict) -> bool:
    shrink = table['gap']['shrink']
    measured = table['gap']['measured_by'] == 'distance'
    return bool(table['effects']) and measured and shrink is not None and shrink < 0


if __name__ == '__main__':
    main()
