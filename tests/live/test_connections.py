"""Sockets and pipes of live runs: addresses that others use, who comes late and goes early, and what cannot be read."""

import contextlib
import json
import logging
import os
import socket
import subprocess
import sys
import time

import pytest

import motes as mo
from motes.live import json_lines, sink, zeromq
from motes.live.message import LONGEST, Form, Names
from motes.live.places import sink_at, sinks_at, source_at
from motes.live.sink import Guarded

MOST = 20.0
"""Seconds in which something must come."""


def heard(source, wanted, act=lambda: None):
    """The numbers of messages that come until the wanted one did; before each look something is done."""
    found, until = [], time.monotonic() + MOST
    while wanted not in found:
        assert time.monotonic() < until, found
        act()
        found += [one.number for received in source.receive(0.02) or [] if (one := source.understood(received)) is not None]
    return found


def text(k):
    return json.dumps({"time": 0.1 * k, "k": k, "a": 1.0}).encode()


def form():
    return Form(Names(("a",), number="k"))


def told(caplog):
    return [one.getMessage() for one in caplog.records]


def test_a_source_hears_on_after_what_is_too_long_and_what_is_no_zeromq(monkeypatch, caplog):
    """ZeroMQ gives a connection up for good where something comes that it cannot read."""
    zmq = pytest.importorskip("zmq")
    monkeypatch.setattr(zeromq, "AGAIN", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as rubbish:
        port = rubbish.getsockname()[1]
        source = source_at(f"tcp://127.0.0.1:{port}", form())
        rubbish.settimeout(0.05)
        # the greeting of ZeroMQ, and then none of its commands; who is sent that comes again
        greeting = b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48)
        taken, until = [], time.monotonic() + MOST
        while len(taken) < 2:
            assert not source.receive(0.02) and time.monotonic() < until
            with contextlib.suppress(TimeoutError):
                taken.append(rubbish.accept()[0])
                taken[-1].sendall(greeting + b"\x04\xffnonsense" * 50)
        for one in taken:
            one.close()
    publisher = zmq.Context.instance().socket(zmq.PUB)
    publisher.bind(f"tcp://127.0.0.1:{port}")
    heard(source, 1, lambda: publisher.send_multipart([b"topic", text(1)]))
    publisher.send(b"x" * (LONGEST + 100))
    publisher.send(text(2))
    assert 2 in heard(source, 2) and source.counts.of["unreadable"] == 1 and source.counts.of["reconnected"] == 0
    assert f"a message of {LONGEST + 1} bytes, expected at most {LONGEST}" in told(caplog)[-1]
    publisher.close(0)
    publisher, bound = zmq.Context.instance().socket(zmq.PUB), False
    while not bound and time.monotonic() < until:
        # it is closed by a thread
        with contextlib.suppress(zmq.ZMQError):
            bound = publisher.bind(f"tcp://127.0.0.1:{port}") is not None
    heard(source, 3, lambda: publisher.send(text(3)))
    assert source.counts.of["reconnected"] == 1 and "connected again; what was published in between is lost" in told(caplog)[-1]
    publisher.close(0)
    source.close()


def test_a_path_of_others_is_refused_and_one_of_a_run_that_was_killed_is_taken(tmp_path, monkeypatch):
    pytest.importorskip("zmq")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "thesis.tex").write_text("precious")
    (tmp_path / "link").symlink_to("thesis.tex")
    for address, why in (("ipc://thesis.tex", "got one with a file or folder. Name another"), ("ipc://link", "a file or folder"),
                         ("ipc://.", "a file or folder"), ("ipc://no/x", "No such file")):  # fmt: skip
        with pytest.raises(mo.MotesError, match=why):
            sink_at(address)
    assert (tmp_path / "thesis.tex").read_text() == "precious" and (tmp_path / "link").is_symlink()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind("stale")
    one = sink_at("ipc://stale")
    with pytest.raises(mo.MotesError, match="one where another run publishes. Name another, or end the other run"):
        sink_at("ipc://stale")
    one.close()
    sink_at("ipc://stale").close()


