"""What stops a robot that is driven from the page: real processes, real DDS, real websockets."""

import asyncio
from contextlib import suppress
import json
import threading

from flexx2_sim_ros.view.driving import Driving, HEARTBEAT_TIMEOUT_SECONDS, STOP
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from programs import node_words, started
import pytest
from streams import Listener
from tornado.websocket import WebSocketClosedError
from views import connect, PATIENCE, run, View

FORWARD, BACK, TURN = (0.5, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.0, 0.5)
HEARTBEAT = 0.1


class Robot:
    """Takes velocities; says when one has come."""

    def __init__(self):
        self.heard = []
        self._came = threading.Condition()
        self.driving = Driving(self.hear)

    def hear(self, velocity):
        with self._came:
            self.heard.append(velocity)
            self._came.notify()

    def wait_for(self, count):
        with self._came:
            assert self._came.wait_for(lambda: len(self.heard) >= count, PATIENCE)


@pytest.fixture
def robot():
    made = Robot()
    yield made
    made.driving.close()


def test_a_page_that_misses_its_heartbeat_is_stopped(robot):
    for count in (2, 4):
        assert robot.driving.drive('page', FORWARD)
        robot.wait_for(count)
    assert robot.heard == [FORWARD, STOP, FORWARD, STOP]
    assert HEARTBEAT_TIMEOUT_SECONDS >= 3 * HEARTBEAT


def test_any_page_stops_the_robot_until_the_driver_lets_go(robot):
    drive = robot.driving.drive
    assert drive('driver', FORWARD)
    assert drive('other', STOP)
    # The keys are still held.
    assert not drive('driver', FORWARD)
    assert drive('driver', STOP)
    assert drive('driver', BACK)
    assert robot.heard == [FORWARD, STOP, STOP, BACK]


def test_the_page_that_drives_last_replaces_the_one_before(robot):
    drive = robot.driving.drive
    assert drive('first', FORWARD)
    assert drive('second', BACK)
    assert not drive('first', FORWARD)
    robot.driving.leave('first')
    assert drive('second', BACK)
    robot.driving.leave('second')
    assert robot.heard == [FORWARD, BACK, BACK, STOP]
    # Pages that are gone are forgotten.
    assert not robot.driving._ignored


def test_the_end_of_the_viewer_stops_the_robot(robot):
    robot.driving.drive('page', FORWARD)
    robot.driving.close()
    assert not robot.driving.drive('page', FORWARD)
    assert robot.heard == [FORWARD, STOP]


class Page:
    """A page that holds a key, from a thread of its own."""

    def __init__(self, url):
        self._url, self._held = url, threading.Event()
        self._thread = threading.Thread(target=lambda: run(self._hold()), daemon=True)
        self._thread.start()

    async def _hold(self):
        socket = await connect(self._url)
        # Until the server is gone, too.
        with suppress(WebSocketClosedError):
            while not self._held.is_set():
                await socket.write_message(json.dumps({'drive': TURN}))
                await asyncio.sleep(HEARTBEAT)

    def fall_silent(self):
        """Send no heartbeat any longer."""
        self._held.set()
        self._thread.join()


@pytest.fixture(scope='module')
def user(ros):
    made = Listener()
    yield made
    made.close()


def test_kill_9_of_the_viewer_leaves_the_robot_to_its_own_hold(user, tmp_path):
    ros = ['-r', '__ns:=/view_killed', '-p', 'motion:=cmd_vel', '-p', 'scene:=board']
    go1 = node_words('go1_cameras', *ros, '-p', 'renderer:=ray')
    with (tmp_path / 'go1.log').open('wb') as log, started(go1, stdout=log, stderr=log):
        view = View(tmp_path, '--cmd-vel', '/view_killed/cmd_vel')
        seen = user.listen('/view_killed/odom', Odometry)
        heard = user.listen('/view_killed/cmd_vel', Twist)
        page = Page(view.url)
        try:
            user.spin_until(lambda: seen and seen[-1].twist.twist.angular.z > 0.2, 'turning')
        finally:
            view.process.kill()
        view.process.wait(PATIENCE)
        page.fall_silent()
        said = len(heard)
        user.spin_until(lambda: seen[-1].twist.twist.angular.z == 0.0, 'rest')
        # Nobody has told it to: it stands because it has heard nothing for half a second.
        assert Twist() not in heard[said - 1 :]
