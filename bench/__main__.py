"""Print all measurements, or the named ones: ``python -m bench [NAME ...]``."""

import sys

from bench import (
    arrival,
    batch,
    characterize,
    closed_loop,
    effects,
    gap,
    go1,
    model,
    nodes,
    rendering,
    view,
)

_ALL = {
    'model': model.run,
    'effects': effects.run,
    'batch': batch.run,
    'closed_loop': closed_loop.run,
    'characterize': characterize.run,
    'gap': gap.run,
    'rendering': rendering.run,
    'nodes': nodes.run,
    'input': arrival.run,
    'go1': go1.run,
    'view': view.run,
}


def main() -> int:
    """Run what was asked for."""
    names = sys.argv[1:] or list(_ALL)
    unknown = [name for name in names if name not in _ALL]
    if unknown:
        print(f'unknown: {", ".join(unknown)}; wanted any of {", ".join(_ALL)}', file=sys.stderr)
        return 2
    for name in names:
        print(f'\n== {name}', flush=True)
        _ALL[name]()
    return 0


if __name__ == '__main__':
    sys.exit(main())
