"""The page on live cameras without ROS: what browsers get and send, and what stops a robot."""

import asyncio
from contextlib import contextmanager, suppress
import json
import socket
import threading

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.view import server as server_module
from flexx2_sim_ros.view import web
from flexx2_sim_ros.view.access import Access
from flexx2_sim_ros.view.driving import Driving, HEARTBEAT_TIMEOUT_SECONDS, STOP
from flexx2_sim_ros.view.packing import ViewedFrame
from flexx2_sim_ros.view.server import Server
from flexx2_sim_ros.view.web import bind
import numpy as np
import pytest
from tornado.httpclient import HTTPClientError
from tornado.websocket import WebSocketClosedError
from views import connect_to, PATIENCE, run, serve_source, Source

FORWARD, BACK = (0.5, 0.0, 0.0), (-0.5, 0.0, 0.0)
HEARTBEAT = 0.1  # seconds, of the page
CAMERA = Intrinsics(4, 3, 3.0, 3.0, 1.5, 1.0)


def shot(number, metres=1.5):
    depth = np.full((3, 4), metres, np.float32)
    return ViewedFrame(number, number * 10**9, depth, depth, CAMERA)


@pytest.fixture
def served():
    with serve_source() as pair:
        yield pair


async def until(condition):
    while not condition():
        await asyncio.sleep(0.005)


async def frame(client):
    """Return the head of the next frame."""
    while isinstance(message := await client.read_message(), str):
        pass
    return dict(json.loads(message[4 : 4 + int.from_bytes(message[:4], 'little')]))


def test_a_slow_browser_gets_the_newest_frame_and_no_others(served):
    server, source = served

    async def work():
        slow, fast = await connect_to(server), await connect_to(server)
        seen = []
        for number in range(1, 31):
            source.shots = {'left': shot(number), 'right': shot(number + 100)}
            server.wake()
            seen += [(await frame(fast))['stamp'] for _ in source.shots]
            for camera in source.shots:
                await fast.write_message(json.dumps({'drawn': camera}))
        # Two for each camera, and nothing more before it has drawn one of them.
        first = [(await frame(slow))['stamp'] for _ in range(4)]
        await slow.write_message(json.dumps({'drawn': 'left'}))
        then = await frame(slow)
        assert seen == [k + more for k in range(1, 31) for more in (0, 100)]
        for sent in (
            [stamp for stamp in first if stamp < 100],
            [stamp - 100 for stamp in first if stamp > 100],
        ):
            assert len(sent) == 2
            assert 1 <= sent[0] < sent[1] < 30
        assert (then['camera'], then['stamp']) == ('left', 30)
        slow.close()
        fast.close()
        await until(lambda: ('watch', False) in source.asked)

    run(work())
    # Frames are taken while somebody looks, and not for each who does.
    assert [entry for entry in source.asked if entry != 'leave'] == [
        ('watch', True),
        ('watch', False),
    ]
    assert source.asked.count('leave') == 2


@pytest.mark.parametrize(
    'message',
    [
        '',
        '{"drive": [1, 2]}',
        '{"drive": [NaN, 0, 0]}',
        '{"drive": [0, Infinity, 0]}',
        '{"drive": [true, 0, 0]}',
        f'{{"drive": [{10**400}, 0, 0]}}',
        '{"usecase": "x"}',
        '{"effect": ["left", "offset", "1"]}',
        '{"usecase": ["left", "\\ud800"]}',
        '{"usecase": ["left", "\\u001b[2J"]}',
        f'{{"usecase": ["left", "{300 * "x"}"]}}',
        '{"drawn": 1}',
        '{"shutdown": 1}',
        '{"a":' * 800,
        '[' * 4000,
        '\x1b[2J\r\n',
        b'{"drive": [1, 0, 0]}',
        b'\xff\x00',
    ],
)
def test_invalid_messages_end_only_their_connection(served, caplog, message):
    server, source = served

    async def work():
        client = await connect_to(server)
        await client.write_message(message, binary=isinstance(message, bytes))
        while await client.read_message() is not None:
            pass
        assert client.close_code == 1007
        # The next one is served as if nothing had been.
        source.shots = {'left': shot(7)}
        server.wake()
        assert (await frame(await connect_to(server)))['stamp'] == 7

    run(work())
    assert not [entry for entry in source.asked if entry[0] in ('drive', 'left')]
    (said,) = source.complaints
    assert said.startswith('page at 127.0.0.1: message: must be JSON as the page sends it, got ')
    assert len(said) < 160
    assert said.isprintable()
    assert caplog.records == []


@contextmanager
def silent_page(server):
    """Yield a socket that has opened a websocket; it answers nothing, pings included."""
    address = f'127.0.0.1:{server.port}'
    with socket.create_connection(('127.0.0.1', server.port), 60) as client:
        client.sendall(
            f'GET /live HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n'
            'Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
            'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n'.encode()
        )
        assert client.recv(4096).startswith(b'HTTP/1.1 101')
        yield client


def test_a_page_that_answers_no_ping_is_disconnected(monkeypatch):
    """Assert it of a browser whose machine or network is lost; the robot is then stopped."""
    monkeypatch.setattr(web, '_PING_SECONDS', 0.1)
    source = Source()
    server = Server(bind('127.0.0.1', 0), Access('127.0.0.1'), source)
    server.start()
    try:
        with silent_page(server) as client:
            while client.recv(4096):
                pass
            run(until(lambda: 'leave' in source.asked))
    finally:
        server.stop()


def test_requests_of_a_page_do_not_fill_the_servers_memory(served, monkeypatch):
    server, source = served
    monkeypatch.setattr(server_module, '_MOST_PAGES', 2)
    source.shots = {'left': shot(1)}

    async def work():
        client = await connect_to(server)
        for number in range(900):
            await client.write_message(json.dumps({'drawn': f'camera_{number}'}))
        await client.write_message('{"drive": [1, 0, 0]}')
        await until(lambda: ('drive', (1.0, 0.0, 0.0)) in source.asked)
        (live,) = server._clients
        assert live._undrawn == {'left': 1}
        other = await connect_to(server)
        with pytest.raises(HTTPClientError) as error:
            await connect_to(server)
        assert error.value.code == 503
        other.close()
        await until(lambda: 'leave' in source.asked)
        (await connect_to(server)).close()

    run(work())


def test_a_page_that_floods_is_closed_and_its_robot_stops(served):
    server, source = served

    async def flood():
        client = await connect_to(server)
        with suppress(WebSocketClosedError):
            for _ in range(20_000):
                await client.write_message('{"drive": [1, 0, 0]}')
        while await client.read_message() is not None:
            pass
        await until(lambda: 'leave' in source.asked)

    run(flood())
    assert ('drive', (1.0, 0.0, 0.0)) in source.asked
    assert len(source.asked) < 20_000
    (said,) = source.complaints
    assert 'messages: must be at most 1000 a second, got more' in said


def test_a_page_learns_whether_the_robot_obeys(served):
    async def work():
        client = await connect_to(served[0])
        assert await client.read_message() == '{}'
        for forward in (1, -1, -1):
            await client.write_message(json.dumps({'drive': [forward, 0, 0]}))
        assert json.loads(await client.read_message()) == {'obeyed': False}
        await client.write_message('{"drive": [1, 0, 0]}')
        assert json.loads(await client.read_message()) == {'obeyed': True}

    run(work())


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
