"""The web server of the page, without ROS: who may open it, and its files."""

from browser import chromium
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.view.packing import pack, ViewedFrame
import numpy as np
import pytest
from tornado.httpclient import HTTPClientError
from views import connect_to, run, serve_source


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


def test_the_point_cloud_is_undistorted(served, tmp_path):
    with chromium(tmp_path) as page:
        page.open(f'http://127.0.0.1:{served[0].port}/')
        for distortion in DISTORTIONS:
            camera = Intrinsics(56, 43, 52.6, 53.2, 27.1, 21.4, distortion)
            frame = ViewedFrame(1, 0, np.ones((43, 56), np.float32), None, camera)
            message = pack('left', frame)
            head = message[4 : 4 + int.from_bytes(message[:4], 'little')].decode()
            rays = page.evaluate(
                f'import("/rays.js").then(({{ Rays }}) => {{'
                f'const {{ x, y }} = new Rays().of({head});'
                'return [x, y].map((part) => Array.from(part, String)); })'
            )
            found = np.array(rays, float).reshape(2, 43, 56)
            np.testing.assert_allclose(found, pixel_rays(camera), atol=1e-6)
