"""Protocols of uvicorn that write nothing to any log: a line about a request would hold its token or its cookie."""

import logging
from typing import Any

from motes.core.checks import need

QUIET = logging.getLogger("motes.watch.quiet")
QUIET.propagate = False
QUIET.setLevel(logging.CRITICAL + 1)


def protocols() -> tuple[type, type]:
    """Return the classes that uvicorn makes of a connection, for requests and for sockets.

    Raises:
        MissingExtraError: the packages that serve a page are not installed.
    """
    requests = need("uvicorn.protocols.http.h11_impl", "dashboard").H11Protocol
    sockets = need("uvicorn.protocols.websockets.websockets_sansio_impl", "dashboard").WebSocketsSansIOProtocol

    class Requests(requests):
        def __init__(self, *arguments: Any, **named: Any):
            super().__init__(*arguments, **named)
            self.logger, self.access_log = QUIET, False

    class Sockets(sockets):
        def __init__(self, *arguments: Any, **named: Any):
            super().__init__(*arguments, **named)
            self.logger = self.conn.logger = QUIET
            self.conn.debug = False

    return Requests, Sockets


def is_waiting(connection: Any) -> bool:
    """Tell whether a connection has not asked for anything that is answered, or been accepted as a socket."""
    accepted = getattr(connection, "handshake_complete", None)
    return getattr(connection, "cycle", None) is None if accepted is None else not accepted
