"""Messages by ZeroMQ (package `pyzmq`, extra `io`): a socket that subscribes, and one that publishes."""

import time
from collections.abc import Sequence
from typing import Any

from motes.core.checks import need, refuse
from motes.live.message import LONGEST, Form
from motes.live.sink import Sink, line_of
from motes.live.source import Received, TextSource
from motes.live.udp import TOGETHER

WAITING = 100_000
"""Messages that may wait in a socket."""


class Subscription(TextSource):
    """What a socket elsewhere publishes; ZeroMQ connects again by itself. The last part of a message counts, so topics may be in front."""

    def __init__(self, name: str, form: Form, address: str):
        """Connect; the other side may come later.

        Raises:
            MissingExtraError: pyzmq is not installed.
            MotesError: the address is none.
        """
        super().__init__(name, form)
        self._zmq: Any = need("zmq", "io")
        self._socket = self._zmq.Context.instance().socket(self._zmq.SUB)
        self._socket.setsockopt(self._zmq.RCVHWM, WAITING)
        self._socket.setsockopt(self._zmq.MAXMSGSIZE, LONGEST)
        self._socket.setsockopt(self._zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(address)
        except self._zmq.ZMQError as reason:
            refuse(f"source {name}", "an address such as tcp://127.0.0.1:5006 or ipc://path", str(reason))

    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return the messages that came."""
        if not self._socket.poll(1e3 * timeout):
            return []
        found: list[tuple[bytes, int | None, float | None]] = []
        while len(found) < TOGETHER:
            try:
                found.append((self._socket.recv_multipart(self._zmq.NOBLOCK)[-1], None, time.monotonic()))
            except self._zmq.ZMQError:
                break
        return found

    def close(self) -> None:
        """Close the socket."""
        self._socket.close(0)


class Publisher(Sink):
    """Publishes records as JSON; who listens too slowly loses some."""

    def __init__(self, name: str, address: str):
        """Open the port.

        Raises:
            MissingExtraError: pyzmq is not installed.
            MotesError: the port is in use, or the address is none of this machine.
        """
        self.name = name
        zmq: Any = need("zmq", "io")
        self._socket = zmq.Context.instance().socket(zmq.PUB)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as reason:
            self._socket.close(0)
            refuse(f"sink {name}", "an address of this machine with a free port, such as tcp://*:5006", str(reason))

    def write(self, record: dict[str, Any]) -> None:
        """Publish a record."""
        self._socket.send(line_of(record))

    def close(self) -> None:
        """Close the socket, a second later at most."""
        self._socket.close(1000)
