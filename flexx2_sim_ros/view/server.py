"""
The server of the page: its files, and a websocket for each browser.

A browser is sent a camera's newest frame when it has drawn all but one of those before: a slow
one, or a tab that nobody looks at, gets fewer frames and holds nothing up.

Whoever has the page can drive a robot. So only the page itself may connect: the Host of a
request has to be an address or a name of this machine (another name can be made to point here by
whoever owns it), and the Origin of a websocket has to be that host.
"""

import asyncio
import errno
from importlib import resources
import ipaddress
import json
import math
import socket
import threading
from typing import Any, Protocol
from urllib.parse import urlsplit

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.view.colours import depth_table, difference_table, INVALID
from flexx2_sim_ros.view.packing import pack, Shot
from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

_TYPES = {'html': 'text/html', 'css': 'text/css', 'js': 'text/javascript', 'svg': 'image/svg+xml'}
# Frames of a camera on their way: one that is being drawn, and one that comes meanwhile.
_AHEAD = 2
_LONGEST_MESSAGE = 4096
_STOP_SECONDS = 3.0


class Source(Protocol):
    """
    What the page shows, and what it can do; called from the server's thread.

    Attributes
    ----------
    shots : dict of str to Shot
        The newest frame of every camera; replaced as a whole, never changed.
    status : str
        JSON for the page; replaced when there is something new.

    """

    shots: dict[str, Shot]
    status: str

    def watch(self, watched: bool) -> None:
        """Begin or end to take frames: somebody looks, or nobody."""

    def drive(self, driver: object, velocity: tuple[float, float, float]) -> None:
        """Drive: forward and to the left in m/s, turn to the left in rad/s; zeros stop."""

    def leave(self, driver: object) -> None:
        """Stop what a driver has begun: it is gone."""

    def choose(self, camera: str, usecase: str) -> None:
        """Ask a camera for a mode; the answer comes in the status."""


def bind(host: str, port: int) -> list[socket.socket]:
    """
    Take the port, before anything else is started.

    Raises
    ------
    InputError
        When it is taken, or there is no such address here.

    """
    if not 0 <= port <= 65535:
        raise InputError(f'--port: found {port}, wanted 0 to 65535')
    try:
        return bind_sockets(port, host)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(f'--port: {port} is already taken on {host}, wanted one that is '
                             'free, or 0 for any') from error
        if error.errno in (errno.EACCES, errno.EPERM):
            raise InputError(f'--port: {port} is not for every user, wanted 1024 or more, or 0 '
                             'for any') from error
        raise InputError(f'--host: found {host!r}, wanted an address of this machine: '
                         f'{error.strerror or error}') from error


class Server:
    """
    Serve the page from a thread of its own.

    Parameters
    ----------
    sockets : list of socket.socket
        From `bind`.
    host : str
        What they are bound to.
    source : Source
        What the page shows.

    """

    def __init__(self, sockets: list[socket.socket], host: str, source: Source) -> None:
        """Read the page."""
        self.names = {'localhost', socket.gethostname().lower(), host.lower()}
        self.source = source
        self._sockets = sockets
        self._clients: set[Live] = set()
        self._packed: dict[str, tuple[Shot, bytes]] = {}
        self._awake = False
        self._ready = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._files = {'colours.js': _colours()}
        for path in resources.files('flexx2_sim_ros.view').joinpath('page').iterdir():
            if path.name.rpartition('.')[2] in _TYPES:
                self._files[path.name] = path.read_bytes()

    @property
    def port(self) -> int:
        """Return the port, which is another one when 0 was asked for."""
        return int(self._sockets[0].getsockname()[1])

    def start(self) -> None:
        """Answer from now on."""
        self._thread.start()
        self._ready.wait()

    def wake(self) -> None:
        """Look at the source: there is something new. Called from any thread."""
        # At most one call waits in the loop, however busy that is.
        if self._loop is not None and not self._awake:
            self._awake = True
            self._loop.call_soon_threadsafe(self._wake_all)

    def stop(self) -> None:
        """Say goodbye to all browsers and end the thread."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(_STOP_SECONDS)

    def enter(self, client: 'Live') -> None:
        """Take a browser in."""
        self._clients.add(client)
        if len(self._clients) == 1:
            self.source.watch(True)

    def leave(self, client: 'Live') -> None:
        """Forget a browser."""
        self._clients.discard(client)
        self.source.leave(client)
        if not self._clients:
            self.source.watch(False)
            self._packed.clear()

    def packed(self, name: str, shot: Shot) -> bytes:
        """Return a frame as bytes, made once for all browsers."""
        done = self._packed.get(name)
        if done is None or done[0] is not shot:
            done = self._packed[name] = shot, pack(name, shot)
        return done[1]

    def is_mine(self, host: str) -> bool:
        """Say whether a request's Host is this machine, by an address or a name of its own."""
        try:
            name = (urlsplit(f'//{host}').hostname or '').lower()
            if name in self.names:
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        routes: list[Any] = [
            ('/' if name == 'index.html' else f'/{name}', File,
             {'server': self, 'name': name, 'body': body}) for name, body in self._files.items()]
        application = Application(
            [*routes, ('/live', Live, {'server': self})], default_handler_class=File,
            default_handler_args={'server': self, 'name': '', 'body': b''},
            log_function=lambda _: None, websocket_max_message_size=_LONGEST_MESSAGE,
            websocket_ping_interval=10)
        server = HTTPServer(application, max_body_size=0)
        server.add_sockets(self._sockets)
        self._ready.set()
        await self._end.wait()
        server.stop()
        for client in tuple(self._clients):
            client.close(1001, 'the server ends')
        await server.close_all_connections()

    def _wake_all(self) -> None:
        self._awake = False
        for client in self._clients:
            client.news.set()


