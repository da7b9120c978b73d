"""ROS for the tests: a domain of their own, started once; and waiting without sleeping."""

from collections.abc import Iterator
import os
from pathlib import Path
import socket
import sys

from hypothesis import settings
import pytest

# The same examples on every machine, however slow it is.
settings.register_profile('repeatable', deadline=None, derandomize=True)
settings.load_profile('repeatable')


def _domain() -> int:
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


@pytest.fixture(scope='session')
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Start ROS in this process; skip where there is none."""
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed: no rclpy')
    from flexx2_sim_ros.nodes.transport import make_room_for_images
    from rclpy.signals import SignalHandlerOptions
    make_room_for_images()
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