def test_what_was_published_is_sent_before_the_process_ends(tmp_path):
    zmq = pytest.importorskip("zmq")
    address = f"ipc://{tmp_path}/records"
    listener = zmq.Context.instance().socket(zmq.SUB)
    listener.setsockopt(zmq.SUBSCRIBE, b"")
    # most waits at the other side
    listener.setsockopt(zmq.RCVHWM, 1)
    listener.connect(address)
    process = subprocess.Popen([sys.executable, "-c", f"""
import os, sys
from motes.live.places import sink_at
out = sink_at({address!r})
while True:
    out.write({{"step": -1}})
    if sys.stdin.readline() == "heard\\n":
        break
for step in range(100):
    out.write({{"step": step, "much": "x" * 20_000}})
print("all", flush=True)
out.close()
os._exit(0)
"""], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)  # fmt: skip
    until = time.monotonic() + 2 * MOST
    while not listener.poll(50):
        assert time.monotonic() < until
        process.stdin.write("\n")
        process.stdin.flush()
    process.stdin.write("heard\n")
    process.stdin.flush()
    assert process.stdout.readline() == "all\n"
    # long enough to be gone for who does not wait
    time.sleep(0.3)
    steps = []
    while 98 not in steps and listener.poll(1000):
        steps.append(json.loads(listener.recv())["step"])
    # a listener without room drops the one at hand when the other side has gone
    assert {*range(98)} <= {*steps}
    process.communicate()
    listener.close(0)


def test_a_port_that_the_system_chose_is_told(caplog):
    pytest.importorskip("zmq")
    caplog.set_level(logging.INFO, "motes.live")
    source, out = source_at("udp://127.0.0.1:0", form()), sink_at("tcp://127.0.0.1:0")
    assert told(caplog)[0] == f"source udp://127.0.0.1:0 listens at port {source.port}."
    with pytest.raises(mo.MotesError, match="Address already in use"):
        sink_at(told(caplog)[1].removeprefix("sink tcp://127.0.0.1:0 publishes at "))
    source.close()
    out.close()


def test_a_named_pipe_is_written_to_where_somebody_reads_and_never_holds_a_run_that_is_to_end(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(sink, "AGAIN", 0.0)
    monkeypatch.setattr(json_lines, "POLL", 0.01)
    path = tmp_path / "pipe"
    os.mkfifo(path)
    out = Guarded(sink_at(str(path)))
    out.write({"step": 0})
    assert told(caplog) == [f"sink {path}: nobody reads it; the filter goes on, and it is tried again every 0 s."]
    for step in (1, 2):
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as reader:
            out.write({"step": step})
            assert json.loads(reader.read()) == {"step": step}
    out.write({"step": 3})
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    out.sink.ends = lambda: True
    for step in range(4, 100):
        # more than a pipe holds
        out.write({"step": step, "much": "x" * 2000})
    assert out.lost > 10 and "nobody reads it, and the run is to end" in told(caplog)[-1]
    os.close(file)
    out.close()


def test_sinks_are_different_ones_and_no_file_of_something_else(tmp_path):
    name = str(tmp_path / "out.jsonl")
    for twice in ([name, str(tmp_path / "." / "out.jsonl")], ["-", "-"], ["tcp://*:5599", "tcp://*:5599"]):
        with pytest.raises(mo.MotesError, match="sinks: expected addresses that differ, got .* twice"):
            sinks_at(twice)
    for other, begins in (("own.toml", "application ="), ("in.csv", "t,a"), ("bag", "#ROSBAG V2.0")):
        (tmp_path / other).write_text(begins)
        with pytest.raises(mo.FileError, match=f"{other}: expected a file of JSON lines, or none, got one that begins with b'{begins}'"):
            sink_at(str(tmp_path / other))
        assert (tmp_path / other).read_text() == begins
    (tmp_path / "in.json").write_text('{"t": [0.1]}')
    with pytest.raises(mo.MotesError, match="expected another file than the source"):
        sinks_at([str(tmp_path / "in.json")], "", str(tmp_path / "in.json"))