class _Guarded(RequestHandler):
    # What is the same for the page and for the websocket.

    def initialize(self, server: Server, **given: Any) -> None:
        self.server, self.given = server, given

    def prepare(self) -> None:
        if not self.server.is_mine(self.request.host):
            raise HTTPError(403, reason='Host is not this machine')

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish(f'{status_code}: {self._reason}\n')


class File(_Guarded):
    """A file of the page."""

    def set_default_headers(self) -> None:
        """Let the page load nothing from elsewhere, and be shown by nobody else."""
        self.set_header('Content-Security-Policy', (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
            "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"))
        for name, value in (('Cache-Control', 'no-store'), ('Referrer-Policy', 'no-referrer'),
                            ('Cross-Origin-Resource-Policy', 'same-origin'),
                            ('X-Content-Type-Options', 'nosniff')):
            self.set_header(name, value)
        self.clear_header('Server')

    def get(self) -> None:
        """Answer with the file."""
        name = self.given['name']
        if not name:
            raise HTTPError(404)
        kind = _TYPES[name.rpartition('.')[2]]
        self.set_header('Content-Type', f'{kind}; charset=utf-8')
        self.finish(self.given['body'])


class Live(_Guarded, WebSocketHandler):
    """
    A browser.

    Attributes
    ----------
    news : asyncio.Event
        To be set when there is something new to send.

    """

    def initialize(self, server: Server, **given: Any) -> None:
        """Begin with nothing sent."""
        super().initialize(server, **given)
        self.news = asyncio.Event()
        self._status = ''
        self._sent: dict[str, Shot] = {}
        self._undrawn: dict[str, int] = {}

    def check_origin(self, origin: str) -> bool:
        """Say whether the page is from here."""
        return origin == f'http://{self.request.host}'

    def open(self, *_: str, **__: str) -> None:  # noqa: A003
        """Begin to send."""
        self.set_nodelay(True)
        self.server.enter(self)
        self.news.set()
        self._task = asyncio.create_task(self._feed())

    def on_close(self) -> None:
        """End."""
        self._task.cancel()
        self.server.leave(self)

    def on_message(self, message: str | bytes) -> None:
        """Do what the page asks for."""
        source = self.server.source
        try:
            asked = json.loads(message)
        except ValueError:
            asked = None
        match asked:
            case {'drawn': str(camera)}:
                self._undrawn[camera] = max(0, self._undrawn.get(camera, 0) - 1)
                self.news.set()
            case {'drive': [float() | int() as x, float() | int() as y, float() | int() as turn]} \
                    if math.isfinite(x) and math.isfinite(y) and math.isfinite(turn):
                source.drive(self, (float(x), float(y), float(turn)))
            case {'usecase': [str(camera), str(usecase)]}:
                source.choose(camera, usecase)
            case _:
                self.close(1007, 'not understood')

    async def _feed(self) -> None:
        source = self.server.source
        try:
            while True:
                await self.news.wait()
                self.news.clear()
                if source.status != self._status:
                    self._status = source.status
                    await self.write_message(self._status)
                for name, shot in source.shots.items():
                    undrawn = self._undrawn.get(name, 0)
                    if shot is not self._sent.get(name) and undrawn < _AHEAD:
                        self._sent[name], self._undrawn[name] = shot, undrawn + 1
                        # Waits until the bytes have left: none pile up here.
                        await self.write_message(self.server.packed(name, shot), binary=True)
        except (WebSocketClosedError, StreamClosedError):
            pass


def _colours() -> bytes:
    tables = {'DEPTH': depth_table().tolist(), 'DIFFERENCE': difference_table().tolist(),
              'INVALID': INVALID}
    return '\n'.join(f'export const {name} = {json.dumps(value)};'
                     for name, value in tables.items()).encode()
