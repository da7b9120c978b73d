"""A headless Chromium, driven over its DevTools protocol."""

import asyncio
from contextlib import contextmanager
import itertools
import json
import shutil
import subprocess
import time
from urllib.request import urlopen

import pytest
from tornado.websocket import websocket_connect

_NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
_PATIENCE = 60.0
# No GPU, no sandbox (there is none as root), nothing of its own that asks the network.
_OPTIONS = (
    '--headless=new',
    '--no-sandbox',
    '--disable-gpu',
    '--remote-debugging-port=0',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--disable-default-apps',
    '--disable-dev-shm-usage',
    '--window-size=1280,800',
)


class Browser:
    """
    A page.

    `events`: what the browser has reported, in its protocol's words.
    """

    def __init__(self, port):
        """Take the page that the browser has opened."""
        self.events = []
        self._numbers = itertools.count(1)
        self._loop = asyncio.new_event_loop()
        with urlopen(f'http://127.0.0.1:{port}/json/list') as answer:
            page = next(page for page in json.load(answer) if page['type'] == 'page')
        self._socket = self._run(lambda: websocket_connect(page['webSocketDebuggerUrl']))
        for domain in ('Page', 'Runtime', 'Log'):
            self.call(f'{domain}.enable')

    def _run(self, begin):
        async def wait():
            return await asyncio.wait_for(begin(), _PATIENCE)

        return self._loop.run_until_complete(wait())

    def call(self, method, **parameters):
        """Call the protocol; return its result."""
        number = next(self._numbers)
        message = json.dumps({'id': number, 'method': method, 'params': parameters})
        self._run(lambda: self._socket.write_message(message))
        while True:
            answer = json.loads(self._run(self._socket.read_message))
            if answer.get('id') == number:
                assert 'error' not in answer, answer
                return dict(answer['result'])
            self.events.append(answer)

    def open(self, url):  # noqa: A003
        """Go to a page and wait until it is there."""
        self.call('Page.navigate', url=url)
        self.until('document.readyState === "complete"')

    def evaluate(self, script):
        """Return what a script's value is."""
        result = self.call(
            'Runtime.evaluate', expression=script, returnByValue=True, awaitPromise=True
        )
        assert 'exceptionDetails' not in result, result
        return result['result'].get('value')

    def until(self, script):
        """Return the script's value once that is true."""
        deadline = time.monotonic() + _PATIENCE
        while not (value := self.evaluate(script)):
            assert time.monotonic() < deadline, script
            time.sleep(0.02)  # Asking without a pause would keep the page busy.
        return value

    def key(self, kind, code, key, **more):
        """Press (keyDown) or release (keyUp) a key."""
        self.call('Input.dispatchKeyEvent', type=kind, code=code, key=key, **more)

    def press(self, code, key='', **more):
        """Press a key and release it."""
        for kind in ('keyDown', 'keyUp'):
            self.key(kind, code, key or code, **more)

    def enter(self, element, value, event='input'):
        """Give a control, by its script, a value, as a user does."""
        self.evaluate(
            f'(() => {{ const control = {element}; control.value = {json.dumps(value)};'
            f'control.dispatchEvent(new Event("{event}")); }})()'
        )

    def box(self, element):
        """Return an element's left, top, width and height, pixels."""
        return self.evaluate(
            f'(() => {{ const box = {element}.getBoundingClientRect();'
            'return [box.left, box.top, box.width, box.height]; })()'
        )

    def resize(self, width=1280, height=800):
        """Change the size of the window, pixels."""
        size = {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': False}
        self.call('Emulation.setDeviceMetricsOverride', **size)

    def said(self, method):
        """Return what the browser has reported under a name."""
        return [event['params'] for event in self.events if event.get('method') == method]

    def close(self):
        """Leave the page."""

        async def leave():
            self._socket.close()

        self._run(leave)
        self._loop.close()


@contextmanager
def chromium(folder):
    """Start a browser that ends with the block; skip where there is none."""
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        pytest.skip('no Chromium or Chrome is installed')
    with (folder / 'browser.log').open('wb') as log:
        process = subprocess.Popen(
            [found, *_OPTIONS, f'--user-data-dir={folder / "profile"}', 'about:blank'],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
    page = None
    try:
        written = folder / 'profile' / 'DevToolsActivePort'
        deadline = time.monotonic() + _PATIENCE
        while not (written.exists() and '\n' in written.read_text()):
            assert process.poll() is None, (folder / 'browser.log').read_text()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        page = Browser(int(written.read_text().split()[0]))
        yield page
    finally:
        if page is not None:
            page.close()
        process.terminate()
        process.wait(30)
