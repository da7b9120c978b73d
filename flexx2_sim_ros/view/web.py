"""
The web server of the page: its thread, its files, and the check of who asks.

Access is controlled in `flexx2_sim_ros.view.access`.
"""

import asyncio
import errno
from importlib import resources
import json
import socket
import threading
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.view.access import Access
from flexx2_sim_ros.view.packing import depth_table, difference_table, INVALID
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

_TYPES = {'html': 'text/html', 'css': 'text/css', 'js': 'text/javascript', 'svg': 'image/svg+xml'}
_LONGEST_MESSAGE = 4096
# More than a page sends. An answer to a body that is not read is lost: the kernel resets it.
_LONGEST_BODY = 1 << 16
# A page that has not answered a ping before the next one is closed.
_PING_SECONDS = 10.0
_STOP_SECONDS = 3.0


def bind(host: str, port: int) -> list[socket.socket]:
    """
    Bind the port, before anything else is started.

    Raises InputError when the port is in use, or the address does not exist here.
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


class WebServer:
    """
    Serve the files of the page from a separate thread; subclasses serve what it shows.

    ``sockets`` are from `bind`, ``access`` says who may connect. ``recorded`` is what the page has
    to know of recordings, as JSON; None for live cameras. ``loop`` is the thread's event loop,
    once it runs.
    """

    def __init__(
        self, sockets: list[socket.socket], access: Access, recorded: dict[str, Any] | None
    ) -> None:
        """Read the files of the page."""
        self.access = access
        self.loop: asyncio.AbstractEventLoop | None = None
        self._sockets = sockets
        self._ready = threading.Event()
        self._end: asyncio.Event
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._files = {
            'colours.js': _colours(),
            'recorded.js': f'export const RECORDED = {json.dumps(recorded)};'.encode(),
        }
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

    def stop(self) -> None:
        """Close all connections and end the thread."""
        if self.loop is not None:
            self.loop.call_soon_threadsafe(self._end.set)
            self._thread.join(_STOP_SECONDS)

    def routes(self) -> list[Any]:
        """Return the routes beside the files, as Tornado takes them."""
        raise NotImplementedError

    def closing(self) -> None:
        """Close what is open; called in the thread before it ends."""

    async def _serve(self) -> None:
        self.loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        files: list[Any] = [
            (
                '/' if name == 'index.html' else f'/{name}',
                File,
                {'server': self, 'name': name, 'body': body},
            )
            for name, body in self._files.items()
        ]
        application = Application(
            [*files, *self.routes()],
            default_handler_class=File,
            default_handler_args={'server': self, 'name': '', 'body': b''},
            log_function=lambda _: None,
            websocket_max_message_size=_LONGEST_MESSAGE,
            websocket_ping_interval=_PING_SECONDS,
        )
        server = HTTPServer(application, max_body_size=_LONGEST_BODY)
        server.add_sockets(self._sockets)
        self._ready.set()
        await self._end.wait()
        server.stop()
        self.closing()
        await server.close_all_connections()


class Guarded(RequestHandler):
    """A request that `Access` has to allow. Errors are a line of text."""

    def initialize(self, server: Any, **given: Any) -> None:
        """Take the server and what belongs to the route."""
        self.server, self.given = server, given

    def prepare(self) -> None:
        """Refuse other hosts and a wrong token."""
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

    def check_origin(self, origin: str) -> bool:
        """Return whether the page was served by this server."""
        return origin == f'http://{self.request.host}'

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with the reason."""
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish(f'{status_code}: {self._reason}\n')


class File(Guarded):
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


def _colours() -> bytes:
    tables = {
        'DEPTH': depth_table().tolist(),
        'DIFFERENCE': difference_table().tolist(),
        'INVALID': INVALID,
    }
    return '\n'.join(
        f'export const {name} = {json.dumps(value)};' for name, value in tables.items()
    ).encode()
