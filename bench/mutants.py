"""
Change one place of the code at a time and see whether the module's own tests notice.

``python -m bench.mutants [--count 40] [--seed 0] [--seconds 240] [--only FILE:LINE ...]``

Comparisons are flipped, operators swapped, constants made one larger; errors and annotations stay
as they are. The tests run in a copy of this checkout. They are the files that import the module,
or else its nearest users. A failure counts if the same test passes without the change.
"""

import argparse
import ast
from collections import Counter
import os
from pathlib import Path
import random
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'flexx2_sim_ros'
ROOMS = ('camera',), ('physics',), ('nodes',), ('gap/inference', 'gap/features'), ('truth',)
# Test files of a change that run: that of its module, then those that name where it is.
FILES = 5
UNNAMED = 'test', '__init__'  # in the name by which a file is imported
FLIPPED = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def places(node):
    """Return what can be changed in a tree, without annotations and the texts of errors."""
    found = []
    for child in ast.iter_child_nodes(node):
        left_out = isinstance(child, ast.Raise | ast.JoinedStr | ast.arg)
        if not left_out and child is not getattr(node, 'annotation', node):
            found += places(child)
    sign = node.ops[0] if isinstance(node, ast.Compare) else getattr(node, 'op', None)
    number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
    operator = isinstance(node, ast.expr) and type(sign) in FLIPPED
    return [node, *found] if number or operator else found


def change(node):
    """Change a place, and return what changed."""
    before = ast.unparse(node)
    if isinstance(node, ast.Compare):
        node.ops[0] = FLIPPED[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp | ast.BoolOp):
        node.op = FLIPPED[type(node.op)]()
    elif isinstance(node, ast.Constant):
        node.value += 1
    return f'{before} -> {ast.unparse(node)}'


def around(tree, node):
    """Return the names of the function or method that a place is in, and of its class."""
    kinds = ast.ClassDef | ast.FunctionDef
    every = [one for one in ast.walk(tree) if isinstance(one, kinds)]
    return {one.name for one in every if one.lineno <= node.lineno <= one.end_lineno}


def imported(path):
    """Return the modules that a file may import, by dotted name."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            room = getattr(node, 'module', '') or ''
            found |= {room, *(f'{room}.{alias.name}'.strip('.') for alias in node.names)}
    return found


def tests_of(path, names, imports):
    """Return the test files that import a module, or else those of its nearest users."""

    def users(files):
        parts = [one.relative_to(ROOT).with_suffix('').parts for one in files]
        names = {'.'.join(part for part in one if part not in UNNAMED) for one in parts}
        return {one for one, uses in imports.items() if uses & names}

    seen, level, tests = {path}, {path}, list[Path]()
    while level and not tests:
        level |= users(level) & {path.parent / '__init__.py'}  # offers it
        level = users(level) - seen
        level |= users({one for one in level if ROOT / 'test' in one.parents})  # of a helper
        seen |= level
        tests = [one for one in level if one.name.startswith('test_')]
    words = set(path.stem.split('_'))
    tests.sort(key=lambda one: one.stat().st_size)
    tests.sort(key=lambda one: -len(words & {*one.stem.split('_')}))
    tests.sort(key=lambda one: -sum(name in one.read_text() for name in names))
    tests.sort(key=lambda one: one.stem != f'test_{path.stem}')
    return [str(one.relative_to(ROOT)) for one in tests[:FILES]]


def run(copy, tests, seconds):
    """Return what the tests did, and the first that failed."""
    words = [
        sys.executable,
        *['-m', 'pytest', '-xq', '-p', 'no:cacheprovider', '--tb=no', '-rfE'],
        *tests,
    ]
    usual = {'cwd': copy, 'env': {**os.environ, 'PYTHONPATH': str(copy)}, 'text': True}
    try:
        done = subprocess.run(words, capture_output=True, timeout=seconds, **usual)
    except subprocess.TimeoutExpired:
        return 'too slow', ''
    failed = re.search(r'^(?:FAILED|ERROR) (.+?)(?: - |$)', done.stdout, re.M)
    return ('survived', 'noticed')[done.returncode not in (0, 5)], failed[1] if failed else ''


def draw(count, seed):
    """Return files, their texts and the number of a place in each: as many from each room."""
    chosen, draws = [], random.Random(seed)
    for room in ROOMS:
        files = sorted(path for part in room for path in (ROOT / PACKAGE / part).glob('*.py'))
        texts = [(path, path.read_text()) for path in files]
        every = [(*one, i) for one in texts for i in range(len(places(ast.parse(one[1]))))]
        chosen += draws.sample(every, count // len(ROOMS))
    return chosen


def main():
    """Print each change, and whether its tests notice it within ``--seconds``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    for option, default in (('--count', 40), ('--seed', 0), ('--seconds', 240)):
        parser.add_argument(option, type=int, default=default)
    parser.add_argument('--only', nargs='*', default=[], help='FILE:LINE, as printed')
    given = parser.parse_args()
    code = [path for part in (PACKAGE, 'test') for path in (ROOT / part).rglob('*.py')]
    imports, counts = {path: imported(path) for path in code}, Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / ROOT.name
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns('.git', '.venv', 'build'))
        (Path(folder) / 'shared').symlink_to(ROOT.parent / 'shared')  # if it is there
        for path, text, index in draw(given.count, given.seed):
            tree = ast.parse(text)
            node = places(tree)[index]
            where, what = f'{path.relative_to(ROOT)}:{node.lineno}', change(node)
            if given.only and where not in given.only:
                continue
            files = tests_of(path, around(tree, node) or {path.stem}, imports)
            (target := copy / path.relative_to(ROOT)).write_text(ast.unparse(tree))
            answer, test = run(copy, files, given.seconds)
            target.write_text(text)
            if answer == 'noticed' and test and run(copy, [test], given.seconds)[0] == answer:
                answer = 'fails without it'
            counts[answer] += 1
            print(f'{answer:9} {where}  {what}  {test or " ".join(files)}', flush=True)
    print(', '.join(f'{number} {answer}' for answer, number in counts.items()))


if __name__ == '__main__':
    main()
