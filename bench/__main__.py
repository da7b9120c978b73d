"""
Print all measurements, or the named ones: ``python -m bench [NAME ...]``.

The measurements of `_LONG` run only when they are named; ``torture`` means all of them.
"""

import sys

from bench import (
    agreement,
    arrival,
    bags,
    batch,
    characterize,
    closed_loop,
    effects,
    exposure,
    gap,
    go1,
    model,
    nodes,
    rendering,
    soak,
    start,
    torture_files,
    torture_kill,
    torture_node,
    view,
)

_ALL = {
    'model': model.run,
    'effects': effects.run,
    'exposure': exposure.run,
    'batch': batch.run,
    'agreement': agreement.run,
    'closed_loop': closed_loop.run,
    'characterize': characterize.run,
    'gap': gap.run,
    'rendering': rendering.run,
    'nodes': nodes.run,
    'start': start.run,
    'input': arrival.run,
    'go1': go1.run,
    'view': view.run,
    'bags': bags.run,
}
# These take two hours together.
_LONG = {
    'torture_node': torture_node.run,
    'torture_files': torture_files.run,
    'torture_kill': torture_kill.run,
    'soak': soak.run,
}


def main() -> int:
    """Run the named measurements."""
    names = sys.argv[1:] or list(_ALL)
    if 'torture' in names:
        names = [*(name for name in names if name != 'torture'), *_LONG]
    known = {**_ALL, **_LONG}
    unknown = [name for name in names if name not in known]
    if unknown:
        print(
            f'NAME: must be of {", ".join(known)}, torture, got {", ".join(unknown)}',
            file=sys.stderr,
        )
        return 2
    for name in names:
        print(f'\n== {name}', flush=True)
        known[name]()
    return 0


if __name__ == '__main__':
    sys.exit(main())
