"""
The linters of ament, as `colcon test` runs them in a ROS installation.

Without ROS their plugins of flake8 and pydocstyle run in `make lint`. ``ament_copyright`` does not
run: no file has a header of its own. The licence of all files is in LICENSE.
"""

from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
CODE = [
    str(ROOT / name) for name in ('flexx2_sim_ros', 'study', 'test', 'bench', 'launch', 'setup.py')
]


def test_ament_flake8():
    main = pytest.importorskip('ament_flake8.main')
    code, errors = main.main_with_errors(argv=['--config', str(ROOT / '.flake8'), *CODE])
    assert code == 0, '\n'.join(errors)


def test_ament_pep257():
    main = pytest.importorskip('ament_pep257.main')
    assert main.main(argv=CODE) == 0


def test_no_file_has_a_copyright_header_and_the_licence_is_said_once():
    files = [path for folder in CODE for path in Path(folder).rglob('*.py')]
    assert len(files) > 300
    with_header = [path.name for path in files if 'Copyright' in path.read_text()[:300]]
    assert with_header == []
    assert 'Apache License' in (ROOT / 'LICENSE').read_text()[:200]
    assert ElementTree.parse(ROOT / 'package.xml').findtext('license') == 'Apache-2.0'
