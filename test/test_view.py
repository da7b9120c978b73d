"""`flexx2 view` as a user has it: processes, real DDS, and a real browser."""

import base64
from pathlib import Path
import subprocess
import time

from browser import chromium
from flexx2_sim_ros.view.packing import depth_table, difference_table, INVALID
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from streams import listening, Parameter
from views import PATIENCE, View

CAMERAS = ('front_left', 'front_right')
# The board stands 1 m ahead of the left camera. Of 3 m that is the 85th colour of 256: 85.3.
MOST, AT_THE_BOARD = 3.0, 85


class Scene:
    """A page that shows a running demo, and a user of its topics beside it."""

    def __init__(self, view, page, user):
        """Take them."""
        self.view, self.page, self.user = view, page, user
        self.clients = {
            camera: AsyncParameterClient(user.node, f'/{camera}/flexx2_camera')
            for camera in CAMERAS
        }

    def usecase(self, camera):
        """Return a camera's mode, as its node says."""
        client = self.clients[camera]
        self.user.spin_until(client.services_are_ready, 'parameter services')
        values = self.user.wait(client.get_parameters(['usecase'])).values
        return str(parameter_value_to_python(values[0]))

    def listening(self, camera):
        """Return how many listen to a camera's clean depth."""
        return self.user.node.count_subscribers(f'/{camera}/clean/depth_image')


@pytest.fixture(scope='module')
def scene(ros, tmp_path_factory):
    """Start the demo before the board and open the page."""
    browser, folder = tmp_path_factory.mktemp('browser'), tmp_path_factory.mktemp('view')
    words = '--demo', '--scene', 'board', '--renderer', 'ray'
    with chromium(browser) as page, View(folder, *words) as view, listening() as user:
        page.resize()
        page.call('Network.enable')
        page.open(view.url)
        page.until(f'document.querySelectorAll(".camera").length === {len(CAMERAS)}')
        for camera in CAMERAS:
            page.until(f'{part(camera, "hz")}.textContent.endsWith(" Hz")')
            page.until(f'{part(camera, "clean")}.width === 224')
        # Or every frame would come here as well.
        page.call('Network.disable')
        yield Scene(view, page, user)


def part(camera, name):
    """Return the script of an element of a camera's column."""
    return f"document.querySelector('[data-camera={camera}] [data-part={name}]')"


def pixels(page, camera, kind):
    """Return a canvas's pixels: (H, W, 3)."""
    values = page.evaluate(
        f'(() => {{ const canvas = {part(camera, kind)};'
        'const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);'
        'let text = ""; for (const value of data) text += String.fromCharCode(value);'
        'return [canvas.height, canvas.width, btoa(text)]; })()'
    )
    colours = np.frombuffer(base64.b64decode(values[2]), np.uint8)
    return colours.reshape(values[0], values[1], 4)[..., :3]


def images(page, camera):
    """Return a camera's images of a frame whose clean depth a busy machine did not miss."""
    deadline = time.monotonic() + PATIENCE
    while True:
        seen = {kind: pixels(page, camera, kind) for kind in ('clean', 'simulated', 'difference')}
        if all((image != INVALID).any() for image in seen.values()):
            return seen
        assert time.monotonic() < deadline


def index_of(colours, table):
    """Return which colours of a table these are; -1 for others."""
    numbers, known = (np.asarray(values, int) @ (1, 256, 65536) for values in (colours, table))
    order = np.argsort(known)
    at = order[np.searchsorted(known, numbers, sorter=order).clip(max=len(known) - 1)]
    return np.where(known[at] == numbers, at, -1)


def move_slider(page, name, value):
    page.enter(f'document.getElementById("{name}")', value)


def test_images_have_the_colours_of_what_is_seen(scene):
    move_slider(scene.page, 'depth-range', MOST)
    move_slider(scene.page, 'difference-range', 50)
    scene.page.evaluate('new Promise(requestAnimationFrame)')
    seen = images(scene.page, 'front_left')
    assert {image.shape for image in seen.values()} == {(172, 224, 3)}
    middle = {kind: image[83:89, 109:115] for kind, image in seen.items()}
    assert (index_of(middle['clean'], depth_table()) == AT_THE_BOARD).all()
    # sigma_z is 3 to 6 mm here, a colour 12 mm: none of 36 pixels is 36 mm off, nor their
    # differences 50 mm (six sigma: 1e-7).
    assert (np.abs(index_of(middle['simulated'], depth_table()) - AT_THE_BOARD) <= 3).all()
    difference = index_of(middle['difference'], difference_table())
    assert (np.abs(difference - 128) < 127).all()
    assert np.unique(difference).size > 3
    # The right camera sees the board from the side; both have a cloud.
    clouds = [pixels(scene.page, camera, 'cloud') for camera in CAMERAS]
    for image in (*images(scene.page, 'front_right').values(), *clouds):
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 5
    # Everything is a colour of its scale or the one for invalid.
    known = np.concatenate([depth_table(), [INVALID]])
    assert (index_of(seen['simulated'], known) >= 0).all()


