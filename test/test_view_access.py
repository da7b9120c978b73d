"""Who may open the page when it is served beyond this machine: a real process, a real browser."""

from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from browser import chromium
from flexx2_sim_ros.view.access import Access, address, is_loopback, new_token
import pytest
from tornado.httpclient import HTTPClientError
from views import connect, run, View


@pytest.fixture(scope='module')
def view(ros, tmp_path_factory):
    """Serve to all."""
    made = View(
        tmp_path_factory.mktemp('view'), '--host', '0.0.0.0', '--cmd-vel', '/view_access/cmd_vel'
    )
    yield made
    assert made.end() == 130
    assert made.errors == (
        'warning: --host 0.0.0.0: everybody who has this address can drive the robot\n'
    )


def code_of(url, **headers):
    try:
        with urlopen(Request(url, headers=headers)) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_the_printed_address_opens_the_page(view, tmp_path_factory):
    with chromium(tmp_path_factory.mktemp('browser')) as page:
        page.open(view.url)
        page.until('document.getElementById("connection").textContent === "live"')
        # Scripts and the like came by the cookie, which the page itself cannot read.
        assert page.evaluate('document.cookie') == ''
        assert page.said('Runtime.exceptionThrown') == []
        bare = view.url.partition('?')[0]
        page.open(bare)
        page.until('document.getElementById("connection").textContent === "live"')
    with chromium(tmp_path_factory.mktemp('stranger')) as stranger:
        stranger.open(bare)
        assert stranger.evaluate('document.body.textContent').startswith(
            '403: open the address that flexx2 view has printed'
        )


def test_nothing_is_served_without_the_token(view):
    parts = urlsplit(view.url)
    cookie = f'flexx2_view_{parts.port}'
    token = parts.query.partition('=')[2]
    bare = f'http://{parts.netloc}/'
    for path in ('', 'view.js', 'nothing', 'live'):
        assert code_of(bare + path) == 403
        assert code_of(f'{bare}{path}?token=') == 403
        assert code_of(f'{bare}{path}?token={token[:-1]}') == 403
        assert code_of(f'{bare}{path}?token=%E2%82%AC') == 403
        assert code_of(bare + path, Cookie=f'{cookie}={token}x') == 403
    assert code_of(f'{bare}view.js?token={token}') == 200
    assert code_of(f'{bare}view.js', Cookie=f'{cookie}={token}') == 200

    async def work():
        for url, headers in (
            (bare, {}),
            (f'{bare}?token=x', {}),
            (bare, {'Cookie': f'{cookie}=x'}),
        ):
            with pytest.raises(HTTPClientError) as error:
                await connect(url, **headers)
            assert error.value.code == 403
        (await connect(view.url)).close()
        (await connect(bare, Cookie=f'{cookie}={token}')).close()

    run(work())


def test_the_token_can_be_switched_off(ros, tmp_path):
    host = '0.0.0.0'
    view = View(tmp_path, '--host', host, '--no-token', '--cmd-vel', '/view_no_token/cmd_vel')
    assert '?' not in view.url
    assert code_of(view.url) == 200
    assert view.end() == 130
    assert view.errors == (
        f'warning: --host {host}: everybody who reaches this machine can drive the robot\n'
    )


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
    for host, expected in (
        ('localhost', True),
        ('127.0.0.1', True),
        ('127.1.2.3', True),
        ('::1', True),
        ('0.0.0.0', False),
        ('', False),
        ('robot', False),
    ):
        assert is_loopback(host) is expected
