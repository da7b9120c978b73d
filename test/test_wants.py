"""What the end of a test run says of tests that were skipped."""

import os
from pathlib import Path
import re
import subprocess

from programs import run_python
import pytest
import wants

ROOT = Path(__file__).resolve().parents[1]


def run_where_no_browser_is(**env: str) -> 'subprocess.CompletedProcess[str]':
    """Run tests that need a browser, spread over processes as `make test` does."""
    return run_python(
        '-m',
        'pytest',
        '-q',
        '-n',
        '2',
        '-p',
        'no:cacheprovider',
        'test/test_view_web.py',
        '-k',
        'point_cloud_is_undistorted',
        cwd=ROOT,
        env={**os.environ, 'PATH': '', **env},
    )


def test_skipped_tests_are_summed_up_with_how_to_get_what_they_want() -> None:
    done = run_where_no_browser_is(FLEXX2_REQUIRE='')
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'skipped for want of something: 4' in done.stdout
    assert re.search(r'^ +4  browser: apt install chromium$', done.stdout, re.M)


def test_what_is_required_fails_instead() -> None:
    done = run_where_no_browser_is(FLEXX2_REQUIRE='browser,shared')
    assert done.returncode == 1
    assert '4 failed' in done.stdout
    assert 'FLEXX2_REQUIRE asks for "browser": apt install chromium' in done.stdout
    done = run_where_no_browser_is(FLEXX2_REQUIRE='brwser')
    assert done.returncode != 0
    assert 'FLEXX2_REQUIRE: must be names of browser, shared' in done.stdout + done.stderr


@pytest.mark.parametrize(
    ('reason', 'want'),
    [
        ('no Chromium or Chrome is installed', 'browser'),
        ('/a/shared/data/kinect2_chessboard.npz is not there', 'shared'),
        ('no OpenGL: egl: cannot be opened', 'opengl'),
        ('ROS 2 is not installed: no rclpy', 'ros'),
        ("could not import 'torch': No module named 'torch'", 'torch'),
        ("could not import 'jax.numpy': No module named 'jax'", 'jax'),
        ("could not import 'mujoco_menagerie': No module", 'menagerie'),
        ('no GPU', 'gpu'),
        ('another reason', wants.OTHER),
    ],
)
def test_reasons_of_skips_have_names(reason: str, want: str) -> None:
    assert wants.want_of(reason) == want


def test_unknown_reasons_of_skips_are_listed_unchanged() -> None:
    assert wants.summary(['no GPU', 'odd', 'no GPU']) == [
        '   2  gpu: an NVIDIA GPU with its driver',
        '   1  odd',
    ]


def test_a_file_whose_library_is_not_installed_is_skipped() -> None:
    program = """
import sys, pytest
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name == 'cv2':
            raise ModuleNotFoundError("No module named 'cv2'", name=name)
sys.meta_path.insert(0, Missing())
sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', 'test/test_truth_board.py']))
"""
    done = run_python('-c', program, cwd=ROOT)
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout + done.stderr
    assert re.search(r"^ +1  truth: pip install '\.\[truth\]'$", done.stdout, re.M)