def test_the_page_shows_the_numbers_of_the_stream(scene):
    page = scene.page
    for camera in CAMERAS:
        for name in ('clean_hz', 'hz', 'latency', 'drawn'):
            page.until(f'parseFloat({part(camera, name)}.textContent) > 0')
        page.until(f'{part(camera, "choice")}.value')  # A busy node answers after its frames.
        assert 0 <= float(page.evaluate(f'parseFloat({part(camera, "invalid")}.textContent)')) < 90
        assert page.evaluate(f'{part(camera, "problem")}.textContent') == ''
        assert page.evaluate(f'{part(camera, "choice")}.value') == scene.usecase(camera)
        assert page.evaluate(f'{part(camera, "choice")}.options.length') == 9


def test_pointing_at_a_pixel_reads_it_and_dragging_turns_the_cloud(scene):
    page = scene.page

    def mouse(kind, x, y, **more):
        page.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, **more)

    left, top, width, height = page.box(part('front_left', 'clean'))
    mouse('mouseMoved', left + 112.5 / 224 * width, top + 86.5 / 172 * height)
    read = f'{part("front_left", "clean")}.parentElement.querySelector(".read").textContent'
    # A busy machine may miss the clean depth of a frame.
    page.until(f'{read} === "(112, 86) 1.000 m"')
    left, top, width, height = page.box(part('front_left', 'cloud'))
    before = pixels(page, 'front_left', 'cloud')
    mouse('mousePressed', left + 100, top + 100, button='left', buttons=1, clickCount=1)
    mouse('mouseMoved', left + 180, top + 120, button='left', buttons=1)
    mouse('mouseReleased', left + 180, top + 120, button='left', buttons=0, clickCount=1)
    page.evaluate('new Promise(requestAnimationFrame)')
    after = pixels(page, 'front_left', 'cloud')
    assert (before != after).any(axis=-1).mean() > 0.05


def test_choosing_a_mode_sets_it_on_the_node(scene):
    page = scene.page
    answer = "document.querySelector('[data-camera=front_left] .answer')"
    page.enter(part('front_left', 'choice'), 'Mode_5_60fps', 'change')
    page.until(f'{answer}.textContent === "Mode_5_60fps is set"')
    assert scene.usecase('front_left') == 'Mode_5_60fps'
    assert scene.usecase('front_right') == 'Mode_9_30fps'
    # What the node refuses is shown with its reason, and the selector says what is.
    # In one script: the page drops options that the node does not have.
    page.evaluate(
        f'(() => {{ const select = {part("front_left", "choice")};'
        'select.add(new Option("Mode_9_31fps")); select.value = "Mode_9_31fps";'
        'select.dispatchEvent(new Event("change")); })()'
    )
    page.until(f'{answer}.classList.contains("refused")')
    said = page.evaluate(f'{answer}.textContent')
    assert 'Mode_9_31fps' in said
    assert 'Mode_9_30fps' in said
    page.until(f'{part("front_left", "choice")}.value === "Mode_5_60fps"')
    assert scene.usecase('front_left') == 'Mode_5_60fps'
    # What somebody else sets is shown as well.
    client = scene.clients['front_right']
    result = scene.user.wait(client.set_parameters([Parameter('usecase', value='Mode_9_15fps')]))
    assert result.results[0].successful
    page.until(f'{part("front_right", "choice")}.value === "Mode_9_15fps"')


def test_sliders_set_effects_on_the_node(scene):
    page, client = scene.page, scene.clients['front_left']
    slider = "document.querySelector('[data-camera=front_left] [data-effect=offset]')"
    page.until(f'{slider} !== null')
    page.enter(slider, 1.5, 'change')
    on = f'{part("front_left", "effects-on")}.textContent'
    page.until(f'{on} === "on: offset"')
    asked = ['effect.offset.strength']
    strength = scene.user.wait(client.get_parameters(asked)).values[0]
    assert parameter_value_to_python(strength) == 1.5
    # What somebody else sets moves the slider, and the other camera has its own.
    result = scene.user.wait(
        client.set_parameters([Parameter('effect.offset.strength', value=0.0)])
    )
    assert result.results[0].successful
    page.until(f'{on} === "all off" && {slider}.value === "0"')
    assert page.evaluate(f'{part("front_right", "effects-on")}.textContent') == 'all off'


def test_the_wipe_shows_clean_depth_to_the_left_of_its_line(scene):
    move_slider(scene.page, 'depth-range', MOST)
    move_slider(scene.page, 'wipe', 50)
    scene.page.evaluate('new Promise(requestAnimationFrame)')
    deadline, seen = time.monotonic() + PATIENCE, np.zeros((172, 224, 3))
    while not (seen[:, 112] == 255).all():  # A busy machine misses the clean depth of frames.
        assert time.monotonic() < deadline
        seen = pixels(scene.page, 'front_left', 'simulated')
    move_slider(scene.page, 'wipe', 0)
    assert (index_of(seen[83:89, 106:112], depth_table()) == AT_THE_BOARD).all()


