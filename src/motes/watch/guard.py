"""Who may look: the checks that every request passes before anything is answered, and every socket before it is accepted.

1. Host must be an address that we listen at: a name that somebody else's server resolves to this machine is refused (DNS rebinding).
2. Origin, of a socket, must be the page itself; `null`, none and any other are refused.
3. The token of the link, 256 random bits, is exchanged once for a cookie (HttpOnly, SameSite=Strict); everything else asks for that.
"""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie

BYTES = 32
"""Of a token: 256 bits."""
SESSIONS = 256
"""Cookies that are known at a time; the oldest goes."""


class Guard:
    """The checks of one page."""

    def __init__(self, host: str, port: int):
        """Guard what listens at an address and port."""
        self.host, self.port = host, port
        self.token = secrets.token_urlsafe(BYTES)
        # cookies know no ports: pages of one machine must not take each other's
        self.cookie = f"motes_{port}"
        self._sessions: dict[str, None] = {}

    def knows_host(self, headers: Mapping[str, str]) -> bool:
        """Tell whether a request was meant for us, by its Host."""
        name, _, port = headers.get("host", "").rpartition(":")
        if port != str(self.port):
            return False
        if name.startswith("[") and name.endswith("]"):
            name = name[1:-1]
        if name.lower() == "localhost":
            return is_loopback(self.host) or is_any(self.host)
        try:
            asked = ipaddress.ip_address(name)
        except ValueError:
            return not is_loopback(self.host) and name.lower() == socket.gethostname().lower()
        # an address cannot be rebound, as a name can
        return is_any(self.host) or (asked.is_loopback if is_loopback(self.host) else str(asked) == self.host)

    def knows_origin(self, headers: Mapping[str, str]) -> bool:
        """Tell whether a socket is asked for by our own page."""
        return headers.get("origin", "") == f"http://{headers.get('host', '')}"

    def takes(self, token: str) -> str | None:
        """Return the cookie that a token is exchanged for; None of a wrong one."""
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return None
        for oldest in list(self._sessions)[: len(self._sessions) + 1 - SESSIONS]:
            self._sessions.pop(oldest)
        session = secrets.token_urlsafe(BYTES)
        self._sessions[session] = None
        return session

    def is_known(self, headers: Mapping[str, str]) -> bool:
        """Tell whether a request brings a cookie that we gave."""
        try:
            found = SimpleCookie(headers.get("cookie", "")[:4096]).get(self.cookie)
        except CookieError:
            return False
        given = b"" if found is None else found.value.encode()
        return any([hmac.compare_digest(given, session.encode()) for session in self._sessions])


def is_loopback(host: str) -> bool:
    """Tell whether an address is this machine's own, which others do not reach."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_any(host: str) -> bool:
    """Tell whether an address stands for all addresses of this machine."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
