"""
What `flexx2 gap plan` predicts, against whole diagnoses of the same plan.

Each case is an effect of some strength with one kind of ground truth, whose errors are drawn. A
prediction is right if the diagnosis names the effect first exactly when the table predicts it.

python -m bench.gap_plan --seed 101
"""

import argparse
from pathlib import Path
import tempfile

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.planning.plan import default_plan, read_plan
from flexx2_sim_ros.gap.planning.table import read_table, shipped_table
from flexx2_sim_ros.gap.planning.truths import KINDS, write_campaign

CASES = (
    'exact:multipath:0.25,exact:intrinsics_error:0.5,exact:flying_pixels:0.25,'
    'exact:motion_artefact:0.5,scan:offset:1,scan:multipath:0.5,scan:stray_light:0.25,'
    'tape:offset:1,tape:wiggling:1,planes:offset:1,planes:multipath:1,planes:flying_pixels:0.25'
)


def predicted(table: dict[str, object], kind: str, effect: str, strength: float) -> bool:
    """Return whether a table says that an effect is found."""
    effects = table['effects']
    assert isinstance(effects, dict)
    smallest = effects[effect][kind]['smallest']
    return smallest is not None and strength >= smallest


def main() -> None:
    """Print a line for each case, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', default=CASES, help='kind:effect:strength, with commas')
    parser.add_argument('--seed', type=int, default=101)
    parser.add_argument('--table', default=str(shipped_table()))
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    plan, profile = read_plan(default_plan()), flexx2()
    kinds = {kind.name: kind for kind in KINDS}
    table = read_table(Path(arguments.table)) if Path(arguments.table).is_file() else None
    cases = arguments.cases.split(',')
    right = 0
    for case in cases:
        name, effect, strength = case.split(':')
        with tempfile.TemporaryDirectory() as folder:
            write_campaign(
                Path(folder),
                plan,
                profile,
                kinds[name],
                {effect: {'strength': float(strength)}},
                arguments.seed,
                wrong=True,
            )
            result = diagnose(folder, jobs=arguments.jobs)
        found = [row['name'] for row in result['effects']]
        open_ = [row['name'] for row in result['not_decidable']]
        says = None if table is None else predicted(table, name, effect, float(strength))
        right += says == (found[:1] == [effect])
        print(
            f'{case:32s} predicted {says!s:5s} {result["verdict"]:14s} {",".join(found):40s} '
            f'open: {",".join(open_)}',
            flush=True,
        )
    print(f'{right} of {len(cases)} as predicted')


if __name__ == '__main__':
    main()
