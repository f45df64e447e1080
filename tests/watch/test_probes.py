"""Who may look at a page: the ten probes, with raw sockets, and what becomes of who asks too much."""

import logging
import os
import socket
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from looked_at import answer, asked, connected, entered, get, question, small_stream, stepped, upgraded
from websockets.exceptions import ConnectionClosed

import motes as mo
from motes.core.checks import MotesError

pytest.importorskip("uvicorn")
ROUTES = ("/", "/file/page.js", "/scene", "/picture", "/report", "/nothing")
EVIL = "evil.example"


@pytest.fixture(scope="module")
def page():
    stream = small_stream()
    page = mo.watch(stream)
    stepped(stream, page, 3)
    yield page
    page.close()


@pytest.fixture(scope="module")
def place(page):
    return entered(page)


@pytest.mark.parametrize("route", ROUTES)
def test_another_host_is_refused_on_every_route(place, route):
    port, cookie = place
    for host in (f"{EVIL}:{port}", EVIL, f"127.0.0.1.{EVIL}:{port}", f"127.0.0.1:{port + 1}", "", f"localhost.{EVIL}:{port}", "0"):
        assert get(port, route, host or " ", Cookie=cookie)[0] in (400, 403), host
    assert upgraded(port, f"{EVIL}:{port}", Cookie=cookie, Origin=f"http://127.0.0.1:{port}") == 403


@pytest.mark.parametrize("origin", [f"http://{EVIL}", "null", "", "file://", "https://127.0.0.1", "http://127.0.0.1:1", None])
def test_a_socket_of_another_origin_is_refused_before_it_is_accepted(place, origin):
    port, cookie = place
    assert upgraded(port, Cookie=cookie, **({} if origin is None else {"Origin": origin})) == 403


def test_a_name_that_was_bound_anew_is_refused(place):
    port, cookie = place
    assert upgraded(port, f"{EVIL}:{port}", Cookie=cookie, Origin=f"http://{EVIL}:{port}") == 403


def test_who_has_no_token_sees_nothing(place):
    port, cookie = place
    own = f"http://127.0.0.1:{port}"
    name = cookie.partition("=")[0]
    for given in ({}, {"Cookie": f"{name}=wrong"}, {"Cookie": f"{name}="}, {"Cookie": "=;;="}, {"Cookie": "x" * 9_000}):
        assert {get(port, route, **given)[0] for route in ROUTES} <= {401, 400}
        # a line that is too long for it the socket leaves without an answer, until it counts as silent
        assert len(str(given)) > 8_000 or upgraded(port, Origin=own, **given) in (401, 400)
    status, text = get(port, "/?token=wrong")
    assert status == 401 and text.endswith("token: wrong. Open the link with its token, as it was printed: the page is its owner's.\n")
    assert get(port, "/?token=")[0] == 401 and get(port, "/scene?token=x")[0] == 401
    assert get(port, "/scene", Cookie=cookie)[0] == 200 and upgraded(port, Cookie=cookie, Origin=own) == 101


def test_the_token_is_not_logged_and_goes_nowhere(page, place, caplog, capfd):
    port = place[0]
    token = page.address.partition("token=")[2]
    with caplog.at_level(logging.DEBUG):
        status, text = get(port, f"/?token={token}", Referer="http://elsewhere")
    assert status == 200 and token not in text and "referrer-policy: no-referrer" in text and 'url=/"' in text
    assert "HttpOnly" in text and "SameSite=strict" in text
    printed = capfd.readouterr()
    assert token not in caplog.text + printed.out + printed.err
    assert len(token) >= 43


@pytest.mark.parametrize("path", ["/file/..%2f..%2fpage.py", "/file/../page.py", "//etc/passwd", "/file//etc/passwd", "/file/%00",
                                  "/report/..%2fx", "/file/..%5cguard.py", "/static/page.js", "/live"])  # fmt: skip
def test_names_of_files_lead_nowhere(place, path):
    assert get(place[0], path, Cookie=place[1])[0] in (400, 404)


def test_it_listens_on_the_loopback_alone(place):
    found = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:] if line.split()[3] == "0A"]
    assert [address for address in found if address.endswith(f":{place[0]:04X}")] == [f"0100007F:{place[0]:04X}"]


def test_what_a_proxy_says_is_not_heard(place):
    port, cookie = place
    own = {"X_Forwarded_Host": f"127.0.0.1:{port}", "X_Forwarded_For": "127.0.0.1", "Forwarded": f"host=127.0.0.1:{port}"}
    assert get(port, "/scene", f"{EVIL}:{port}", Cookie=cookie, **own)[0] == 403
    assert get(port, "/scene", Cookie=cookie, X_Forwarded_Host=EVIL)[0] == 200


