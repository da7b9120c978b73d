"""
Who may open the page: whoever has it can drive a robot.

The Host of a request has to be an address or a name of this machine (another name can be made to
point here by whoever owns it), and the Origin of a websocket has to be that host. Beyond this
machine a token is asked for as well: the address that `flexx2 view` prints carries it, and a
cookie keeps it for what the page loads.
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
    What a request has to bring.

    Attributes
    ----------
    host : str
        What the server is bound to.
    token : str
        What has to be in the query or the cookie; empty when nothing has to.

    """

    host: str
    token: str = ''

    def is_own(self, host: str) -> bool:
        """Say whether a request's Host is this machine, by an address or a name of its own."""
        try:
            name = (urlsplit(f'//{host}').hostname or '').lower()
            if name in ('localhost', socket.gethostname().lower(), self.host.lower()):
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def admits(self, given: str | None) -> bool:
        """Say whether this is the token, in a time that does not tell how much of it is."""
        return not self.token or hmac.compare_digest(
            (given or '').encode(errors='replace'), self.token.encode()
        )


def new_token() -> str:
    """Return a token that nobody can guess, of characters that need no quoting in an address."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def is_loopback(host: str) -> bool:
    """Say whether a name or an address is reached from this machine alone."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def address(host: str, port: int, token: str) -> str:
    """Return the page's address."""
    query = f'?token={token}' if token else ''
    return f'http://{f"[{host}]" if ":" in host else host}:{port}/{query}'
