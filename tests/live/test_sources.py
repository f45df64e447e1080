"""Sources and sinks, one by one: what is no message, ports in use, lines that break, full disks."""

import errno
import json
import os
import pty
import socket
import termios
import time

import numpy as np
import pytest

import motes as mo
from motes.live import json_lines, parquet, sink
from motes.live.lines import of_file
from motes.live.message import Form, Names, Unreadable
from motes.live.places import sink_at, source_at
from motes.live.replay import Replay
from motes.live.sink import Guarded

FORM = Names(("a", "b"), ("speed",), "t", "k")


def messages(source):
    """What comes within a moment, as messages."""
    return [one for received in source.receive(0.05) or [] if (one := source.understood(received)) is not None]


def heard(source, count, seconds=10.0):
    """The messages that come, until they are so many."""
    found, until = [], time.monotonic() + seconds
    while len(found) < count and time.monotonic() < until:
        found += messages(source)
    return found


def text(k):
    return json.dumps({"t": 0.1 * k, "k": k, "a": k, "b": None, "speed": 2.0}).encode()


def test_text_becomes_a_message_in_json_and_by_commas():
    form = Form(FORM, timed=True)
    one, two = form.read(b'{"k": 3, "t": 0.5, "a": 1.5, "b": null, "speed": 2}'), form.read(b" 3, 0.5,1.5 ,,2\r")
    assert np.array_equal(one.y, [1.5, np.nan], equal_nan=True) and (one.time, one.number, one.u["speed"]) == (0.5, 3, 2.0)
    assert np.array_equal(one.y, two.y, equal_nan=True) and (two.time, two.number, two.u["speed"]) == (0.5, 3, 2.0)
    assert form.read(b'{"t": 0.6, "k": 4, "a": 1}').u["speed"] == 2.0, "an input holds until another comes"
    assert form.read(b'{"t": 0.6, "speed": 3}').y is None
    assert form.with_step(one.u, 0.25)["dt"] == 0.25
    assert json.loads(form.example()) == {"k": 0, "t": 0.0, "a": 0.0, "b": 0.0, "speed": 0.0}


def test_an_example_gives_messages_their_form():
    form = Form(Names(), np.zeros(3), {"dt": np.zeros(()), "push": np.zeros(2)})
    found = form.read(b'{"time": 1.0, "y": [1, null, 3], "push": [4, 5]}')
    assert found.y.shape == (3,) and form.with_step(found.u, 0.5)["dt"] == 0.5
    assert np.isnan(form.read(b'{"time": 1.0, "y": null}').y).all()
    named = Form(Names(), {"radar": np.zeros(2), "baro": np.zeros(1)})
    assert np.isnan(named.read(b'{"baro": [3]}').y["radar"]).all()
    assert Form(Names(), np.zeros(2)).read(b"0.5,1,2").y.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("line", "why"), [
    (b"\xff\xfe\x00", "neither a JSON object nor numbers"), (b"[1, 2]", "neither"), (b"{", "no JSON"), (b'{"a": ' + 10**5 * b"[", "bytes"),
    (b"{}", "none of a, b, speed in it, but nothing"), (b'{"other": 1}', "none of"), (b"1,2,3", "3 numbers, expected 5"),
    (b'{"t": "now", "a": 1, "speed": 1}', "'t' is no finite number"), (b'{"a": "x", "speed": 1}', "'a' is no number"),
    (b'{"a": 1e999, "speed": 1}', "not finite"), (b'{"a": 1, "speed": NaN}', "'speed' is not finite"),
    (b'{"a": [1, [2]], "speed": 1}', "'a'"),
    (b'{"a": [1, 2], "b": 3, "speed": 1}', "shape (3,), expected (2,)"), (b'{"a": {"x": 1}, "speed": 1}', "'a' is no number"),
    (b'{"a": ' + 5000 * b"[" + 5000 * b"]" + b', "speed": 1}', ""), (b'{"t": NaN, "a": 1, "speed": 1}', "'t'"),
    (b"1_0,2,3,4,5", "neither"), (b'{"k": 1.5, "a": 1, "speed": 1}', "'k' is no whole number: 1.5"),
    (b'{"t": ' + 400 * b"7" + b', "a": 1, "speed": 1}', "'t' is beyond 1e+12"), (b'{"t": 1.7e18, "a": 1, "speed": 1}', "beyond 1e+12"),
    (b'{"k": ' + 400 * b"7" + b', "a": 1, "speed": 1}', "'k' is beyond"), (b'{"a": [[1]], "b": 0, "speed": 1}', "'a'"),
    (b'{"a": [' + 400 * b"7" + b'], "b": 0, "speed": 1}', "'a'"), (b'{"speed": [1, 2, 3]}', "the input 'speed' of shape (3,), expected ()"),
    (b'{"a": ' + 900 * b"[" + 900 * b"]" + b', "speed": 1}', "deeper than 32 levels"), (b'{"\\n\\u001b[2J": 1}', "but '\\n\\x1b[2J'"),
    (b'{"k": 1.5e300, "a": true, "b": "", "speed": 1}', ""),
])  # fmt: skip
def test_what_is_no_message_is_told_in_words(line, why):
    form = Form(FORM)
    form.read(b'{"a": 1, "b": 2, "speed": 1}')
    with pytest.raises(Unreadable) as told:
        form.read(line)
    assert why in str(told.value) and len(str(told.value)) < 300


