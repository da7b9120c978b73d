"""Depth as other programs write it: what means no depth, units, compressed images."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording, Recording
from made_bags import image, info, MATRIX, write
from made_images import ost, save
import numpy as np
import pytest

SIZE = 8, 10


def converted(source: Path, *options: Any) -> Recording:
    """Return what `flexx2 convert` makes of a file."""
    out = source.parent / 'converted.npz'
    assert main(['convert', str(source), str(out), *map(str, options)]) == 0
    return load_recording(out)


@pytest.mark.parametrize('form', ['bag', 'big-endian bag', 'folder', 'npz', 'other npz'])
def test_the_largest_count_of_16_bits_is_no_depth(form: str, tmp_path: Path) -> None:
    depth = np.full((2, *SIZE), 1500, np.uint16)
    depth[:, :3], depth[:, 3] = 65535, 65534
    source, options = tmp_path / 'source', []
    if form == 'folder':
        for number, frame in enumerate(depth):
            save(source / f'{number}.png', frame)
        (source / 'ost.yaml').write_text(ost())
    elif 'bag' in form:
        kind = '>u2' if 'big' in form else '<u2'
        entries = [info('/d/camera_info', 0, SIZE)]
        entries += [
            image('/d/image', n, frame.astype(kind), '16UC1') for n, frame in enumerate(depth)
        ]
        write(source, entries)
    else:
        source = source.with_suffix('.npz')
        np.savez(source, depth=depth, K=MATRIX)
        options = ['--unit', 0.001] if 'other' in form else []
    found = converted(source, *options).depth
    assert np.isnan(found[:, :3]).all()
    np.testing.assert_allclose(found[:, 3], 65.534, rtol=1e-6)
    np.testing.assert_allclose(found[:, 4:], 1.5, rtol=1e-6)
