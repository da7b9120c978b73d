"""Types that a bag or the ROS graph names: messages are found, and nothing else is imported."""

import sqlite3
import sys

from flexx2_sim_ros.errors import InputError
from made_bags import TYPES, write
from programs import run_flexx2
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed: no rclpy')

TRAPS = 'trapped/msg/X', 'trap/X', 'venv/__main__/X', 'trapped.msg/X'


def test_message_definitions_are_found():
    from flexx2_sim_ros.nodes.ros_graph import message_class
    from sensor_msgs.msg import Image

    assert message_class('sensor_msgs/msg/Image') is Image


@pytest.mark.parametrize(
    'kind',
    [
        'venv/__main__/X',
        'this/msg/X',
        'antigravity/msg/X',
        'sensor_msgs/msg/_image',
        'sensor_msgs/msg/Nothing',
        'sensor_msgs/srv/SetCameraInfo',
        'sensor_msgs/Image',
        'sensor_msgs/msg/Image\n',
        '../x/msg/X',
        'a.b/msg/X',
        '',
        'x' * 100_000,
        '\x1b[31m/msg/X',
    ],
)
def test_modules_that_are_no_messages_are_not_imported(kind):
    from flexx2_sim_ros.nodes.ros_graph import message_class

    before = set(sys.modules)
    with pytest.raises(InputError) as caught:
        message_class(kind)
    new = set(sys.modules) - before
    assert not {name for name in new if not name.startswith('sensor_msgs')}
    assert len(str(caught.value)) < 200
    assert str(caught.value).isprintable()


@pytest.mark.usefixtures('ros')
def test_replay_runs_nothing_that_a_bag_names(child_env, tmp_path):
    # A module and a package with a submodule `msg`, as any attacker finds some installed.
    for file in ('trap.py', 'trapped/__init__.py', 'trapped/msg/__init__.py'):
        path = tmp_path / 'modules' / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'open({str(tmp_path / "ran")!r}, "w")\nclass X: pass\n')
    text = TYPES.types['std_msgs/msg/String']('x')
    bag = write(
        tmp_path / 'bag',
        [(f'/topic_{i}', 'std_msgs/msg/String', 1, text) for i in range(4)],
        'sqlite3',
    )
    with sqlite3.connect(bag / 'bag.db3') as connection:
        for i, name in enumerate(TRAPS):
            connection.execute('UPDATE topics SET type=? WHERE name=?', (name, f'/topic_{i}'))
    connection.close()
    env = dict(child_env)
    env['PYTHONPATH'] += f':{tmp_path / "modules"}'
    done = run_flexx2('replay', str(bag / 'bag.db3'), '--wait', '0', env=env, timeout=60)
    assert not (tmp_path / 'ran').exists()
    assert done.returncode == 2, done.stderr
    assert 'Traceback' not in done.stderr
    assert done.stderr.count('left out') == 4