def test_inputs_must_have_come():
    with pytest.raises(Unreadable, match="'speed' has not come yet"):
        Form(FORM).read(b'{"a": 1}')


def test_lines_of_a_file_have_positions_and_the_last_may_lack_its_end(tmp_path):
    path = tmp_path / "in.jsonl"
    path.write_bytes(b"\n".join([text(0), b"no message", text(1), b"", text(2)]))
    source = of_file(str(path), Form(FORM))
    found = heard(source, 3)
    assert source.position == path.stat().st_size + 1
    assert [one.number for one in found] == [0, 1, 2] and source.counts.of["unreadable"] == 1
    source.close()
    again = of_file(str(path), Form(FORM))
    again.go_on(len(text(0)) + 1)
    assert [one.number for one in heard(again, 2)] == [1, 2] and again.receive(0.0) is None
    again.close()


def test_datagrams_come_and_a_port_in_use_is_one_line():
    source = source_at("udp://127.0.0.1:0", Form(FORM))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(5):
            sender.sendto(text(k) + (b"\n" + text(99) if k == 4 else b""), ("127.0.0.1", source.port))
    found = heard(source, 6)
    assert [one.number for one in found] == [0, 1, 2, 3, 4, 99] and all(one.arrived is not None for one in found)
    with pytest.raises(mo.MotesError, match="free port, got Address already in use. Another program may listen there"):
        source_at(f"udp://127.0.0.1:{source.port}", Form(FORM))
    source.close()


def test_zeromq_comes_and_goes():
    zmq = pytest.importorskip("zmq")
    publisher = zmq.Context.instance().socket(zmq.PUB)
    port = publisher.bind_to_random_port("tcp://127.0.0.1")
    source = source_at(f"tcp://127.0.0.1:{port}", Form(FORM))
    until = time.monotonic() + 10
    found = []
    while not found and time.monotonic() < until:  # a subscription takes a moment
        publisher.send_multipart([b"topic", text(1)])
        found = messages(source)
    assert found[0].number == 1
    with pytest.raises(mo.MotesError, match="sink tcp.*a free port.*Address already in use"):
        sink_at(f"tcp://127.0.0.1:{port}")
    publisher.close(0)
    source.close()
    out = sink_at("ipc://@motes-test-sink")
    listener = zmq.Context.instance().socket(zmq.SUB)
    listener.setsockopt(zmq.SUBSCRIBE, b"")
    listener.connect("ipc://@motes-test-sink")
    until = time.monotonic() + 10
    while not listener.poll(20) and time.monotonic() < until:
        out.write({"step": 1, "ess": float("inf")})
    assert json.loads(listener.recv()) == {"step": 1, "ess": None}
    listener.close(0)
    out.close()


