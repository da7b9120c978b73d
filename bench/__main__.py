"""
Print all measurements, or the named ones: ``python -m bench [--short] [NAME ...]``.

``--short`` runs them for a moment, to see that they work. The measurements of `_LONG` run only
when they are named; ``torture`` means all of them. These have options of their own:
``python -m bench.versions``, ``.absorbed``, ``.calibrate_decisions``, ``.benchmark_answers``,
``.benchmark_cases`` and ``.copied_noise``.
"""

from importlib import import_module
import sys

# The modules, and what the short form passes to their function `run`.
_ALL = {
    'model': {'rounds': 2},
    'effects': {'rounds': 2},
    'exposure': {},
    'batch': {'rounds': 1},
    'agreement': {'repeats': 1},
    'gap': {'sizes': ((3, 3),)},
    'nodes': {'seconds': 1},
    'bags': {'frames': 4, 'rounds': 1},
    'batch_gpu': {},
}
# These take two hours together.
_LONG = {
    'torture_node': {'messages': 300},
    'torture_files': {'files': 5},
    'torture_kill': {'kills': 1},
    'soak': {'minutes': 0.1},
}


def main():
    """Run the named measurements."""
    words = sys.argv[1:]
    short = '--short' in words
    names = [word for word in words if word != '--short'] or list(_ALL)
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
        import_module(f'bench.{name}').run(**(known[name] if short else {}))
    return 0


if __name__ == '__main__':
    sys.exit(main())
