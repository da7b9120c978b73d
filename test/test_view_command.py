"""`flexx2 view`: ports, addresses and help, before any page is open."""

import socket
from typing import Any

from flexx2_sim_ros.cli.main import main
import pytest


def test_a_port_in_use_is_reported_before_anything_starts(
    capsys: pytest.CaptureFixture[str], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        assert main(['view', '--demo', '--no-browser', '--port', str(port)]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err == (
        f'flexx2: error: --port: must be free, or 0 for any, got {port}, which is in use '
        'on 127.0.0.1\n'
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--port', '70000'], '--port: must be a whole number from 0 to 65535'),
        (['--scene', 'lab'], '--scene: must be left out without --demo, got'),
        (['--port', '-1'], '--port: must be a whole number from 0 to 65535'),
        (
            ['--host', '203.0.113.1', '--port', '0'],
            "--host: must be an address of this machine, got '203.0.113.1'",
        ),
        (
            ['--host', 'no.such.host.invalid'],
            "--host: must be an address of this machine, got 'no.such.host.invalid'",
        ),
    ],
)
def test_an_invalid_address_is_reported(
    capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert main(['view', '--no-browser', *options]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count('\n') == 1


def test_help_names_what_shows_the_cameras(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match='0'):
        main(['--help'])
    said = ' '.join(capsys.readouterr().out.split())
    for word in ('view', 'RViz', 'flexx2.rviz', 'Foxglove', 'foxglove.json'):
        assert word in said
