"""What the demo's table measures of frames that arrive in part."""

import re
import subprocess
import sys

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.nodes.probe import Capture
import numpy as np
import pytest

MODE = 'Mode_9_30fps'


@pytest.mark.parametrize('kept', [1, 10])
def test_noise_is_that_of_the_model_when_images_are_lost(kept):
    """
    Assert it of a box before a wall, whose edges move, with every ``kept``-th sigma_z only.

    At least 3 frames of more than 20,000 pixels: the ratio scatters by less than 0.005, so that
    a false failure is beyond 6 standard deviations (2e-9).
    """
    clean = np.full((172, 224), 2.0, np.float32)
    for left in range(10, 200, 30):
        clean[40:130, left : left + 15] = 1.2
    stamps = np.arange(30) / 30
    frames = Camera(MODE, seed=1).capture(clean, flexx2().intrinsics.matrix, stamps)
    capture = Capture()
    for i in range(30):
        if i % kept == 0:
            capture.add_sigma(i, frames.sigma[i])
        capture.add(i, frames.depth[i], clean, 0.001)
    realised, modelled = capture.sigmas()
    assert realised / modelled == pytest.approx(1, abs=0.03)
    assert len(capture.stamps) == 30


def test_the_demo_waits_for_frames_however_short_its_time(child_env, tmp_path):
    pytest.importorskip('rclpy')
    done = subprocess.run(
        [sys.executable, '-m', 'flexx2_sim_ros.cli.main', 'demo', '--renderer', 'ray']
        + ['--seconds', '0.001', '--out', str(tmp_path)],
        env=child_env,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = re.findall(r'front_\w+ +Mode_\w+ +(\d+) ', done.stdout)
    assert len(rows) == 6
    assert min(map(int, rows)) >= 3
    assert (tmp_path / 'demo.png').is_file()
