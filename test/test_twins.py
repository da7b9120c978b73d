"""A second node of a name ends before it has started anything, and the first goes on."""

from programs import node_words, PATIENCE, starting
import pytest
from sensor_msgs.msg import CameraInfo
from streams import listening

SAID = (
    'error: node name: must be unique, got /twins/{}, which is running already. '
    'Choose another name or namespace, e.g. --ros-args -r __node:=another\n'
)


@pytest.fixture
def start(child_env):
    """Return a function that starts a node; those that still run are killed at the end."""
    with starting(env=child_env) as run:
        yield lambda name, *words: run(node_words(name, '-r', '__ns:=/twins', *words))


def first_line(process, what):
    """Wait until a node says that it runs."""
    for line in process.stderr:
        assert not line.startswith('error')
        if what in line:
            return
    raise AssertionError('it ended')


def test_the_second_robot_ends_and_the_first_goes_on(start):
    options = ['-p', 'renderer:=ray', '-p', 'scene:=corner', '-p', 'rate:=20.0']
    first_line(start('go1_cameras', *options), 'rendered by')
    with listening() as user:
        heard = user.listen('/twins/front_left/clean/camera_info', CameraInfo)
        # A scene that is not there would be the next thing to fail: it has not got that far.
        second = start('go1_cameras', '-p', 'scene:=moon')
        assert second.communicate(timeout=PATIENCE)[1] == SAID.format('go1_cameras')
        assert second.returncode == 1
        assert user.node.count_publishers('/twins/front_left/clean/camera_info') == 1
        so_far = len(heard)
        user.spin_until(lambda: len(heard) > so_far + 5, 'more of the first')


def test_the_second_camera_ends_and_the_name_is_free_again(start):
    first = start('flexx2_camera')
    first_line(first, 'waiting for')
    second = start('flexx2_camera')
    assert second.communicate(timeout=PATIENCE)[1] == SAID.format('flexx2_camera')
    assert second.returncode == 1
    # Whoever is killed leaves nothing behind.
    first.kill()
    first.wait()
    first_line(start('flexx2_camera'), 'waiting for')
