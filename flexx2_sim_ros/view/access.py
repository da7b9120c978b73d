"""
Control who may open the page, because a page can drive a robot.

The Host of a request must be an address or a name of this machine, since the owner of another
name can let it point here (DNS rebinding). The Origin of a websocket must be that host. From other
machines a token is required, too: the address that `flexx2 view` prints contains it, and a cookie
keeps it for the files that the page loads. The messages of a page are decoded and checked here.
"""

from dataclasses import dataclass
import hmac
import ipaddress
import json
import math
import secrets
import socket
from urllib.parse import urlsplit

from flexx2_sim_ros.errors import InputError, shown

_TOKEN_BYTES = 16


@dataclass(frozen=True)
class Access:
    """
    The conditions that a request must meet.

    ``host`` is the address that the server is bound to, ``token`` the one required in the query or
    the cookie; empty if none is required.
    """

    host: str
    token: str = ''

    def is_own(self, host: str) -> bool:
        """Return whether a request's Host is an address or a name of this machine."""
        try:
            name = (urlsplit(f'//{host}').hostname or '').lower()
            if name in ('localhost', socket.gethostname().lower(), self.host.lower()):
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def admits(self, given: str | None) -> bool:
        """Return whether this is the token; the comparison takes constant time."""
        return not self.token or hmac.compare_digest(
            (given or '').encode(errors='replace'), self.token.encode()
        )


def new_token() -> str:
    """Return a random token of characters that need no quoting in an address."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def is_loopback(host: str) -> bool:
    """Return whether a name or an address is reachable only from this machine."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def address(host: str, port: int, token: str) -> str:
    """Return the page's address."""
    query = f'?token={token}' if token else ''
    return f'http://{f"[{host}]" if ":" in host else host}:{port}/{query}'


# In characters. Camera names are ROS names, modes are shorter.
_LONGEST_NAME = 256


@dataclass(frozen=True)
class Drawn:
    """A page has drawn a frame of a camera."""

    camera: str


@dataclass(frozen=True)
class Drive:
    """
    A page drives the robot, at finite velocities; zeros stop.

    They are forward and to the left in m/s, turn to the left in rad/s.
    """

    velocity: tuple[float, float, float]


@dataclass(frozen=True)
class Choose:
    """A page requests a mode, printable, of a camera."""

    camera: str
    usecase: str


@dataclass(frozen=True)
class Adjust:
    """
    A page requests the strength, finite, of an effect, printable.

    The camera's node refuses what it cannot take.
    """

    camera: str
    effect: str
    strength: float


@dataclass(frozen=True)
class Outline:
    """
    A page saves the outline of a plane.

    ``recording`` is its number, ``plane`` is printable, corners are pixels [u, v]; finite.
    """

    recording: int
    plane: str
    corners: tuple[tuple[float, float], ...]


def parse(message: str | bytes) -> Drawn | Drive | Choose | Adjust | Outline:
    """
    Decode a message of the page.

    Raises InputError, with a text of one line, when it is not a message of the page.
    """
    try:
        match json.loads(message) if isinstance(message, str) else None:
            case {'drawn': str(camera)} if _is_name(camera):
                return Drawn(camera)
            case {'drive': [x, y, turn]}:
                return Drive((_number(x), _number(y), _number(turn)))
            case {'usecase': [str(camera), str(usecase)]} if _is_name(camera) and _is_name(
                usecase
            ):
                return Choose(camera, usecase)
            case {'effect': [str(camera), str(effect), strength]} if _is_name(camera) and _is_name(
                effect
            ):
                return Adjust(camera, effect, _number(strength))
            case {'outline': [int(recording), str(plane), list(corners)]} if _is_name(plane):
                pixels = tuple((_number(u), _number(v)) for u, v in corners)
                return Outline(recording, plane, pixels)
    # Raised for deep nesting, and for whole numbers too large for a float.
    except (ValueError, TypeError, RecursionError, OverflowError):
        pass
    raise InputError(f'message: must be JSON as the page sends it, got {shown(message)}')


def _is_name(text: str) -> bool:
    return len(text) <= _LONGEST_NAME and text.isprintable()


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError
    number = float(value)
    if not math.isfinite(number):
        raise ValueError
    return number
