"""`flexx2 view` as a process, its server with a made-up source, and pages without a browser."""

import asyncio
from contextlib import contextmanager
import os
from pathlib import Path
import select
import signal
import subprocess
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from campaigns import write_diagnosis
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.view_files import open_files
from flexx2_sim_ros.view.access import Access
from flexx2_sim_ros.view.playback import PlaybackServer
from flexx2_sim_ros.view.server import Server
from flexx2_sim_ros.view.web import bind
import numpy as np
from programs import flexx2_words, PATIENCE
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

# Of the recording that `save_walk` writes.
USECASE, COUNT, SIZE = 'Mode_5_30fps', 12, (43, 56)
# Their parameters are sure to be seen: each frame takes most of the ones before it.
EFFECTS = {'temporal_filter': {}, 'offset': {}}
K = np.array([[52.0, 0, 27.5], [0, 52.0, 21.0], [0, 0, 1]])


class View:
    """
    The command, running.

    `folder`: where its temporary files are.
    """

    def __init__(self, folder, *options):
        """Start it and wait for its address."""
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get('PYTHONPATH')])]
        env = {**os.environ, 'PYTHONPATH': os.pathsep.join(paths), 'TMPDIR': str(folder)}
        self.folder, self._errors = folder, folder / 'view.log'
        with self._errors.open('wb') as log:
            self.process = subprocess.Popen(
                flexx2_words('view', '--no-browser', '--port', '0', *options),
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        try:
            assert select.select([self.process.stdout], [], [], PATIENCE)[0], self.errors
            line = self.process.stdout.readline()
            assert line.endswith(' (Ctrl-C ends it)\n'), (line, self.errors)
        except BaseException:
            self.process.kill()
            raise
        self.url = line.split()[0]

    def __enter__(self):
        """Use it."""
        return self

    def __exit__(self, *_):
        """Kill it, if it still runs."""
        self.process.kill()

    @property
    def errors(self):
        """Return what it has written to stderr."""
        return self._errors.read_text()

    def end(self):
        """Press Ctrl-C; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def answer_of(url, body=None, **headers):
    """Return the code and the body of an HTTP answer."""
    try:
        with urlopen(Request(url, body, headers)) as answer:
            return answer.status, answer.read()
    except HTTPError as error:
        return error.code, error.read()


def connect(url, **headers):
    """Return a future of a websocket, as the page at this address opens it."""
    parts = urlsplit(url)
    return websocket_connect(
        HTTPRequest(
            parts._replace(scheme='ws', path='/live').geturl(),
            headers={'Origin': f'http://{parts.netloc}', 'Host': parts.netloc} | headers,
        )
    )


def run(work):
    """Run it; fail when it does not end."""

    async def bounded():
        await asyncio.wait_for(work, PATIENCE)

    asyncio.run(bounded())


class Source:
    """Something to show, which writes down what it is asked for."""

    def __init__(self):
        self.shots = {}
        self.status = '{}'
        self.asked = []
        self.complaints = []

    def watch(self, watched):
        self.asked.append(('watch', watched))

    def drive(self, page, velocity):
        self.asked.append(('drive', velocity))
        return velocity[0] >= 0

    def leave(self, page):
        self.asked.append('leave')

    def choose(self, camera, usecase):
        self.asked.append((camera, usecase))

    def adjust(self, camera, effect, strength):
        self.asked.append((camera, effect, strength))

    def complain(self, text):
        self.complaints.append(text)


@contextmanager
def serve_source(access=None):
    """Serve the page with a source; to those whom `access` admits, or to this machine."""
    source = Source()
    server = Server(bind('127.0.0.1', 0), access or Access('127.0.0.1'), source)
    server.start()
    try:
        yield server, source
    finally:
        server.stop()


@contextmanager
def serve_files(path, campaign=None, planes=None):
    """Serve the page of recordings, as `flexx2 view` does; yield its address."""
    recordings, headline = open_files(path, campaign, [], '')
    access = Access('127.0.0.1')
    server = PlaybackServer(bind('127.0.0.1', 0), access, recordings, headline, planes)
    server.start()
    try:
        yield f'http://127.0.0.1:{server.port}'
    finally:
        server.stop()


def connect_to(server, origin='', host=''):
    """Return a future of a websocket, as a page from an origin opens it."""
    address = f'http://127.0.0.1:{server.port}'
    return connect(address, Origin=origin or address, Host=host or f'127.0.0.1:{server.port}')


def save_walk(path, **more):
    """Write a recording of a camera that comes nearer to a wall, with ground truth."""
    stamp = 100 + np.arange(COUNT) / 30
    clean = np.broadcast_to(np.linspace(2, 1, COUNT)[:, None, None], (COUNT, *SIZE)).astype('f4')
    depth = Camera(USECASE, seed=1).capture(clean, K, stamp).depth
    depth[:, :4] = np.nan
    arrays = {'depth': depth, 'clean_depth': clean, 'K': K, 'stamp': stamp} | more
    np.savez(path, **{'usecase': np.array(USECASE)} | arrays)
    return arrays


def save_diagnosis(folder, **more):
    """Write what a diagnosis writes, as far as the page reads it."""
    return write_diagnosis(folder, EFFECTS, **{'verdict': 'none', 'gap': {}, **more})
