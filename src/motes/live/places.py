"""Sources and sinks by their addresses, as a user gives them."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO
from urllib.parse import SplitResult, parse_qs, urlsplit

from motes.core.checks import refuse
from motes.live.json_lines import to_file, to_open
from motes.live.lines import Lines, Serial, of_file
from motes.live.message import Form
from motes.live.parquet import Parquet
from motes.live.sink import Sink
from motes.live.source import Source
from motes.live.udp import Datagrams
from motes.live.zeromq import Publisher, Subscription

SOURCES = '"-" for standard input, a file of JSON lines, udp://HOST:PORT, tcp://HOST:PORT or ipc://PATH (ZeroMQ), or serial://DEVICE?baud=N'
SINKS = '"-" for standard output, a file of JSON lines, a folder NAME.parquet, or tcp://HOST:PORT or ipc://PATH (ZeroMQ)'


def source_at(address: str, form: Form) -> Source:
    """Open a source of text.

    Raises:
        MotesError: the address is none, is in use, or cannot be read.
    """
    if address == "-":
        return Lines("standard input", form, _standard("source", sys.stdin))
    kind, host, port, parts = _taken_apart("source", address, SOURCES)
    if kind == "udp":
        if host is None or port is None:
            refuse(f"source {address}", "udp://HOST:PORT, such as udp://127.0.0.1:5005", "no host or port")
        return Datagrams(address, form, host, port)
    if kind in ("tcp", "ipc"):
        return Subscription(address, form, address)
    if kind == "serial":
        baud = parse_qs(parts.query).get("baud", ["9600"])[0]
        if not baud.isdecimal():
            refuse(f"source {address}", "a number after baud=", baud[:40])
        return Serial(address, form, parts.netloc + parts.path, int(baud))
    if kind:
        refuse(f"source {address}", SOURCES, f"{kind}://")
    return of_file(address, form)


def sink_at(address: str) -> Sink:
    """Open a sink.

    Raises:
        MotesError: the address is none, is in use, or cannot be written.
    """
    if not address:
        refuse("sink", SINKS, "''", 'Give --live.sinks "-" for standard output.')
    if address == "-":
        return to_open("standard output", _standard("sink", sys.stdout))
    kind = _taken_apart("sink", address, SINKS)[0]
    if kind in ("tcp", "ipc"):
        return Publisher(address, address)
    if kind:
        refuse(f"sink {address}", SINKS, f"{kind}://")
    return Parquet(address) if address.rstrip("/").endswith(".parquet") else to_file(address)


def sinks_at(addresses: Sequence[str], *sources: str) -> list[Sink]:
    """Open several sinks, all different, and none the file of a source; where one cannot be opened, none is left open."""
    found: list[Sink] = []
    known: set[str] = set()
    try:
        for address in addresses:
            if any(Path(source).is_file() and Path(address).is_file() and os.path.samefile(source, address) for source in sources):
                refuse(f"sink {address}", "another file than the source", "the same", "It would read what it writes.")
            place = os.path.realpath(address) if "://" not in address and address not in ("", "-") else address
            if place in known:
                refuse("sinks", "addresses that differ", f"{address} twice")
            known.add(place)
            found.append(sink_at(address))
    except Exception:
        for sink in found:
            sink.close()
        raise
    return found


def _standard(what: str, stream: TextIO | None) -> int:
    """Return a copy of the file of a standard stream, which Python has as None where it is closed."""
    if stream is None:
        refuse(f"{what} -", "an open standard stream", "one that is closed")
    return os.dup(stream.fileno())


def _taken_apart(what: str, address: str, expected: str) -> tuple[str, str | None, int | None, SplitResult]:
    """Return kind, host, port and all of an address; a path has no kind."""
    try:
        parts = urlsplit(address)
        return (parts.scheme if "://" in address else ""), parts.hostname, parts.port, parts
    except ValueError as reason:
        refuse(f"{what} {address[:80]}", expected, str(reason))
