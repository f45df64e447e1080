"""Ctrl-C at any moment: exit code 130 at once, one line, nothing half-written, what was done kept."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

import motes as mo
from motes.cli.long_runs import ENDING
from tiers import NIGHT, each

SECONDS = 20.0  # in which a process must have ended; it takes a tenth of a second where nobody else computes
ASLEEP = """
import ctypes, sys
mutex = ctypes.create_string_buffer(64)
import motes.cli.main as cli
sys.modules["motes.cli.doctor"] = type(sys)("doctor")
sys.modules["motes.cli.doctor"].main = {body}
sys.argv = ["motes", "doctor"]
sys.exit(cli.main())
"""
WRITING = """
from pathlib import Path
import sys, time
from motes.io.archive import whole_file
def main(words):
    with whole_file(Path(sys.argv[-1]) / "half.txt") as file:
        file.write(b"half")
        file.flush()
        print("writing", flush=True)
        time.sleep(60)
"""
LEFT = """
import ctypes, threading, time
from motes.core.workers import Workers
try:
    with Workers(1) as workers:
        mutex = ctypes.create_string_buffer(64)
        future = workers.submit(lambda: [ctypes.CDLL(None).pthread_mutex_lock(mutex) for _ in range(2)])
        print("working", flush=True)
        future.result()
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def started(*words, **surroundings):
    # a shell that starts the suite in its background has interruptions ignored
    heard = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    paths = os.pathsep.join(filter(None, sys.path))
    return subprocess.Popen([sys.executable, "-c", heard + words[0], *map(str, words[1:])], env=os.environ | {"PYTHONPATH": paths},
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **surroundings)


def interrupted(process):
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    out, err = process.communicate(timeout=SECONDS)
    return out, err, time.monotonic() - began


@pytest.mark.parametrize("body", [
    # no Python code runs in the main thread; the exception of an ordinary handler is lost
    "lambda words: (print('in', flush=True), [ctypes.CDLL(None).pthread_mutex_lock(mutex) for _ in range(2)])",
    "lambda words: (print('in', flush=True), [exec('try: time.sleep(60)\\nexcept BaseException: pass', {'time': __import__('time')}) "
    "for _ in range(9)])",
])
def test_it_ends_whatever_the_main_thread_does(body):
    process = started(ASLEEP.format(body=body))
    assert process.stdout.readline() == "in\n"
    out, err, _ = interrupted(process)
    assert (process.returncode, err) == (130, "motes doctor: interrupted\n")


def test_in_the_background_of_a_shell_it_hears_that_it_is_to_end():
    waiting = ASLEEP.format(body="lambda words: (print('in', flush=True), __import__('time').sleep(60))")
    process = started("signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + waiting)
    assert process.stdout.readline() == "in\n"
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.2)
    process.send_signal(signal.SIGTERM)
    err = process.communicate(timeout=SECONDS)[1]
    assert (process.returncode, err) == (143, "motes doctor: ended by SIGTERM\n")


SAVING = """
import time
from motes.cli import interruption
def main(words):
    with interruption.saving():
        print("in", flush=True)
        while not interruption.is_asked():
            time.sleep(0.01)
        print("asked", flush=True)
        time.sleep(0.3)
        interruption.keeps("out")
        interruption.end()
"""


def test_who_is_told_twice_that_the_terminal_was_closed_saves_first():
    process = started(SAVING + ASLEEP.format(body="main"))
    assert process.stdout.readline() == "in\n"
    for said in ("asked\n", ""):
        process.send_signal(signal.SIGHUP)
        assert process.stdout.readline() == said
    err = process.communicate(timeout=SECONDS)[1]
    assert process.returncode == 129 and err.startswith("motes doctor: ended by SIGHUP; what was done is kept in out"), err


def test_an_ordinary_handler_is_not_heard_there():
    locked = "lambda words: (print('in', flush=True), [ctypes.CDLL(None).pthread_mutex_lock(mutex) for _ in range(2)])"
    process = started(ASLEEP.format(body=locked).replace("sys.argv =", "cli.interruption.heed = lambda name: None\nsys.argv ="))
    assert process.stdout.readline() == "in\n"
    time.sleep(1.0)  # until it has locked itself out
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)
    process.kill()
    process.communicate()