def test_the_page_fits_a_phone(scene):
    page = scene.page
    page.resize(390, 844)
    widest = page.evaluate('document.documentElement.scrollWidth')
    page.resize()
    assert widest <= 390


def test_keys_drive_while_they_are_held(scene):
    page, user = scene.page, scene.user
    heard = user.listen('/cmd_vel', Twist)
    poses = user.listen('/odom', Odometry)
    user.spin_until(lambda: poses, 'odometry')
    start = poses[0].pose.pose.position.x

    def drive(code, name):
        heard.clear()
        page.key('keyDown', code, name)
        user.spin_until(lambda: heard and heard[-1] != Twist(), 'a command')

    def stops():
        user.spin_until(lambda: heard[-1] == Twist(), 'the stop')

    def hold(code, name, said, least, until=lambda: True):
        drive(code, name)
        user.spin_until(lambda: len(heard) >= 5 and until(), 'commands')
        page.key('keyUp', code, name)
        stops()
        # On a busy machine a heartbeat comes late, and the robot stops for a moment.
        driven = [message for message in heard if message != Twist()]
        assert all(said(message) * np.sign(least) >= abs(least) for message in driven)

    def moved_back():
        return poses[-1].pose.pose.position.x < start - 0.02

    hold('KeyW', 'w', lambda message: message.linear.x, 0.4)
    # There is room behind it; before it is the board.
    hold('ArrowDown', 'ArrowDown', lambda message: message.linear.x, -0.4, moved_back)
    hold('KeyA', 'a', lambda message: message.angular.z, 0.7)
    hold('KeyE', 'e', lambda message: message.linear.y, -0.2)
    # Another window takes the keyboard: the key is never seen to go up.
    drive('KeyW', 'w')
    page.evaluate('window.dispatchEvent(new Event("blur"))')
    stops()
    # The space bar stops whoever drives, and the key that repeats does not drive again.
    page.key('keyUp', 'KeyW', 'w')
    drive('KeyW', 'w')
    page.key('keyDown', 'Space', ' ')
    stops()
    page.key('keyDown', 'KeyW', 'w', autoRepeat=True)
    assert not page.evaluate('document.querySelectorAll(".pad .held").length')
    page.key('keyUp', 'Space', ' ')
    # The page is gone in the middle of it: the server stops the robot.
    page.key('keyUp', 'KeyW', 'w')
    drive('KeyW', 'w')
    page.open('about:blank')
    stops()
    # And nobody takes frames any longer that nobody looks at: only the camera node is left.
    user.spin_until(lambda: [scene.listening(camera) for camera in CAMERAS] == [1, 1], 'rest')
    page.open(scene.view.url)
    user.spin_until(lambda: [scene.listening(camera) for camera in CAMERAS] == [2, 2], 'frames')


def test_the_page_requests_nothing_from_elsewhere_and_has_no_errors(scene):
    page = scene.page
    elsewhere = 'http://127.0.0.1:9/x'
    blocked = page.evaluate(
        'new Promise((done) => { document.addEventListener("securitypolicyviolation",'
        f' (event) => done(event.effectiveDirective)); fetch("{elsewhere}")'
        '.catch(() => {}); })'
    )
    assert blocked == 'connect-src'
    asked = {request['request']['url'] for request in page.said('Network.requestWillBeSent')}
    asked |= {request['url'] for request in page.said('Network.webSocketCreated')}
    live = scene.view.url.replace('http', 'ws')
    own = scene.view.url, live, 'about:blank', elsewhere
    assert [url for url in asked if not url.startswith(own)] == []
    assert f'{live}live' in asked
    assert page.said('Runtime.exceptionThrown') == []
    said = [entry['entry'] for entry in page.said('Log.entryAdded')]
    errors = [entry['text'] for entry in said if entry['level'] == 'error']
    assert [text for text in errors if elsewhere not in text] == []


def test_ctrl_c_ends_everything(scene):
    children = subprocess.run(
        ['pgrep', '-P', str(scene.view.process.pid)], capture_output=True, text=True, check=True
    ).stdout.split()
    assert len(children) == 3
    assert scene.view.end() == 130
    assert scene.view.errors == ''
    assert not [child for child in children if Path(f'/proc/{child}').exists()]
    assert not list(scene.view.folder.glob('flexx2_view_*'))
    scene.page.until('document.body.classList.contains("lost")')


def test_a_node_that_cannot_start_ends_the_demo_with_its_reason(ros, tmp_path):
    view = View(tmp_path, '--demo', '--scene', 'moon')
    assert view.process.wait(PATIENCE) == 2
    assert view.errors.startswith('flexx2: error: go1_cameras ended with exit code 1')
    assert "got 'moon'" in view.errors
    assert view.errors.count('\n') == 1
