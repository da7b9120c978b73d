"""Six walls with a known error: what is found, how large it is said to be, and in which units."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.gap import diagnose
import numpy as np
import pytest

MODE = 'Mode_9_30fps'
SHAPE = 86, 112
K = flexx2().intrinsics.matrix.copy()
K[:2] *= 0.5
K[:2, 2] -= 0.25
DISTANCES = (0.8, 1.1, 1.4, 1.8, 2.2, 2.8)


def write_walls(folder: Path, same: bool = False, **effects: dict[str, float]) -> Path:
    """Write recordings of walls that face the camera, stamps from 0."""
    folder.mkdir(parents=True, exist_ok=True)
    stamp = np.arange(10) / 30
    for i, distance in enumerate(DISTANCES):
        clean = np.full(SHAPE, distance, np.float32)
        device = Camera(MODE, seed=7 if same else i, effects=effects)
        np.savez(folder / f'wall{i}.npz', depth=device.capture(clean, K, stamp).depth,
                 clean_depth=clean, K=K, stamp=stamp, usecase=MODE)
    return folder


@pytest.mark.parametrize('same', [False, True])
def test_an_offset_of_recordings_that_all_begin_at_0(tmp_path: Path, same: bool) -> None:
    """
    Assert that it alone is found, whether the recordings' noise differs or is the very same.

    False failures: 9,600 pixels of 10 frames know each wall's depth to 0.05 mm.
    """
    table = diagnose(write_walls(tmp_path, same, offset={'bias': 0.01}))
    assert table['verdict'] == 'identified'
    effect, = table['effects']
    assert effect['name'] == 'offset'
    assert effect['parameters']['bias'] == pytest.approx(0.01, rel=0.05)
    assert table['gap']['shrink'] > 0.95
    assert table['gap']['wasserstein_mm']['shrink'] > 0.98
    assert not any(row['channel'] == 'repeat' for row in table['where'])
    notes = [note for row in table['recordings'] for note in row['notes']]
    assert sum('very same noise' in note for note in notes) == (6 if same else 0)


def test_a_fixed_pattern_is_still_found(tmp_path: Path) -> None:
    folder = tmp_path / 'walls'
    folder.mkdir()
    stamp = np.arange(10) / 30
    device: Any = Camera(MODE, seed=7, effects={'fixed_pattern': {'rms': 0.002}})
    for i, distance in enumerate(DISTANCES):
        clean = np.full(SHAPE, distance, np.float32)
        np.savez(folder / f'wall{i}.npz', depth=device.capture(clean, K, stamp + 100 * i).depth,
                 clean_depth=clean, K=K, stamp=stamp, usecase=MODE)
    effect, = diagnose(folder)['effects']
    assert effect['name'] == 'fixed_pattern'
    assert effect['parameters']['rms'] == pytest.approx(0.002, rel=0.15)
