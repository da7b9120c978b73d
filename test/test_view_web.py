"""Who may open the page, from this machine or another; and what the page computes."""

from browser import chromium
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.view.access import Access, address, is_loopback, new_token
from flexx2_sim_ros.view.packing import pack, ViewedFrame
import numpy as np
from programs import until
import pytest
from tornado.httpclient import HTTPClientError
from views import answer_of, connect, connect_to, run, save_walk, serve_source, View

LIVE = 'document.getElementById("connection").textContent === "live"'


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp('browser')) as browser:
        yield browser


@pytest.fixture
def served():
    with serve_source() as pair:
        yield pair


@pytest.mark.parametrize(
    ('origin', 'host'),
    [
        ('http://evil.example', ''),
        ('https://127.0.0.1', ''),
        ('http://localhost:3000', ''),
        ('null', ''),
        ('http://evil.example', 'evil.example'),
        ('http://evil.example:{port}', 'evil.example:{port}'),
        ('http://127.0.0.1.evil.example:{port}', '127.0.0.1.evil.example:{port}'),
    ],
)
def test_a_page_from_elsewhere_is_refused(served, origin, host):
    server, source = served

    async def work():
        with pytest.raises(HTTPClientError) as error:
            await connect_to(
                server, origin.format(port=server.port), host.format(port=server.port)
            )
        assert error.value.code == 403

    run(work())
    assert source.asked == []


@pytest.mark.parametrize(
    'host',
    [
        'localhost:{port}',
        '127.0.0.1:{port}',
        '[::1]:{port}',
        'localhost:9000',
        '192.168.1.7:{port}',
    ],
)
def test_requests_to_the_machines_own_addresses_are_accepted(served, host):
    server, _ = served
    host = host.format(port=server.port)

    async def work():
        (await connect_to(server, f'http://{host}', host)).close()

    run(work())


DISTORTIONS = (
    (0.0,) * 5,
    (-0.25, 0.05, 0.001, -0.002, 0.0),
    (2.0, 0.0, 0.0, 0.0, 0.0),  # The corners cannot be inverted.
    (2.0, 1.3, 0.001, -0.002, 0.07, 2.4, 2.0, 0.37),
)


def test_the_point_cloud_is_undistorted(served, browser):
    browser.open(f'http://127.0.0.1:{served[0].port}/')
    for distortion in DISTORTIONS:
        camera = Intrinsics(56, 43, 52.6, 53.2, 27.1, 21.4, distortion)
        frame = ViewedFrame(1, 0, np.ones((43, 56), np.float32), None, camera)
        message = pack('left', frame)
        head = message[4 : 4 + int.from_bytes(message[:4], 'little')].decode()
        rays = browser.evaluate(
            f'import("/rays.js").then(({{ Rays }}) => {{'
            f'const {{ x, y }} = new Rays().of({head});'
            'return [x, y].map((part) => Array.from(part, String)); })'
        )
        found = np.array(rays, float).reshape(2, 43, 56)
        np.testing.assert_allclose(found, pixel_rays(camera), atol=1e-6)


@pytest.fixture
def guarded():
    """Serve to other machines, too; return the address without the token, and the token."""
    token = new_token()
    with serve_source(Access('0.0.0.0', token)) as (server, _):
        yield f'http://127.0.0.1:{server.port}/', token


def test_the_address_with_the_token_opens_the_page(guarded, browser):
    bare, token = guarded
    browser.open(f'{bare}?token={token}')
    browser.until(LIVE)
    # Scripts and the like came by the cookie, which the page itself cannot read.
    assert browser.evaluate('document.cookie') == ''
    assert browser.said('Runtime.exceptionThrown') == []
    browser.open(bare)
    browser.until(LIVE)
    browser.call('Network.clearBrowserCookies')
    browser.open(bare)
    said = browser.evaluate('document.body.textContent')
    assert said.startswith('403: open the address that flexx2 view has printed')


def code_of(url, **headers):
    return answer_of(url, **headers)[0]


def test_nothing_is_served_without_the_token(guarded):
    bare, token = guarded
    cookie = f'flexx2_view_{bare.rpartition(":")[2][:-1]}'
    for path in ('', 'view.js', 'nothing', 'live'):
        assert code_of(bare + path) == 403
        assert code_of(f'{bare}{path}?token=') == 403
        assert code_of(f'{bare}{path}?token={token[:-1]}') == 403
        assert code_of(f'{bare}{path}?token=%E2%82%AC') == 403
        assert code_of(bare + path, Cookie=f'{cookie}={token}x') == 403
    assert code_of(f'{bare}view.js?token={token}') == 200
    assert code_of(f'{bare}view.js', Cookie=f'{cookie}={token}') == 200

    async def work():
        for url, given in ((bare, {}), (f'{bare}?token=x', {}), (bare, {'Cookie': f'{cookie}=x'})):
            with pytest.raises(HTTPClientError) as error:
                await connect(url, **given)
            assert error.value.code == 403
        (await connect(f'{bare}?token={token}')).close()
        (await connect(bare, Cookie=f'{cookie}={token}')).close()

    run(work())


@pytest.mark.parametrize(
    ('words', 'warning'),
    [
        (['--cmd-vel', '/view_web/cmd_vel'], 'has this address can drive the robot'),
        (['--no-token', 'walk.npz'], 'reaches this machine can see these recordings'),
    ],
)
def test_the_printed_address_has_the_token(ros, tmp_path, monkeypatch, words, warning):
    monkeypatch.chdir(tmp_path)
    save_walk('walk.npz')
    with View(tmp_path, '--host', '0.0.0.0', *words) as view:
        assert ('?token=' in view.url) == ('--no-token' not in words)
        assert code_of(view.url) == 200
        until(lambda: view.errors, 'the warning')
        assert view.end() == 130
    assert view.errors == f'warning: --host 0.0.0.0: everybody who {warning}\n'


def test_tokens():
    token = new_token()
    assert token != new_token()
    assert len(token) >= 20
    asks = Access('0.0.0.0', token)
    assert asks.admits(token)
    assert not any(asks.admits(given) for given in (None, '', 'x', token + ' ', '\ud800', 'é'))
    assert Access('127.0.0.1').admits(None)
    assert address('::1', 80, '') == 'http://[::1]:80/'
    assert address('robot', 80, 'a') == 'http://robot:80/?token=a'
    assert all(map(is_loopback, ('localhost', '127.0.0.1', '127.1.2.3', '::1')))
    assert not any(map(is_loopback, ('0.0.0.0', '', 'robot')))
