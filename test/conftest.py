"""ROS for the tests: a domain of their own, started once; and waiting without sleeping."""

from collections.abc import Iterator
import os
from pathlib import Path
import sys

from hypothesis import settings
import pytest

# The same examples on every machine, however slow it is.
settings.register_profile('repeatable', deadline=None, derandomize=True)
settings.load_profile('repeatable')

# Before anything imports rclpy: other ROS programs on this machine stay out of the tests and the
# tests out of theirs. Child processes inherit it.
os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
for name in ('ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS'):
    os.environ.pop(name, None)


@pytest.fixture(scope='session')
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Start ROS in this process; skip where there is none."""
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed: no rclpy')
    from rclpy.signals import SignalHandlerOptions
    os.environ['ROS_LOG_DIR'] = str(tmp_path_factory.mktemp('ros_log'))
    # Ctrl-C belongs to pytest.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def child_env(ros: None) -> dict[str, str]:
    """Return the environment for nodes that run as processes, from this checkout."""
    root = str(Path(__file__).resolve().parents[1])
    paths = [root, *filter(None, [os.environ.get('PYTHONPATH')])]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(paths), 'PYTHONUNBUFFERED': '1',
            'PATH': os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])}
