"""One run on several processes: the same bits as on one, one line where a process is killed, and the run goes on on any number."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

import motes as mo
from motes.cli.main import main
from motes.cli.processes import LOST
from tiers import NIGHT

pytestmark = pytest.mark.jax
OWN = """
import numpy as np
import motes as mo
import motes.cli.long_runs as long_runs

long_runs.EVERY = {every}


def make():
    model = mo.textbook.growth()
    return {{"model": model, "ys": np.asarray(mo.simulate(0, model, {steps})[1])}}
"""
STEPS = 120
ASKED = ("run", "own.py:make", "--filter", "particle", "--filter.n", "64", "--elements", "4")
SECONDS = 120.0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN.format(every=0.0, steps=STEPS))
    return tmp_path


def started(*more, told=None):
    heard = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from motes.cli.main import main; main()"
    paths = os.pathsep.join(filter(None, sys.path))
    return subprocess.Popen([sys.executable, "-c", heard, *ASKED, *more], env=os.environ | {"PYTHONPATH": paths} | (told or {}),
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # fmt: skip


def children(process):
    """Process ids of what a process started, by their number."""
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True).stdout.split()
    return sorted(int(pid) for pid in found if b"--hosts" in Path(f"/proc/{pid}/cmdline").read_bytes())


def until_something_is_kept(process, out):
    until = time.monotonic() + SECONDS
    while not list(Path(out).glob(".*.npz")) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)


def ended(process):
    """Output, errors, and that nothing is left of what it started."""
    own = children(process) if process.poll() is None else []
    out, err = process.communicate(timeout=SECONDS)
    assert not [pid for pid in own if Path(f"/proc/{pid}").exists()], "none is left behind"
    return out, err


def told(err):
    """The one line that is no warning of the filter."""
    (line,) = (line for line in err.splitlines() if "particles were effective" not in line)
    return line


def same(one, two):
    """Whether all that was kept of a run, its last law included, is equal to the bit."""
    one, two = (jax.tree.leaves(mo.History.load(Path(out) / "particle.npz")._data()) for out in (one, two))
    return all(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True) for a, b in zip(one, two, strict=True))


def test_two_processes_find_what_one_does(folder):
    Path("own.py").write_text(OWN.format(every=0.0, steps=8))
    process = started("--processes", "2", "--out", "two")
    assert main([*ASKED, "--out", "one"]) == 0
    out, err = ended(process)
    assert process.returncode == 0 and "Results are in two." in out and "Gloo" not in out, err
    assert same("one", "two")


@pytest.mark.night
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="the system does not tell what a process runs")
def test_a_killed_process_is_told_and_the_run_goes_on_with_the_same_bits(folder):
    process = started("--processes", "2", "--out", "two")
    until_something_is_kept(process, "two")
    os.kill(children(process)[1], signal.SIGKILL)
    began = time.monotonic()
    _, err = ended(process)
    assert time.monotonic() - began < 15 and process.returncode == LOST
    line = told(err)
    assert "motes run: process 1 of 2 was ended by SIGKILL; " in line and "steps are kept in two/.particle." in line
    assert "the same command goes on from there" in line
    assert main([*ASKED, "--out", "one"]) == 0
    again = started("--processes", "2", "--out", "two")
    out, err = ended(again)
    assert again.returncode == 0 and "Results are in two." in out and "Gloo" not in out, err
    assert same("one", "two")
    assert not list(folder.glob("*/.*")), "nothing is left half-written"


@pytest.mark.night
@pytest.mark.optimized
def test_told_to_end_it_saves_and_ends(folder):
    process = started("--processes", "2", "--out", "two")
    until_something_is_kept(process, "two")
    process.send_signal(signal.SIGTERM)
    _, err = ended(process)
    assert process.returncode == 143 and "ended by SIGTERM; what was done is kept in two" in told(err)


@pytest.mark.night
@pytest.mark.optimized
@pytest.mark.parametrize("whom", [0, 1])
def test_of_processes_that_a_launcher_started_none_outlives_another(folder, whom):
    """Process 0 is where all find each other: without it the others end within seconds, and the run goes on from what was kept."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    told = {"JAX_COORDINATOR_ADDRESS": address, "JAX_NUM_PROCESSES": "2"}
    both = [started("--hosts", "--out", "two", told=told | {"JAX_PROCESS_ID": str(number)}) for number in range(2)]
    until_something_is_kept(both[0], "two")
    os.kill(both[whom].pid, signal.SIGKILL)
    began = time.monotonic()
    other = both[1 - whom]
    _, err = other.communicate(timeout=SECONDS)
    assert time.monotonic() - began < 15 and other.returncode not in (0, None), err
    both[whom].communicate()
    assert main([*ASKED, "--out", "one"]) == 0 and main([*ASKED, "--out", "two"]) == 0
    assert same("one", "two")
    assert not list(folder.glob("*/.*")), "nothing is left half-written"


@pytest.mark.night
@pytest.mark.optimized
def test_twenty_kills_at_random_moments(folder):
    """A worker, process 0, or who started them; the run goes on on 1, 2 or 4 processes."""
    assert main([*ASKED, "--out", "one"]) == 0
    chance = random.Random(22)
    for number in range(20 if NIGHT else 3):
        out = f"run{number}"
        process = started("--processes", "2", "--out", out)
        until_something_is_kept(process, out)
        time.sleep(chance.uniform(0, 1.0))
        own = children(process)
        whom = chance.choice([*own, process.pid])
        os.kill(whom, signal.SIGKILL)
        process.communicate(timeout=SECONDS)
        until = time.monotonic() + 15
        while [pid for pid in own if Path(f"/proc/{pid}").exists()] and time.monotonic() < until:
            time.sleep(0.05)
        assert not [pid for pid in own if Path(f"/proc/{pid}").exists()], "none is left behind"
        again = started("--processes", str(chance.choice([1, 2, 4])), "--out", out)
        _, err = ended(again)
        assert again.returncode == 0, err
        assert same("one", out), (number, whom == process.pid)


@pytest.mark.parametrize(("more", "words"), [
    (("--processes", "0"), "processes: expected a whole number from 1 to 512, got 0"),
    (("--hosts", "--processes", "2"), "processes: expected none beside --hosts, where a launcher has started them, got 2"),
    (("--hosts",), "join: expected a process started by srun, mpirun or torchrun"),
    (("--elements", "0"), "Distributed elements: expected a whole number of at least 1, got 0"),
    (("--elements", "5"), "Distributed elements: expected a divisor of the filter's n=64, got 5"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(folder, more, words, capsys, monkeypatch):
    for name in ("JAX_COORDINATOR_ADDRESS", "WORLD_SIZE", "SLURM_PROCID", "JOB_COMPLETION_INDEX"):
        monkeypatch.delenv(name, raising=False)
    assert main([*ASKED, *more]) == 2
    err = capsys.readouterr().err
    assert words in err and len(err.splitlines()) == 1