def test_a_serial_line_that_breaks_is_opened_again(monkeypatch, tmp_path):
    monkeypatch.setattr("motes.live.lines.AGAIN", (0.01,))
    link = tmp_path / "tty"

    def line():
        ours, theirs = pty.openpty()
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(theirs))
        return ours, theirs

    ours, theirs = line()
    source = source_at(f"serial://{link}?baud=115200", Form(FORM))
    os.write(ours, text(1) + b"\r\n" + text(2)[:20])
    assert heard(source, 1)[0].number == 1
    os.write(ours, text(2)[20:] + b"\n")
    assert heard(source, 1)[0].number == 2
    os.close(theirs), os.close(ours)
    assert heard(source, 1, 0.2) == []

    def breaking(*given):
        raise termios.error(errno.EIO, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr("tty.setraw", breaking)
        ours, theirs = line()
        assert heard(source, 1, 0.2) == []
        os.close(theirs), os.close(ours)
    ours, theirs = line()
    os.write(ours, text(3) + b"\n")
    assert heard(source, 1)[0].number == 3 and source.counts.of["reconnected"] == 1
    source.close()
    with pytest.raises(mo.MotesError, match="a usual speed, such as .baud=9600 or 115200, got 12345"):
        source_at(f"serial://{link}?baud=12345", Form(FORM))
    os.close(theirs), os.close(ours)


def test_recordings_are_replayed_at_their_speed():
    ys = np.arange(6.0)[:, None]
    fast = Replay("rows", ys, {"push": ys}, speed=0)
    found = heard(fast, 6)
    assert [one.y[0] for one in found] == list(range(6)) and found[2].u["push"] == 2 and fast.receive(0) is None
    began = time.monotonic()
    paced = Replay("rows", ys, None, 100.0 + 0.1 * np.arange(6), speed=5.0)
    assert len(heard(paced, 6)) == 6 and 0.09 < time.monotonic() - began < 5 and paced.position == 6
    paced.go_on(4)
    assert [one.content for one in heard(paced, 2)] == [4, 5]
    # a run goes on with the recording that it had, which may have grown, and with no other
    Replay("rows", np.arange(9.0)[:, None], {"push": np.arange(9.0)[:, None]}, speed=0).check(4, fast.mark(4))
    for other in (ys + 1, ys[:3]):
        with pytest.raises(mo.FileError, match="rows: expected the recording that was taken up to row 4, got another one"):
            Replay("rows", other, {"push": other}).check(4, fast.mark(4))
    long, other = np.zeros((1000, 1)), np.eye(1000, 1)
    one = Replay("rows", long)
    assert [one.mark(position) for position in (300, 900, 899)] == [Replay("rows", long).mark(position) for position in (300, 900, 899)]
    with pytest.raises(mo.FileError, match="taken up to row 900, got another one"):
        Replay("rows", other).check(900, one.mark(900))


@pytest.mark.parametrize(("address", "why"), [
    ("udp://127.0.0.1", "udp://HOST:PORT"), ("http://a", "standard input"), ("udp://127.0.0.1:99999", "ort"),
    ("udp://no.such.host.invalid:5", "address"), ("/no/such/file.jsonl", "No such file"), ("serial:///no/such/tty", "No such file"),
    ("serial:///dev/null?baud=x", "a number after baud"),
    (".", "a folder"),
])  # fmt: skip
def test_a_source_that_is_none_is_one_line(address, why):
    with pytest.raises(mo.MotesError) as told:
        source_at(address, Form(FORM))
    assert why in str(told.value) and "\n" not in str(told.value)


def test_a_sink_that_is_none_is_one_line(tmp_path):
    (tmp_path / "other.parquet").mkdir()
    (tmp_path / "other.parquet" / "thesis.tex").touch()
    for address, why in (("udp://x:1", "standard output"), (str(tmp_path), "directory"), (str(tmp_path / "no" / "x.jsonl"), "No such file"),
                         (str(tmp_path / "other.parquet"), "thesis.tex in it")):  # fmt: skip
        with pytest.raises(mo.MotesError, match=why):
            sink_at(address)


def row(step):
    return {"step": step, "time": 0.1 * step, "mean east": 1.0, "alarm": False}


def test_lines_are_whole_also_on_a_full_disk(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(sink, "AGAIN", 0.0)
    path = tmp_path / "out.jsonl"
    out = Guarded(json_lines.to_file(str(path)))
    out.write(row(0))
    really, room = os.write, [25]

    def full(file, data):
        if room[0] is None:
            return really(file, data)
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = min(room[0], len(data))
        room[0] -= taken
        return really(file, data[:taken])

    monkeypatch.setattr(os, "write", full)
    for step in (1, 2, 3):
        out.write(row(step))
    room[0] = None
    out.write(row(4))
    out.close()
    assert [json.loads(line)["step"] for line in path.read_text().splitlines()] == [0, 4] and out.lost == 3
    told = [one.getMessage() for one in caplog.records]
    assert len(told) == 3 and "the disk took 25 of" in told[0] and "works again; 3 records are missing" in told[1]
    assert told[2].endswith("out.jsonl: 3 records are missing.")


def test_what_fails_again_after_it_was_well_is_told_again_and_nothing_comes_twice(tmp_path, monkeypatch, caplog):
    path = tmp_path / "out.jsonl"
    out = Guarded(json_lines.to_file(str(path)))
    out.write(row(0))
    kept = out.kept()

    def failing(*given):
        raise OSError(errno.EIO, "Input/output error")

    for _ in range(2):
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing)
            assert out.kept() == out.kept() == kept
        assert out.kept() == kept
    out.write(row(1))
    # of what came after that checkpoint all comes again
    out.sink.go_on(kept, cut=True)
    out.close()
    assert len(caplog.records) == 2 and out.lost == 0 and len(path.read_text().splitlines()) == 1


def test_parquet_grows_by_whole_row_groups(tmp_path, monkeypatch, caplog):
    pq = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(parquet, "ROWS", 4)
    path = tmp_path / "track.parquet"

    def steps():
        return [] if not list(path.glob("part*")) else pq.read_table(path)["step"].to_pylist()

    out = sink_at(str(path))
    for step in range(6):
        out.write(row(step))
    assert steps() == [0, 1, 2, 3] and out.kept() == 6
    out.secure()
    assert steps() == [0, 1, 2, 3, 4, 5]
    for step in range(6, 9):
        out.write(row(step))
    assert steps() == [0, 1, 2, 3, 4, 5, 6, 7]
    # killed here, which frees what it holds; what came after the checkpoint comes again
    out._lock.release()
    out = sink_at(str(path))
    out.go_on(6, cut=True)
    out.write(row(6))
    out.close()
    assert steps() == [0, 1, 2, 3, 4, 5, 6]
    for kept in (4, 3):
        out = sink_at(str(path))
        out.go_on(kept, cut=True)
        out.close()
        assert steps() == list(range(kept))
    out = sink_at(str(path))
    out.go_on(3, cut=False)
    out.write(row(9))
    out.close()
    out = sink_at(str(path))
    out.go_on(7, cut=True)
    assert caplog.records[-1].getMessage() == f"sink {path}: 3 records from before the checkpoint are not in it."
    out.close()
    assert steps() == [0, 1, 2, 9] and [one.name for one in path.glob("*") if one.name != ".lock"] == ["part-00000000.parquet"]


@pytest.mark.parametrize("bad", [b'{"speed": "abc"}', b'{"speed": [1, 2]}', b'{"a": "x", "b": 0, "speed": 99}',
                                 b'{"a": [1, 2], "speed": 99}'])  # fmt: skip
def test_inputs_of_a_message_that_is_refused_do_not_hold(bad):
    form = Form(FORM)
    form.read(b'{"a": 1, "b": 2, "speed": 7}')
    with pytest.raises(Unreadable):
        form.read(bad)
    assert form.read(b'{"a": 1, "b": 2}').u["speed"] == 7


def test_a_message_keeps_only_what_is_asked_for():
    form = Form(FORM)
    found = form.read(b'\xef\xbb\xbf{"t": 1, "pad": ' + 900 * b"[" + 900 * b"]" + b', "a": 1, "speed": 2}')
    assert found.content == {"t": 1, "a": 1, "speed": 2} and found.y.shape == (2,)
    assert form.read(b"\xef\xbb\xbf3,0.5,1,2,3").number == 3
    with pytest.raises(Unreadable, match="'dt' is less than nothing"):
        Form(Names(("a",), ("dt",))).read(b'{"a": 1, "dt": -1}')
    named = Form(Names(), {"radar": np.zeros(2), "baro": np.zeros(1)})
    assert named.read(b'{"baro": 3}').y["baro"].tolist() == [3]
    with pytest.raises(Unreadable, match="'radar' of shape"):
        named.read(b'{"radar": [1, 2, 3]}')
