"""A second node of a name ends before it has started anything, and the first goes on."""

from programs import node_words, PATIENCE, starting
import pytest

SAID = (
    'error: node name: must be unique, got /twins/flexx2_camera, which is running already. '
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


def test_the_second_camera_ends_and_the_name_is_free_again(start):
    first = start('flexx2_camera')
    first_line(first, 'waiting for')
    second = start('flexx2_camera')
    assert second.communicate(timeout=PATIENCE)[1] == SAID
    assert second.returncode == 1
    # Whoever is killed leaves nothing behind.
    first.kill()
    first.wait()
    first_line(start('flexx2_camera'), 'waiting for')
