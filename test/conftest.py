"""ROS for the tests: a domain of their own, started once; and what may not be skipped."""

import os
from pathlib import Path
import re
import socket
import sys

from hypothesis import settings
import pytest

# The same examples on every machine, however slow it is.
settings.register_profile('repeatable', deadline=None, derandomize=True)
settings.load_profile('repeatable')


def _domain():
    """Return a ROS domain whose first ten participants' ports nobody on this machine uses."""
    for step in range(100):
        domain = 1 + (os.getpid() + step) % 100
        try:
            for port in range(20):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(('', 7410 + 250 * domain + port))
        except OSError:
            continue
        return domain
    return 1 + os.getpid() % 100


# Before anything imports rclpy: other ROS programs on this machine stay out of the tests and the
# tests out of theirs. Child processes inherit it.
os.environ['ROS_DOMAIN_ID'] = str(_domain())
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
for name in ('ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS'):
    os.environ.pop(name, None)


# What has to be there, by words of the reason why tests are skipped without it.
_REASONS = {'browser': 'no Chromium', 'shared': 'is not there'}
_REQUIRED = [_REASONS[name] for name in os.environ.get('FLEXX2_REQUIRE', '').split(',') if name]
# What whole test files import. These files are skipped where it is not installed, as in a ROS
# workspace, where rosdep and pip install what the nodes, bags and tests need and no more.
_OF_EXTRAS = 'cv2', 'h5py', 'mcap', 'trimesh', 'warp'


# Files of long tests. They go first, so that no process is left alone with one of them. The first
# compiles loops that others then find kept; the second needs none meanwhile.
_LONG = 'test_compile_command', 'test_documentation', 'test_gap_benchmark', 'test_gap_cost'
_LONG += 'test_diagnose_your_flexx2', 'test_gap_forms', 'test_gap_next', 'test_gap_truth'
_LONG += 'test_real_cameras', 'test_truth_real', 'test_own_camera'


def pytest_collection_modifyitems(items):
    """Begin with what takes longest."""
    order = {name: place for place, name in enumerate(_LONG)}
    items.sort(key=lambda item: order.get(item.path.stem, len(_LONG)))


def _require(report):
    if report.skipped and isinstance(report.longrepr, tuple):
        reason = report.longrepr[2]
        if any(words in reason for words in _REQUIRED):
            report.outcome = 'failed'
            report.longrepr = f'{reason}: FLEXX2_REQUIRE asks for it'
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """Fail instead of skipping for want of what is required."""
    return _require((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Skip a file that imports a library of an extra which is not installed."""
    report = yield
    missing = report.failed and re.search(
        rf"No module named '({'|'.join(_OF_EXTRAS)})'", str(report.longrepr)
    )
    if missing:
        report.outcome = 'skipped'
        report.longrepr = (str(collector.path), 1, f"could not import '{missing[1]}'")
    return _require(report)


@pytest.fixture(scope='session')
def ros(tmp_path_factory):
    """Start ROS in this process; skip where there is none."""
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed: no rclpy')
    from flexx2_sim_ros.nodes.runtime import make_room_for_images
    from rclpy.signals import SignalHandlerOptions

    make_room_for_images()
    os.environ['ROS_LOG_DIR'] = str(tmp_path_factory.mktemp('ros_log'))
    # Ctrl-C belongs to pytest.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def child_env(ros):
    """Return the environment for nodes that run as processes, from this checkout."""
    root = str(Path(__file__).resolve().parents[1])
    paths = [root, *filter(None, [os.environ.get('PYTHONPATH')])]
    return {
        **os.environ,
        'PYTHONPATH': os.pathsep.join(paths),
        'PYTHONUNBUFFERED': '1',
        'PATH': os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']]),
    }
