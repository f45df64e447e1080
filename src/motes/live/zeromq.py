"""Messages by ZeroMQ (package `pyzmq`, extra `io`): a socket that subscribes, and one that publishes."""

import os
import socket
import stat
import time
from collections.abc import Sequence
from typing import Any

from motes.core.checks import need, refuse
from motes.live.counts import LOG
from motes.live.message import LONGEST, Form
from motes.live.sink import Sink, line_of
from motes.live.source import Received, TextSource
from motes.live.udp import TOGETHER

WAITING = 100_000
"""Messages that may wait in a socket."""
LARGEST = 1 << 26
"""Bytes of a message beyond which the connection is given up; those that are only too long for us are counted."""
AGAIN = 1.0
"""Seconds after which a connection that ZeroMQ gave up is made anew."""


class Subscription(TextSource):
    """What a socket elsewhere publishes; connected again when it is lost. The last part of a message counts; topics may be in front."""

    def __init__(self, name: str, form: Form, address: str):
        """Connect; the other side may come later.

        Raises:
            MissingExtraError: pyzmq is not installed.
            MotesError: the address is none.
        """
        super().__init__(name, form)
        self._zmq: Any = need("zmq", "io")
        self._address, self._connections = address, 0
        self._broken: float | None = None
        self._connect()

    def _connect(self) -> None:
        self._socket = self._zmq.Context.instance().socket(self._zmq.SUB)
        self._socket.setsockopt(self._zmq.RCVHWM, WAITING)
        self._socket.setsockopt(self._zmq.MAXMSGSIZE, LARGEST)
        self._socket.setsockopt(self._zmq.SUBSCRIBE, b"")
        self._monitor = self._socket.get_monitor_socket()
        try:
            self._socket.connect(self._address)
        except self._zmq.ZMQError as reason:
            self.close()
            refuse(f"source {self.name}", "an address such as tcp://127.0.0.1:5006 or ipc://path", str(reason))

    def receive(self, timeout: float) -> Sequence[Received] | None:
        """Return the messages that came."""
        came = self._socket.poll(1e3 * timeout)
        self._look()
        if not came:
            if self._broken is not None and time.monotonic() > self._broken + AGAIN:
                self.close()
                self._broken = None
                self._connect()
            return []
        found: list[tuple[bytes, int | None, float | None]] = []
        while len(found) < TOGETHER:
            try:
                last = self._socket.recv_multipart(self._zmq.NOBLOCK)[-1]
            except self._zmq.ZMQError:
                break
            # one that is too long waits as short as can be until that is told
            found.append((last[: LONGEST + 1], None, time.monotonic()))
        return found

    def _look(self) -> None:
        """See what became of the connection: ZeroMQ tries again where it was closed, but not where something came that it cannot read."""
        from zmq.utils.monitor import recv_monitor_message

        while self._monitor.poll(0):
            event = recv_monitor_message(self._monitor)["event"]
            if event == self._zmq.EVENT_DISCONNECTED:
                self._broken = time.monotonic()
            elif event == self._zmq.EVENT_CONNECT_RETRIED:
                self._broken = None
            elif event == self._zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._connections += 1
                if self._connections > 1:
                    self.counts.add("reconnected", f"{self.name}: connected again; what was published in between is lost.")

    def close(self) -> None:
        """Close the socket."""
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close(0)


class Publisher(Sink):
    """Publishes records as JSON; who listens too slowly loses some."""

    def __init__(self, name: str, address: str):
        """Open the port; one that the system chose is told.

        Raises:
            MissingExtraError: pyzmq is not installed.
            MotesError: the port or the path is in use, or the address is none of this machine.
        """
        self.name = name
        zmq: Any = need("zmq", "io")
        if address.startswith("ipc://"):
            _check_path(name, address.removeprefix("ipc://"))
        # of its own: its end waits for what is still to be sent
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as reason:
            self._socket.close(0)
            self._context.term()
            refuse(f"sink {name}", "an address of this machine with a free port, such as tcp://*:5006, or ipc://PATH", str(reason))
        if address.endswith((":0", "*")):
            LOG.info("sink %s publishes at %s", name, self._socket.getsockopt(zmq.LAST_ENDPOINT).rstrip(b"\0").decode())

    def write(self, record: dict[str, Any]) -> None:
        """Publish a record."""
        self._socket.send(line_of(record))

    def close(self) -> None:
        """Close the socket once all was sent, a second later at most."""
        self._socket.close(1000)
        self._context.term()


def _check_path(name: str, path: str) -> None:
    """Refuse a path with anything but a socket that nobody listens at: ZeroMQ would remove it and take its place."""
    if path.startswith(("@", "*")) or not os.path.lexists(path):
        return
    expected = "a path that is free"
    if not stat.S_ISSOCK(os.lstat(path).st_mode):
        refuse(f"sink {name}", expected, "one with a file or folder", "Name another, or move that away.")
    with socket.socket(socket.AF_UNIX) as asks:
        try:
            asks.connect(path)
        except ConnectionRefusedError:
            # of a run that was killed
            return
        except OSError as reason:
            refuse(f"sink {name}", expected, reason.strerror or str(reason))
    refuse(f"sink {name}", expected, "one where another run publishes", "Name another, or end the other run.")
