"""
The page on live cameras: a websocket for each browser.

A browser gets a camera's newest frame when at most one earlier frame is not drawn yet. A slow
browser or a hidden tab gets fewer frames and does not delay the others.
"""

import asyncio
import json
import socket
import time
from typing import Any, Protocol

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.view.access import Access, Adjust, Choose, Drawn, Drive, parse
from flexx2_sim_ros.view.packing import pack, ViewedFrame
from flexx2_sim_ros.view.web import Guarded, WebServer
from tornado.iostream import StreamClosedError
from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

# Frames of a camera in transit: one that is being drawn, and one that arrives meanwhile.
_AHEAD = 2
_MOST_PAGES = 100
# Messages of a page in a second. A page sends one for each frame that it draws and ten to drive;
# of one that sends more, what is in transit would be obeyed long after its keys are released.
_MOST_MESSAGES = 1000


class PageSource(Protocol):
    """
    The images and actions behind the page; called from the server's thread.

    ``shots`` are the newest frame of every camera; replaced as a whole, never changed. ``status``
    is JSON for the page; replaced when it changes.
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


class Server(WebServer):
    """
    Serve the page with live cameras, those of `source`.

    ``sockets`` and ``access`` are as for `WebServer`; ``turn`` is held while a frame is sent.
    """

    def __init__(self, sockets: list[socket.socket], access: Access, source: PageSource) -> None:
        """Start without browsers."""
        super().__init__(sockets, access, None)
        self.source = source
        self.turn = asyncio.Lock()
        self._clients: set[Live] = set()
        self._packed: dict[str, tuple[ViewedFrame, bytes]] = {}
        self._awake = False

    def wake(self) -> None:
        """Send what is new in the source. May be called from any thread."""
        # At most one call waits in the loop.
        if self.loop is not None and not self._awake:
            self._awake = True
            self.loop.call_soon_threadsafe(self._wake_all)

    def routes(self) -> list[Any]:
        """Return the route of websockets."""
        return [('/live', Live, {'server': self})]

    def closing(self) -> None:
        """Close all websockets."""
        for client in tuple(self._clients):
            client.close(1001, 'the server ends')

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

    def _wake_all(self) -> None:
        self._awake = False
        for client in self._clients:
            client.news.set()


class Live(Guarded, WebSocketHandler):
    """A browser; ``news`` is to be set when there is something new to send."""

    def initialize(self, server: Server, **given: Any) -> None:
        """Start without frames in transit."""
        super().initialize(server, **given)
        self.news = asyncio.Event()
        self._status = ''
        self._obeyed = self._said_obeyed = True
        self._is_out = False
        self._second, self._count = 0.0, 0
        # By existing camera; names that a page sends are not stored.
        self._sent: dict[str, ViewedFrame] = {}
        self._undrawn: dict[str, int] = {}

    def prepare(self) -> None:
        """Accept allowed connections up to the limit."""
        super().prepare()
        if self.server.is_full:
            raise HTTPError(503, reason=f'{_MOST_PAGES} pages are open: close one')

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

    async def on_message(self, message: str | bytes) -> None:
        """Handle a message of the page."""
        # Messages of the other pages come in between.
        await asyncio.sleep(0)
        if self._is_out:
            return
        source = self.server.source
        try:
            self._check_pace()
            asked = parse(message)
        except InputError as error:
            source.complain(f'page at {self.request.remote_ip}: {error}')
            # What it has sent meanwhile is not obeyed.
            self._is_out = True
            source.leave(self)
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

    def _check_pace(self) -> None:
        now = time.monotonic()
        if now - self._second > 1:
            self._second, self._count = now, 0
        self._count += 1
        if self._count > _MOST_MESSAGES:
            raise InputError(
                f'messages: must be at most {_MOST_MESSAGES} a second, got more; it is closed'
            )

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
