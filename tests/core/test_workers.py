"""Workers: work that is lost is done again by another thread, and what only takes long is not."""

import subprocess
import sys
import threading
import time

import pytest

from motes.core import workers
from motes.core.workers import Workers


def test_work_that_is_lost_is_done_again(monkeypatch):
    monkeypatch.setattr(workers, "QUIET", 0.2)
    calls = []

    def lost_twice(value):
        calls.append(threading.get_ident())
        if len(calls) < 3:
            threading.Event().wait(60)
        return value

    with Workers(1) as worker:
        assert worker.patiently(lost_twice, 7) == 7
        assert worker.patiently(lambda: 8) == 8
    assert len(set(calls)) == 3


def test_work_that_computes_is_waited_for(monkeypatch):
    monkeypatch.setattr(workers, "QUIET", 0.05)
    calls = []

    def long():
        calls.append(1)
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            pass
        return "done"

    with Workers(1) as worker:
        assert worker.patiently(long) == "done" and calls == [1]
        with pytest.raises(TimeoutError, match="its own"):
            worker.patiently(fail)


def fail():
    raise TimeoutError("its own")


def test_a_process_that_lost_work_ends_as_usual():
    program = """
import sys, threading
from motes.core import workers
workers.QUIET = 0.1
first = [threading.Event()]
with workers.Workers(1) as worker:
    print(worker.patiently(lambda: first.pop().wait(60) if first else "found"), flush=True)
sys.exit(3)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "found\n", "")
