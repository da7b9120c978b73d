"""
Control who may open the page, because a page can drive a robot.

The Host of a request must be an address or a name of this machine, since the owner of another
name can let it point here (DNS rebinding). The Origin of a websocket must be that host. From other
machines a token is required, too: the address that `flexx2 view` prints contains it, and a cookie
keeps it for the files that the page loads.
"""

from dataclasses import dataclass
import hmac
import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

_TOKEN_BYTES = 16


@dataclass(frozen=True)
class Access:
    """
    The conditions that a request must meet.

    Attributes
    ----------
    host : str
        The address that the server is bound to.
    token : str
        Token required in the query or the cookie; empty if none is required.

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
