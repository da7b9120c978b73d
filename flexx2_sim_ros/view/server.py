"""
The server of the page: its files, and a websocket for each browser.

A browser gets a camera's newest frame when at most one earlier frame is not drawn yet. A slow
browser or a hidden tab gets fewer frames and does not delay the others. Access is controlled in
`flexx2_sim_ros.view.access`.
"""

import asyncio
import errno
from importlib import resources
import json
import socket
import threading
from typing import Any, Protocol

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.view.access import Access
from flexx2_sim_ros.view.colours import depth_table, difference_table, INVALID
from flexx2_sim_ros.view.packing import pack, ViewedFrame
from flexx2_sim_ros.view.requests import Adjust, Choose, Drawn, Drive, parse
from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

_TYPES = {'html': 'text/html', 'css': 'text/css', 'js': 'text/javascript', 'svg': 'image/svg+xml'}
# Frames of a camera in transit: one that is being drawn, and one that arrives meanwhile.
_AHEAD = 2
_LONGEST_MESSAGE = 4096
_MOST_PAGES = 100
# A page that has not answered a ping before the next one is closed.
_PING_SECONDS = 10.0
_STOP_SECONDS = 3.0


class Source(Protocol):
    """
    The images and actions behind the page; called from the server's thread.

    Attributes
    ----------
    shots : dict of str to ViewedFrame
        The newest frame of every camera; replaced as a whole, never changed.
    status : str
        JSON for the page; replaced when it changes.

    """

    shots: dict[str, ViewedFrame]
    status: str

    def watch(self, watched: bool) -> None:
        """Start or stop receiving frames, when the first page opens or the last one closes."""

    def drive(self, page: object, velocity: tuple[float, float, float]) -> bool:
        """
        Drive: forward and to the left in m/s, turn to the left in rad/s; zeros stop.

        Returns whether the robot follows: another page may have stopped it.
        """

    def leave(self, page: object) -> None:
        """Stop the robot if this page, which was closed, drives it."""

    def choose(self, camera: str, usecase: str) -> None:
        """Request a mode of a camera; the answer is in the status."""

    def adjust(self, camera: str, effect: str, strength: float) -> None:
        """Request the strength of an effect of a camera; the answer is in the status."""

    def complain(self, text: str) -> None:
        """Log that a page has sent a wrong message."""


def bind(host: str, port: int) -> list[socket.socket]:
    """
    Bind the port, before anything else is started.

    Raises
    ------
    InputError
        When the port is in use, or the address does not exist here.

    """
    if not 0 <= port <= 65535:
        raise InputError(f'--port: must be 0 to 65535, got {port}')
    try:
        return bind_sockets(port, host)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f'--port: must be free, or 0 for any, got {port}, which is in use on {host}'
            ) from error
        if error.errno in (errno.EACCES, errno.EPERM):
            raise InputError(
                f'--port: must be 1024 or more for this user, or 0 for any, got {port}'
            ) from error
        raise InputError(
            f'--host: must be an address of this machine, got {shown(host)}: '
            f'{error.strerror or error}'
        ) from error


