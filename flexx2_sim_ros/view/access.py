"""
Who may open the page: whoever has it can drive a robot.

The Host of a request has to be an address or a name of this machine (another name can be made to
point here by whoever owns it), and the Origin of a websocket has to be that host.
"""

from dataclasses import dataclass
import ipaddress
import socket
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Access:
    """
    What a request has to bring.

    Attributes
    ----------
    host : str
        What the server is bound to.

    """

    host: str

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
