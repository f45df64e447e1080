"""`motes watch` as its users meet it: what stands in the way is one clear line."""

import re
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from motes.cli.main import main

pytest.importorskip("uvicorn")
MODEL = """
import jax.numpy as jnp
import motes as mo
import numpy as np
import time
from motes.applications.interface import Job


def model():
    walk = mo.LinearGaussian(jnp.eye(2), 0.1 * jnp.eye(2))
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), jnp.eye(2)), walk, mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), names=("a", "b"))


def make():
    return {"model": model(), "ys": np.zeros((8, 2), np.float32), "truth": np.zeros((8, 2))}


def slow():
    def ys(step=0):
        time.sleep(1.2)
        yield np.zeros(2, np.float32)

    return Job(model=model(), ys=ys)


def never():
    return Job(model=model(), ys=lambda step=0: iter(()))
"""
QUICK = ("--filter", "particle", "--filter.n", "50", "--rate", "0", "--stay", "0", "--no-browser")


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(MODEL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_run_is_watched_and_reported(own, capsys):
    assert main(["watch", "own.py:make", *QUICK, "--budget", "5ms"]) == 0
    said = capsys.readouterr()
    assert re.search(r"^Watch it at http://127\.0\.0\.1:\d+/\?token=\S{43}$", said.out, re.M) and said.err == ""
    report = (own / "out" / "report.html").read_text()
    assert "particle" in report and "late steps" in report and "://" not in report.partition("</head>")[0]


def test_what_comes_from_a_source_is_watched_and_reported(own, capsys):
    (own / "rows.jsonl").write_text("".join(f'{{"time": {k}, "y": [0.1, null]}}\n' for k in range(6)))
    assert main(["watch", "own.py:make", *QUICK, "--source", "rows.jsonl", "--live.sinks", "track.jsonl", "--budget", "5ms"]) == 0
    said = capsys.readouterr()
    assert "messages: 6 taken." in said.err and len((own / "track.jsonl").read_text().splitlines()) == 6
    assert re.search(r"^Watch it at http\S+\nThe report is in \S+\n$", said.out, re.M)
    report = (own / "out" / "report.html").read_text()
    assert "late steps" in report and re.search('"truth": ?false', report)
    assert main(["watch", "own.py:make", *QUICK, "--live", "--live.speed", "0", "--out", "again"]) == 0
    said = capsys.readouterr()
    assert "messages: 8 taken." in said.err and said.out.endswith(f"The report is in {Path('again', 'report.html')}.\n")
    assert "particle" in (own / "again" / "report.html").read_text()


def test_a_file_says_what_is_watched(own, capsys):
    asked = 'application = "own.py:make"\nout = "there"\n[filter]\nkind = "kalman"\n[watch]\nrate = 0\nbrowser = false\nstay = 0\n'
    (own / "own.toml").write_text(asked)
    assert main(["watch", "own.toml"]) == 0
    assert (own / "there" / "report.html").exists()
    (own / "own.toml").write_text('application = "own.py:make"\n[watch]\nsped = 1\n')
    assert main(["watch", "own.toml"]) == 2 and "[watch]" in capsys.readouterr().err


def test_a_busy_port_is_one_line_before_the_work(own, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert main(["watch", "own.py:make", *QUICK, "--port", str(port)]) == 2
    said = capsys.readouterr()
    assert said.err == (f"motes watch: watch port: expected one that is free, got {port}, which another program listens at. "
                        "Leave it out to take any.\n") and said.out == ""  # fmt: skip


def test_without_a_browser_the_link_is_all(own, capsys, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert main(["watch", "own.py:make", *QUICK[:-1]]) == 0
    assert capsys.readouterr().err == "motes watch: no browser was found here; open the link in one.\n"


def test_a_wrong_token_is_told(own, capsys):
    seen = []

    def look():
        end = time.monotonic() + 30
        while time.monotonic() < end and not seen:
            found = re.search(r"http\S+token=", "".join(seen_lines()))
            if found:
                with pytest.raises(urllib.error.HTTPError) as reason:
                    urllib.request.urlopen(found[0] + "wrong", timeout=10)
                seen.append((reason.value.code, reason.value.read().decode()))
            time.sleep(0.02)

    lines = []

    def seen_lines():
        lines.append(capsys.readouterr().out)
        return lines

    looking = threading.Thread(target=look)
    looking.start()
    assert main(["watch", "own.py:make", *QUICK[:6], "--no-browser", "--stay", "3"]) == 0
    looking.join()
    assert seen == [(401, "token: wrong. Open the link with its token, as it was printed: the page is its owner's.\n")]


def test_a_source_that_never_comes_is_told(own, capsys, monkeypatch):
    import motes.cli.watch

    monkeypatch.setattr(motes.cli.watch, "PATIENCE", 0.5)
    assert main(["watch", "own.py:slow", *QUICK]) == 0
    line = "motes watch: expected a measurement, got none for 0.5 s. It is waited for; Ctrl-C ends it.\n"
    assert capsys.readouterr().err.count(line) == 1
    assert main(["watch", "own.py:never", *QUICK]) == 2
    assert capsys.readouterr().err == "motes watch: data: expected at least one measurement, got none.\n"


@pytest.mark.parametrize("words, expected", [
    (["--rate", "-1"], "rate: expected steps a second, at least 0, got -1.0."),
    (["--rate", "nan"], "rate: expected steps a second"),
    (["--stay", "-2"], "stay: expected seconds, at least 0, got -2.0."),
    (["--stay", "nan"], "stay: expected seconds"),
    (["--budget", "5"], "budget: expected a time with its unit"),
    (["--host", "192.0.2.7"], "watch host: expected an address of this machine"),
    (["--host", ""], "watch host: expected an address of this machine, got ''"),
    (["--port", "-4"], "watch port: expected a whole number from 0 to 65535"),
    (["--n", "0"], "n: expected"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(own, capsys, words, expected):
    assert main(["watch", "own.py:make", *QUICK, *words]) == 2
    said = capsys.readouterr().err
    assert expected in said and said.count("\n") == 1


@pytest.mark.night
def test_a_demonstration_is_watched(tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["demo", "robot", "--watch", "--seconds", "60", "--n", "100", *QUICK[4:], "--out", str(folder)]) == 0
    assert {path.name for path in folder.iterdir()} == {"report.html", "robot.toml", "recording.mat"}
    assert main(["watch", str(folder / "robot.toml"), "--n", "100", *QUICK[4:]]) == 0
    assert main(["demo", "notch", "--watch", "--targets", "3", *QUICK[4:]]) == 2
    assert "watch: expected one target (targets = 1)" in capsys.readouterr().err
