"""Formulas: one source for NumPy, numba and Warp, and compiled again when it changes."""

from pathlib import Path
import subprocess
import sys

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


def printed(folder: Path) -> str:
    """Return what a new process prints that fills an image."""
    return subprocess.run(
        [sys.executable, folder / 'images.py'], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_a_loop_is_compiled_again_when_a_formula_that_it_calls_changes(tmp_path: Path) -> None:
    for name, text in _MODULES.items():
        (tmp_path / name).write_text(text)
    assert printed(tmp_path) == '3.0 0'
    assert printed(tmp_path) == '3.0 1'  # from the disk
    (tmp_path / 'shades.py').write_text(_MODULES['shades.py'].replace('f32(2.0)', 'f32(10.0)'))
    assert printed(tmp_path) == '15.0 0'
