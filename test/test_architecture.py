"""The structure that ARCHITECTURE.md draws: imports go down from room to room, in no circle."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
import re
from xml.etree import ElementTree

NAME = 'flexx2_sim_ros'
ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / NAME

# From the lowest room to the highest; a room may import itself and the rooms before it.
ROOMS = (
    'base', 'formulas', 'profiles', 'physics', 'effects', 'camera', 'export',
    'messages', 'recording', 'processing',
    'rendering', 'truth', 'characterize', 'robots', 'consumers', 'batch', 'walking',
    'gap.calibration', 'gap.data', 'gap.features', 'gap.inference', 'gap.forms', 'gap.report',
    'gap', 'gap.planning', 'view',
    'nodes', 'cli',
)  # fmt: skip


def module_name(path):
    """Return a file's module name, without the package's."""
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    return '.'.join(part for part in parts if part != '__init__')


MODULES = {module_name(path): path for path in PACKAGE.rglob('*.py')}


@cache
def nodes(path):
    """Return the statements and expressions of a file."""
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imports(path):
    """Return the modules of this package that a file imports, also inside its functions."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            # `from package import module` imports the module, `from module import name` does not.
            names = [
                one if one.removeprefix(f'{NAME}.') in MODULES else node.module
                for one in (f'{node.module}.{alias.name}' for alias in node.names)
            ]
        else:
            continue
        found |= {name.removeprefix(f'{NAME}.') for name in names if name.startswith(f'{NAME}.')}
    return found & MODULES.keys()


def room(module):
    """Return the room that a module is in."""
    inside = [name for name in ROOMS if module == name or module.startswith(f'{name}.')]
    return max(inside, key=len) if inside else 'base'


def test_every_folder_is_a_room():
    folders = {module_name(path) for path in PACKAGE.rglob('__init__.py')} - {''}
    assert folders == set(ROOMS) - {'base'}


def test_rooms_import_only_rooms_below_them():
    up = [
        f'{module} -> {target}'
        for module, path in MODULES.items()
        for target in imports(path)
        if ROOMS.index(room(target)) > ROOMS.index(room(module))
    ]
    assert not up


def test_imports_have_no_cycles():
    # A package's own __init__ imports what it offers, and nothing in the package imports it back.
    graph = {module: imports(path) - {module} for module, path in MODULES.items()}
    assert list(TopologicalSorter(graph).static_order())  # raises CycleError with the circle


def test_nothing_that_is_installed_imports_what_is_not():
    users = {
        module
        for module, path in MODULES.items()
        for node in nodes(path)
        if isinstance(node, ast.ImportFrom) and node.module
        if node.module.split('.')[0] in ('study', 'bench')
    }
    assert not users


def loaded(statements):
    """Iterate over the modules that statements import when they run: outside functions."""
    for one in statements:
        if isinstance(one, ast.Import):
            yield from (alias.name for alias in one.names)
        elif isinstance(one, ast.ImportFrom):
            yield one.module
        elif isinstance(one, ast.If | ast.Try):
            yield from loaded(ast.iter_child_nodes(one))


def test_only_nodes_load_ros():
    """Assert it of all modules; commands that need ROS load it when they run."""
    package = ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')
    ros = {one.text for one in package if not one.text.startswith('python3-')}
    assert {'rclpy', 'sensor_msgs'} <= ros
    users = {
        module
        for module, path in MODULES.items()
        for name in loaded(ast.parse(path.read_text()).body)
        if name.split('.')[0] in ros
    }
    assert {room(module) for module in users} == {'nodes'}


def test_the_drawing_shows_every_room():
    text = (ROOT / 'ARCHITECTURE.md').read_text()
    drawn = set(re.findall(r'^\| `([\w/]+)/`', text, re.M))
    assert drawn == {name.replace('.', '/') for name in ROOMS} - {'base', 'gap'}


def test_only_loop_keeps_what_is_compiled():
    """Assert nothing stops where the cache of numba cannot be written; see `physics.compiled`."""
    assert [name for name, path in MODULES.items() if 'cache=True' in path.read_text()] == []


# Lines of Python in each room, in hundreds, and files below 60 lines. A commit that needs more
# raises its number and says why; one that needs less lowers it.
BUDGETS = {
    'base': 20, 'batch': 60, 'camera': 10, 'characterize': 46, 'cli': 40, 'consumers': 11,
    'effects': 65, 'export': 9, 'formulas': 7, 'gap': 182, 'messages': 5, 'nodes': 54,
    'physics': 17, 'processing': 9, 'profiles': 14, 'recording': 56, 'rendering': 11, 'robots': 17,
    'truth': 67, 'view': 13, 'walking': 10,
}  # fmt: skip
SMALL_FILES = 29
TESTS, BENCH = 325, 51  # hundreds of lines in test/ and bench/


def test_the_house_stays_small():
    lines = dict.fromkeys(BUDGETS, 0)
    small = 0
    for name, path in MODULES.items():
        count = len(path.read_text(encoding='utf-8').splitlines())
        lines[room(name).split('.')[0]] += count
        small += count < 60 and path.name != '__init__.py'
    too_large = {key: n for key, n in lines.items() if n > 100 * BUDGETS[key]}
    assert not too_large
    assert small <= SMALL_FILES
    for folder, most in (('test', TESTS), ('bench', BENCH)):
        files = (ROOT / folder).rglob('*.py')
        assert sum(len(one.read_text().splitlines()) for one in files) <= 100 * most
