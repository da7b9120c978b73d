"""
The page on recordings: it asks for one frame after the other.

The server keeps nothing about its pages: a request names recording, camera, frame and reference.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import socket
from typing import Any

from flexx2_sim_ros.errors import InputError, printable
from flexx2_sim_ros.truth.files import names_of
from flexx2_sim_ros.view.access import Access, Outline, parse
from flexx2_sim_ros.view.outlines import drawn, save_outline
from flexx2_sim_ros.view.packing import pack, ViewedFrame
from flexx2_sim_ros.view.recorded import RecordedCamera, REFERENCES
from flexx2_sim_ros.view.web import File, Guarded, WebServer
from tornado.web import HTTPError

# Requests that wait for the only thread that reads files. A page has one for each camera.
_MOST_WAITING = 100


class PlaybackServer(WebServer):
    """
    Serve the page with recordings.

    ``recordings`` are the cameras of each recording, by its name (as an attribute a list, in
    order, with `names` beside it), ``headline`` is what the page says of all of them. ``planes``
    is the file that outlines drawn on the page are saved to; None: nothing is drawn. ``waiting``
    counts the requests for frames that are not answered yet.
    """

    def __init__(
        self,
        sockets: list[socket.socket],
        access: Access,
        recordings: Mapping[str, Sequence[RecordedCamera]],
        headline: str = '',
        planes: Path | None = None,
    ) -> None:
        """Describe the recordings for the page."""
        self.planes = planes
        self.names = [Path(one).stem for one in names_of([Path(name) for name in recordings])]
        table = {
            'headline': headline,
            'recordings': [
                {'name': printable(name), 'cameras': [camera.describe() for camera in cameras]}
                for name, cameras in recordings.items()
            ],
            'planes': None if planes is None else drawn(planes, self.names),
        }
        super().__init__(sockets, access, table)
        self.recordings = list(recordings.values())
        self.waiting = 0
        self._worker = ThreadPoolExecutor(1)

    def routes(self) -> list[Any]:
        """Return the routes of frames and of outlines."""
        given = {'server': self}
        saved = [] if self.planes is None else [('/outline', OutlineRequest, given)]
        return [('/frame', FrameRequest, given), *saved]

    def closing(self) -> None:
        """Drop the requests that wait."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    async def work(self, task: Callable[[], bytes]) -> bytes:
        """Run a task in the thread that reads files; one at a time."""
        if self.waiting >= _MOST_WAITING:
            raise HTTPError(503, reason='too many requests for frames')
        self.waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._worker, task)
        finally:
            self.waiting -= 1


class FrameRequest(File):
    """A frame of a camera of a recording, and what it is compared with."""

    async def get(self) -> None:  # type: ignore[override]
        """Answer with the bytes of `packing`, or with the reason why not."""
        server: PlaybackServer = self.server
        cameras = server.recordings[self._number('recording', len(server.recordings))]
        camera = cameras[self._number('camera', len(cameras))]
        number = self._number('number', camera.count)
        reference = self.get_query_argument('reference', '')
        if reference not in ('', *REFERENCES):
            raise HTTPError(400, reason='reference: must be one that the page offers')
        try:
            body = await server.work(lambda: _packed(camera, number, reference))
        except InputError as error:
            self.set_status(500)
            self.set_header('Content-Type', 'text/plain; charset=utf-8')
            self.finish(printable(str(error)))
            return
        self.set_header('Content-Type', 'application/octet-stream')
        self.finish(body)

    def _number(self, name: str, below: int) -> int:
        text = self.get_query_argument(name, '')
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) < below):
            raise HTTPError(400, reason=f'{name}: must be 0 to {below - 1}')
        return int(text)


class OutlineRequest(Guarded):
    """An outline to save."""

    def post(self) -> None:
        """Write it into the file of planes; answer with the reason where that is not possible."""
        server: PlaybackServer = self.server
        if not self.check_origin(self.request.headers.get('Origin', '')):
            raise HTTPError(403, reason='Origin is not this page')
        try:
            asked = parse(self.request.body.decode(errors='replace'))
            if not (isinstance(asked, Outline) and 0 <= asked.recording < len(server.names)):
                raise InputError('message: must be the outline of a plane, got another one')
            assert server.planes is not None
            name = server.names[asked.recording]
            save_outline(server.planes, name, asked.plane, asked.corners)
        except InputError as error:
            self.set_status(400)
            self.set_header('Content-Type', 'text/plain; charset=utf-8')
            self.finish(printable(str(error)))


def _packed(camera: RecordedCamera, number: int, reference: str) -> bytes:
    frame: ViewedFrame = camera.frame(number, reference)
    return pack(camera.name, frame)
