"""Formulas: one source for NumPy, numba and Warp, and compiled again when it changes."""

from importlib import invalidate_caches
import pickle
import runpy
import sys

from programs import run_python
import pytest

_MODULES = {
    'shades.py': """
from flexx2_sim_ros.formulas.scalars import f32

_FACTOR = f32(2.0)


def doubled(x: float) -> float:
    return _FACTOR * x
""",
    'images.py': """
from flexx2_sim_ros.physics.compiled import compiled, loop
import numpy as np
from shades import doubled

_doubled = compiled(doubled)


@loop()
def fill(out):
    for i in range(out.size):
        out[i] = _doubled(np.float32(1.5))


out = np.empty(2, np.float32)
fill(out)
print(out[1], sum(fill.stats.cache_hits.values()))
""",
}


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """Write the modules; return a function that says what a program with them prints."""
    for name, text in _MODULES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, 'dont_write_bytecode', True)  # It changes within a second.

    def run():
        monkeypatch.delitem(sys.modules, 'shades', raising=False)
        invalidate_caches()
        runpy.run_path(str(tmp_path / 'images.py'))
        return capsys.readouterr().out.strip()

    return run


def test_a_loop_is_compiled_again_when_a_formula_that_it_calls_changes(printed, tmp_path):
    assert printed() == '3.0 0'
    assert printed() == '3.0 1'  # from the disk
    (tmp_path / 'shades.py').write_text(_MODULES['shades.py'].replace('f32(2.0)', 'f32(10.0)'))
    assert printed() == '15.0 0'


# The compiled loop is larger than a file may be.
_SMALL_FILES = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
"""


def test_a_loop_that_cannot_be_kept_runs_all_the_same(printed, tmp_path):
    images = tmp_path / 'images.py'
    images.write_text(_SMALL_FILES + _MODULES['images.py'])
    assert run_python(images, check=True).stdout.strip() == '3.0 0'
    assert not list(tmp_path.rglob('*.nbc'))
    images.write_text(_MODULES['images.py'])
    assert [printed() for _ in range(2)] == ['3.0 0', '3.0 1']


def _flipped(data):
    # A bit in the machine code of the loop, which is most of the file.
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


DAMAGES = [
    ('nbi', lambda data: b'<html>not found</html>'),
    ('nbi', lambda data: data[: len(data) // 2]),
    ('nbi', lambda data: pickle.dumps(3)),
    ('nbc', lambda data: b''),
    ('nbc', lambda data: bytes(len(data))),
    ('nbc', _flipped),
    ('nb?', lambda data: data[:-1]),
]


def test_damaged_files_of_the_cache_are_written_anew(printed, tmp_path):
    assert printed() == '3.0 0'
    for kind, damaged in DAMAGES:
        for path in tmp_path.rglob(f'*.{kind}'):
            path.write_bytes(damaged(path.read_bytes()))
        assert printed() == '3.0 0'
    assert printed() == '3.0 1'