def test_nothing_is_left_half_written(tmp_path):
    (tmp_path / "half.txt").write_text("as it was")
    process = started(WRITING + ASLEEP.format(body="main").replace('["motes", "doctor"]', '["motes", "doctor", sys.argv[-1]]'), tmp_path)
    assert process.stdout.readline() == "writing\n" and len(list(tmp_path.iterdir())) == 2
    out, err, _ = interrupted(process)
    assert (process.returncode, err) == (130, "motes doctor: interrupted\n")
    assert [path.name for path in tmp_path.iterdir()] == ["half.txt"] and (tmp_path / "half.txt").read_text() == "as it was"


def test_work_that_cannot_be_stopped_is_left_behind():
    process = started(LEFT)
    assert process.stdout.readline() == "working\n"
    out, err, seconds = interrupted(process)
    assert (process.returncode, out, err) == (130, "interrupted\n", "") and seconds < SECONDS


SAMPLING = """
import sys
import jax.numpy as jnp
import motes as mo
chains = mo.sample(0, mo.mcmc.RandomWalkMetropolis(0.5), lambda x: -0.5 * x**2, jnp.zeros(()), draws=500_000)
kept = chains.positions.size
chains.save(sys.argv[-1] + "/chains.npz")
print(kept, flush=True)
"""
COMMANDS = {
    "demo": ("demo", "--n", "100", "--out", "OUT"),
    "demo of an aircraft": ("demo", "aircraft", "--n", "50", "--out", "OUT"),
    "study": ("study", "FLIGHT/terrain.toml", "--runs", "200", "--steps", "50", "--out", "OUT"),
    "run": ("run", "FLIGHT/terrain.toml", "--out", "OUT"),
    "plan": ("plan", "FLIGHT/terrain.toml", "--budget", "2.5ms", "--steps", "30", "--runs", "4"),
}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """The demonstration's flight and map, for commands that ask for a file."""
    place = tmp_path_factory.mktemp("flight") / "out"
    ended = started("from motes.cli.main import main; main()", "demo", "--n", "100", "--out", place)
    ended.communicate()
    assert ended.returncode == 0
    return place


@pytest.mark.night
@pytest.mark.parametrize("name", each(list(COMMANDS), set(COMMANDS) - {"demo"}))
def test_interruptions_at_random_moments(name, request, tmp_path):
    """20 each by night, one by day; the last moments may be after the end."""
    chance = random.Random(len(name))  # noqa: NPY002
    for number in range(20 if NIGHT else 1):
        out = tmp_path / f"out{number}"
        words = [word.replace("OUT", str(out)) for word in COMMANDS[name]]
        if name in ("run", "plan", "study"):
            words[1] = words[1].replace("FLIGHT", str(request.getfixturevalue("flight")))
        process = started("from motes.cli.main import main; main()", *words)
        time.sleep(0.5 + chance.uniform(0, 12.0 if NIGHT else 4.0))
        if process.poll() is None:
            _, err, _ = interrupted(process)
            assert process.returncode == 130 and err.splitlines()[-1].startswith(f"motes {words[0]}: interrupted"), err
            # a run that took a while is kept, and that is said
            left, kept = ([path for path in tmp_path.rglob(".*") if path.name.endswith(ENDING) is there] for there in (False, True))
            assert "Traceback" not in err and not left, err
            assert "goes on from there" in err or not [path for path in kept if out in path.parents], err
        else:
            assert not process.communicate()[1].count("Traceback") and process.returncode == 0


@pytest.mark.night  # twenty processes
def test_sampling_interrupted_keeps_its_draws(tmp_path):
    """A program of the user's: it goes on after `sample` with the draws so far, or has none and ends by the interruption."""
    chance = random.Random(7)  # noqa: NPY002
    kept = []
    for _ in range(20):
        process = started(SAMPLING, tmp_path)
        time.sleep(1.5 + chance.uniform(0, 12.0))
        out, err, _ = interrupted(process)
        if out:
            kept.append(int(out))
            assert process.returncode == 0 and mo.Chains.load(tmp_path / "chains.npz").positions.size == kept[-1]
        else:
            assert process.returncode in (130, -signal.SIGINT) and "Interrupt" in err, err
    assert kept