def memory():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def many(page, sockets, silent):
    """Open sockets, ask too much, and be silent; return by how many MB the memory grew."""
    port, cookie = entered(page)
    with ExitStack() as opened:
        first = opened.enter_context(connected(port, cookie))
        begin, there = memory(), [opened.enter_context(connected(port, cookie)) for _ in range(sockets)]
        with pytest.raises(ConnectionClosed) as reason:
            first.recv(timeout=20)
        assert reason.value.rcvd.code == 1013
        there[-1].send(question())
        assert answer(there[-1].recv(timeout=20), 7 + 9)[2] is not None
        with pytest.raises(ConnectionClosed) as reason:
            there[-2].send("x" * (10 << 20))
            there[-2].recv(timeout=20)
        assert reason.value.rcvd is None or reason.value.rcvd.code == 1009
        for _ in range(silent):
            line = opened.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10))
            line.sendall(b"GET / HTTP/1.1\r\nHost: ")
        return memory() - begin


def test_sockets_and_messages_are_bounded(page):
    assert many(page, 70, 40) < 60
    time.sleep(0.2)
    assert get(*entered(page)[:1], "/")[0] == 401


def test_sixty_four_sockets_stay_and_one_more_closes_the_oldest(page):
    port, cookie = entered(page)
    with ExitStack() as opened:
        there = [opened.enter_context(connected(port, cookie)) for _ in range(64)]
        for one in there:
            one.send(question())
            assert answer(one.recv(timeout=20), 7 + 9)[2] is not None
        opened.enter_context(connected(port, cookie))
        with pytest.raises(ConnectionClosed):
            there[0].recv(timeout=20)
        there[1].send(question())
        assert there[1].recv(timeout=20)


@pytest.mark.night
def test_a_thousand_sockets_take_no_memory(page):
    many(page, 200, 100)
    assert many(page, 1_000, 200) < 60


def test_silent_connections_are_closed(page, monkeypatch):
    server = page._server
    monkeypatch.setattr(sys.modules[type(server).__module__], "SILENT", 0.2)
    port, cookie = entered(page)
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line, connected(port, cookie) as watching:
        line.sendall(b"GET / HTTP/1.1\r\n")
        line.settimeout(10)
        try:
            assert line.recv(10) == b""
        except ConnectionResetError:
            pass
        watching.send(question())
        assert watching.recv(timeout=10) and server._pages


@pytest.mark.parametrize("text", ["", "x", "[]", "{}" * 9, '{"axes": [0, 99]}', '{"axes": [0]}', '{"axes": ["a", 0]}',
                                  '{"have": 1e400}', "null",
                                  '{"at": "now"}', '{"axes": [0, 1], "state": 3}', '{"axes": [true, 1]}', "[" * 900])  # fmt: skip
def test_what_is_no_question_ends_the_socket(place, text):
    with connected(*place) as watching:
        watching.send(text)
        with pytest.raises(ConnectionClosed) as reason:
            watching.recv(timeout=10)
        assert reason.value.rcvd.code == 1008


@pytest.mark.parametrize("request_", [b"\x00" * 100 + b"\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
                                      b"GET " + b"a" * 30_000 + b" HTTP/1.1\r\n\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"])  # fmt: skip
def test_what_is_no_request_is_refused(place, request_):
    found = asked(place[0], request_)
    assert found == b"" or found.split()[1] in (b"400", b"403", b"405")


def test_policies_are_strict(place):
    port, cookie = place
    for route in ("/", "/scene", "/file/page.js"):
        text = get(port, route, Cookie=cookie)[1]
        policy = next(line for line in text.splitlines() if line.startswith("content-security-policy"))
        assert "default-src 'none'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert "nosniff" in text and "no-store" in text
    html = get(port, "/", Cookie=cookie)[1]
    assert "<script>" not in html and " style=" not in html and "http:" not in html.partition("<!DOCTYPE")[2]


def test_other_addresses_only_when_told():
    with pytest.raises(MotesError, match=r"watch host: expected an address of this machine, got '192\.0\.2\.1'"):
        mo.watch(small_stream(), host="192.0.2.1")
    wide = mo.watch(small_stream(), host="0.0.0.0")
    try:
        port, cookie = entered(wide)
        assert get(port, "/scene", f"10.1.2.3:{port}", Cookie=cookie)[0] == 200
        assert get(port, "/scene", f"{socket.gethostname()}:{port}", Cookie=cookie)[0] == 200
        assert get(port, "/scene", f"{EVIL}:{port}", Cookie=cookie)[0] == 403
    finally:
        wide.close()
