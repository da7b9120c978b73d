"""`flexx2 view` as a process, and pages without a browser."""

import asyncio
from collections.abc import Coroutine
import os
from pathlib import Path
import select
import signal
import subprocess
import sys
from typing import Any
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

PATIENCE = 60.0


class View:
    """
    The command, running.

    Attributes
    ----------
    process : subprocess.Popen
    url : str
    folder : pathlib.Path
        Where its temporary files are.

    """

    def __init__(self, folder: Path, *options: str) -> None:
        """Start it and wait for its address."""
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get('PYTHONPATH')])]
        env = {**os.environ, 'PYTHONPATH': os.pathsep.join(paths), 'TMPDIR': str(folder)}
        self.folder, self._errors = folder, folder / 'view.log'
        with self._errors.open('wb') as log:
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    '-m',
                    'flexx2_sim_ros.cli.main',
                    'view',
                    '--no-browser',
                    '--port',
                    '0',
                    *options,
                ],
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], PATIENCE)[0], self.errors
        line = self.process.stdout.readline()
        assert line.endswith(' (Ctrl-C ends it)\n'), (line, self.errors)
        self.url = line.split()[0]

    @property
    def errors(self) -> str:
        """Return what it has written to stderr."""
        return self._errors.read_text()

    def end(self) -> int:
        """Press Ctrl-C; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def connect(url: str, **headers: str) -> Any:
    """Return a future of a websocket, as the page at this address opens it."""
    parts = urlsplit(url)
    return websocket_connect(
        HTTPRequest(
            parts._replace(scheme='ws', path='/live').geturl(),
            headers={'Origin': f'http://{parts.netloc}', 'Host': parts.netloc} | headers,
        )
    )


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run it; fail when it does not end."""

    async def bounded() -> None:
        await asyncio.wait_for(work, PATIENCE)

    asyncio.run(bounded())
