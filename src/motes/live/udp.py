"""Datagrams: each is a message, or several lines of them."""

import contextlib
import select
import socket
import time
from collections.abc import Sequence

from motes.core.checks import refuse
from motes.live.counts import LOG
from motes.live.message import LONGEST, Form
from motes.live.source import Received, TextSource

BUFFER = 1 << 23
"""Bytes of the system's buffer that are asked for; it may give less."""
TOGETHER = 1000
"""Datagrams that are handed on at a time."""


class Datagrams(TextSource):
    """Datagrams at an address and port of this machine."""

    def __init__(self, name: str, form: Form, host: str, port: int):
        """Open the port; one that the system chose is told.

        Raises:
            MotesError: it is in use, or the address is none of this machine.
        """
        super().__init__(name, form)
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
        except OSError as reason:
            refuse(f"source {name}", "an address of this machine", reason.strerror or str(reason))
        try:
            self._socket.bind(address)
        except OSError as reason:
            self._socket.close()
            refuse(f"source {name}", "an address of this machine with a free port", reason.strerror or str(reason),
                   "Another program may listen there: ss -ulpn tells which.")  # fmt: skip
        if port == 0:
            LOG.info("source %s listens at port %d.", name, self.port)
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)

    @property
    def port(self) -> int:
        """The port that is listened at."""
        return self._socket.getsockname()[1]

    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return the lines of the datagrams that came."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        found: list[Received] = []
        while len(found) < TOGETHER:
            try:
                datagram = self._socket.recv(LONGEST)
            except OSError:
                break
            arrived = time.monotonic()
            found += [(line, None, arrived) for line in datagram.split(b"\n")]
        return found

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