class Server:
    """
    Serve the page from a separate thread.

    Parameters
    ----------
    sockets : list of socket.socket
        From `bind`.
    access : Access
        Who may connect.
    source : Source
        What the page shows.

    Attributes
    ----------
    access, source
        As given.
    turn : asyncio.Lock
        Held while a frame is sent.

    """

    def __init__(self, sockets: list[socket.socket], access: Access, source: Source) -> None:
        """Read the files of the page."""
        self.access, self.source = access, source
        self.turn = asyncio.Lock()
        self._sockets = sockets
        self._clients: set[Live] = set()
        self._packed: dict[str, tuple[ViewedFrame, bytes]] = {}
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
        """Return the port; for 0, the one that the system chose."""
        return int(self._sockets[0].getsockname()[1])

    def start(self) -> None:
        """Start to answer requests."""
        self._thread.start()
        self._ready.wait()

    def wake(self) -> None:
        """Send what is new in the source. May be called from any thread."""
        # At most one call waits in the loop.
        if self._loop is not None and not self._awake:
            self._awake = True
            self._loop.call_soon_threadsafe(self._wake_all)

    def stop(self) -> None:
        """Close all connections and end the thread."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(_STOP_SECONDS)

    def enter(self, client: 'Live') -> None:
        """Add a browser."""
        self._clients.add(client)
        if len(self._clients) == 1:
            self.source.watch(True)

    def leave(self, client: 'Live') -> None:
        """Remove a browser."""
        self._clients.discard(client)
        self.source.leave(client)
        if not self._clients:
            self.source.watch(False)
            self._packed.clear()

    def packed(self, name: str, shot: ViewedFrame) -> bytes:
        """Return a frame as bytes; computed once for all browsers."""
        done = self._packed.get(name)
        if done is None or done[0] is not shot:
            done = self._packed[name] = shot, pack(name, shot)
        return done[1]

    @property
    def is_full(self) -> bool:
        """Return whether the limit of browsers is reached."""
        return len(self._clients) >= _MOST_PAGES

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        routes: list[Any] = [
            (
                '/' if name == 'index.html' else f'/{name}',
                File,
                {'server': self, 'name': name, 'body': body},
            )
            for name, body in self._files.items()
        ]
        application = Application(
            [*routes, ('/live', Live, {'server': self})],
            default_handler_class=File,
            default_handler_args={'server': self, 'name': '', 'body': b''},
            log_function=lambda _: None,
            websocket_max_message_size=_LONGEST_MESSAGE,
            websocket_ping_interval=_PING_SECONDS,
        )
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
    # Settings of both the page and the websocket.

    def initialize(self, server: Server, **given: Any) -> None:
        self.server, self.given = server, given

    def prepare(self) -> None:
        access, cookie = self.server.access, f'flexx2_view_{self.server.port}'
        if not access.is_own(self.request.host):
            raise HTTPError(403, reason='Host is not this machine')
        if access.token and access.admits(self.get_query_argument('token', '')):
            self.set_cookie(cookie, access.token, httponly=True, samesite='Strict')
        elif not access.admits(self.get_cookie(cookie)):
            raise HTTPError(
                403,
                reason='open the address that flexx2 view has printed: its '
                'token is missing or wrong',
            )

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish(f'{status_code}: {self._reason}\n')


class File(_Guarded):
    """A file of the page."""

    def set_default_headers(self) -> None:
        """Forbid the page to load from other hosts, and other pages to embed it."""
        self.set_header(
            'Content-Security-Policy',
            (
                "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
                "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
            ),
        )
        for name, value in (
            ('Cache-Control', 'no-store'),
            ('Referrer-Policy', 'no-referrer'),
            ('Cross-Origin-Resource-Policy', 'same-origin'),
            ('X-Content-Type-Options', 'nosniff'),
        ):
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
        """Start without frames in transit."""
        super().initialize(server, **given)
        self.news = asyncio.Event()
        self._status = ''
        self._obeyed = self._said_obeyed = True
        # By existing camera; names that a page sends are not stored.
        self._sent: dict[str, ViewedFrame] = {}
        self._undrawn: dict[str, int] = {}

    def prepare(self) -> None:
        """Accept allowed connections up to the limit."""
        super().prepare()
        if self.server.is_full:
            raise HTTPError(503, reason=f'{_MOST_PAGES} pages are open: close one')

    def check_origin(self, origin: str) -> bool:
        """Return whether the page was served by this server."""
        return origin == f'http://{self.request.host}'

    def open(self, *_: str, **__: str) -> None:  # noqa: A003
        """Start to send."""
        self.set_nodelay(True)
        self.server.enter(self)
        self.news.set()
        self._task = asyncio.create_task(self._feed())

    def on_close(self) -> None:
        """Remove the browser."""
        self._task.cancel()
        self.server.leave(self)

    def on_message(self, message: str | bytes) -> None:
        """Handle a message of the page."""
        source = self.server.source
        try:
            asked = parse(message)
        except InputError as error:
            source.complain(f'page at {self.request.remote_ip}: {error}')
            self.close(1007, 'not understood')
            return
        match asked:
            case Drawn(camera):
                if camera in self._undrawn:
                    self._undrawn[camera] = max(0, self._undrawn[camera] - 1)
                    self.news.set()
            case Drive(velocity):
                self._obeyed = source.drive(self, velocity)
                if self._obeyed != self._said_obeyed:
                    self.news.set()
            case Choose(camera, usecase):
                source.choose(camera, usecase)
            case Adjust(camera, effect, strength):
                source.adjust(camera, effect, strength)

    async def _feed(self) -> None:
        source = self.server.source
        try:
            while True:
                await self.news.wait()
                self.news.clear()
                if source.status != self._status:
                    self._status = source.status
                    await self.write_message(self._status)
                if self._obeyed != self._said_obeyed:
                    self._said_obeyed = self._obeyed
                    await self.write_message(json.dumps({'obeyed': self._obeyed}))
                for name in source.shots:
                    if self._wants(name):
                        await self._send(name)
        except (WebSocketClosedError, StreamClosedError):
            pass

    def _wants(self, name: str) -> bool:
        shot = self.server.source.shots.get(name)
        return (
            shot is not None
            and shot is not self._sent.get(name)
            and self._undrawn.get(name, 0) < _AHEAD
        )

    async def _send(self, name: str) -> None:
        # One frame per round of the loop, for any number of pages, so that other
        # messages, above all commands to drive, are handled in between.
        async with self.server.turn:
            await asyncio.sleep(0)
            shot = self.server.source.shots.get(name)
            if shot is None:  # The camera's frames were discarded meanwhile.
                return
            self._sent[name], self._undrawn[name] = shot, self._undrawn.get(name, 0) + 1
            sent = self.write_message(self.server.packed(name, shot), binary=True)
        # Waits until the bytes are sent, so that they do not pile up.
        await sent


def _colours() -> bytes:
    tables = {
        'DEPTH': depth_table().tolist(),
        'DIFFERENCE': difference_table().tolist(),
        'INVALID': INVALID,
    }
    return '\n'.join(
        f'export const {name} = {json.dumps(value)};' for name, value in tables.items()
    ).encode()
