"""By night: the robot from UDP at 1 kHz, with messages lost, twice and late; and a million steps in flat memory."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import motes as mo
from live_parts import FILTER, MODEL, form
from motes.applications.robot.job import load
from motes.applications.robot.settings import Settings
from motes.cli.live import form_of
from motes.live.loop import Run, Work
from motes.live.settings import Live
from motes.live.sink import Sink
from motes.live.source import TextSource
from motes.live.udp import Datagrams

SENDER = """
import socket, sys, time
port, rate = int(sys.argv[1]), float(sys.argv[2])
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
began = time.monotonic()
for place, line in enumerate(open(sys.argv[3], "rb")):
    wait = began + place / rate - time.monotonic()
    if wait > 0:
        time.sleep(wait)
    sender.sendto(line, ("127.0.0.1", port))
"""


def resident():
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def disturbed(rows, generator, share=0.01, later=5):
    """Rows in the order in which they are sent: some never, some twice, some later by a few places. And how many came at all."""
    lost, twice, late = (generator.random(len(rows)) < share for _ in range(3))
    late &= ~lost & (np.arange(len(rows)) > later)
    order = [(place + (generator.integers(1, later + 1) + 0.5 if late[place] else 0.0), row)
             for place, row in enumerate(rows) if not lost[place]]  # fmt: skip
    order += [(place + generator.integers(1, later + 1) + 0.7, row) for place, row in enumerate(rows) if twice[place] and not lost[place]]
    return [row for _, row in sorted(order, key=lambda one: one[0])], int((~lost).sum()), int((twice & ~lost).sum())


class Record(Sink):
    """A sink that keeps times of steps, and memory now and then."""

    name = "record"

    def __init__(self, count):
        self.seconds, self.backs, self.steps = np.zeros(count), np.zeros(count, int), 0
        self.memory = {}

    def write(self, record):
        self.seconds[self.steps], self.backs[self.steps] = record["seconds"], record["late"]
        self.steps += 1
        if self.steps % 10_000 == 0:
            self.memory[self.steps] = resident()


def robot_from_udp(folder, steps, rate, n):
    """Run the robot's job on messages at a rate; return the sink, the run, and how many messages came, how many of them twice."""
    job = load(Settings(seconds=steps * 0.1538 + 60), 0)
    assert len(job.times) >= steps
    ys, forward, turn = np.asarray(job.ys), np.asarray(job.inputs.forward), np.asarray(job.inputs.turn)
    rows = [json.dumps({"k": k, "time": float(job.times[k]), "y": [None if one != one else round(float(one), 3) for one in ys[k]],
                        "forward": float(forward[k]), "turn": float(turn[k])}) for k in range(steps)]  # fmt: skip
    rows, came, twice = disturbed(rows, np.random.default_rng(1))
    (folder / "rows").write_text("\n".join(rows) + "\n")
    shape = form_of(job, None, Live(number="k"))
    source, sink = Datagrams("udp", shape, "127.0.0.1", 0), Record(steps)
    filter = mo.MarginalizedParticleFilter(n=n, linear=("scale", "offset"))
    run = Run(Work(0, filter, job.model, shape), source, Live(number="k"), sinks=[sink])
    sender = subprocess.Popen([sys.executable, "-c", SENDER, str(source.port), str(rate), str(folder / "rows")])
    quiet = [time.monotonic(), 0]

    def ends():
        if sink.steps != quiet[1] or sender.poll() is None:
            quiet[:] = time.monotonic(), sink.steps
        return time.monotonic() - quiet[0] > 3

    run.go(ends)
    assert sender.wait() == 0
    return sink, run, came, twice


def told(sink, run, came, twice):
    """The figures in words."""
    seconds, backs = sink.seconds[: sink.steps], sink.backs[: sink.steps]
    percent = {name: np.round(1e3 * np.quantile(part, [0.5, 0.9, 0.99, 0.999, 1.0]), 2).tolist()
               for name, part in (("all", seconds), ("in order", seconds[backs == 0]), ("late", seconds[backs > 0]))}  # fmt: skip
    return f"{came} came, {twice} twice; {run.counts.told()} ms {percent}; memory {sink.memory}"


@pytest.mark.night
def test_the_robot_from_udp_at_a_thousand_a_second(tmp_path):
    sink, run, came, twice = robot_from_udp(tmp_path, 200_000, 1_000, 2_000)
    print(told(sink, run, came, twice))
    assert sink.steps == run.counts.of["steps"] == came and run.counts.of["duplicates"] == twice and not run.counts.of["overrun"]
    assert abs(sink.memory[max(sink.memory)] / sink.memory[10_000] - 1) < 0.05
    assert np.quantile(sink.seconds[: sink.steps], 0.99) < 5e-3


def test_a_thousand_steps_of_the_robot_from_udp_by_day(tmp_path):
    sink, run, came, twice = robot_from_udp(tmp_path, 1_000, 2_000, 100)
    assert sink.steps == run.counts.of["steps"] == came and run.counts.of["duplicates"] == twice and run.counts.of["late"] >= 5
    assert run.stream.t + 1 == came and not run.counts.of["overrun"]


@pytest.mark.night
def test_memory_is_flat_over_a_million_steps():
    class Endless(TextSource):
        waits = True
        at = 0

        def receive(self, timeout):
            self.at += 100
            return None if self.at > 1_000_000 else [
                (b'{"k": %d, "t": %d, "a": 0.1, "push": 0.0}' % (k, k), None, None) for k in range(self.at - 100, self.at)]  # fmt: skip

    sink, shape = Record(1_000_000), form()
    Run(Work(1, FILTER, MODEL, shape), Endless("endless", shape), Live(number="k"), sinks=[sink]).go(lambda: False)
    assert sink.steps == 1_000_000 and abs(sink.memory[1_000_000] / sink.memory[10_000] - 1) < 0.05


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        print(told(*robot_from_udp(Path(place), int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))))
