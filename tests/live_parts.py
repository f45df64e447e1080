"""What tests of live runs share: a small model, messages, and a source that gives what it was given."""

import json
import os
import sys

import jax
import numpy as np

import motes as mo
from motes.live.checkpoint import Checkpoint, identity
from motes.live.loop import Run, Work
from motes.live.message import Form, Names
from motes.live.settings import Live
from motes.live.sink import Sink
from motes.live.source import TextSource

FILTER = mo.ParticleFilter(n=64)


def model():
    walk = mo.AdditiveGaussian(lambda x, u, t: x + u["push"] * u["dt"], [[0.3]])
    return mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), walk, mo.AdditiveGaussian(lambda x, u, t: x, [[0.2]]), ("east",))


def form():
    return Form(Names(("a",), ("push",), "t", "k"), timed=True)


def texts(count, seed=0):
    generator = np.random.default_rng(seed)
    return [json.dumps({"k": k, "t": 0.1 * k, "a": generator.normal(), "push": generator.normal()}).encode() for k in range(count)]


class Given(TextSource):
    """Gives lines one after the other, with positions."""

    waits = repeats = True

    def __init__(self, lines, form, together=7):
        super().__init__("given", form)
        self.lines, self.at, self.together = lines, 0, together

    def receive(self, timeout):
        if self.at >= len(self.lines):
            return None
        begin, self.at = self.at, min(len(self.lines), self.at + self.together)
        return [(line, begin + place + 1, None) for place, line in enumerate(self.lines[begin : self.at])]

    def go_on(self, position):
        self.at = position


class Kept(Sink):
    """A sink that keeps records, without what depends on the clock."""

    name = "kept"

    def __init__(self):
        self.records = []

    def write(self, record):
        self.records.append({name: value for name, value in record.items() if name != "seconds"})

    def kept(self):
        return len(self.records)

    def go_on(self, kept, cut):
        self.records = self.records[: kept if cut and kept is not None else None]


def run(lines, path=None, sink=None, filter=FILTER, budget=None, watchers=(), **rules):
    settings, shape = Live(**rules), form()
    checkpoint = None if path is None else Checkpoint(path, identity(source="-", seed=1))
    return Run(Work(1, filter, MODEL, shape), Given(lines, shape), settings, sinks=[sink or Kept()], watchers=watchers,
               checkpoint=checkpoint, budget=budget)  # fmt: skip


MODEL = model()


def went(lines, **rules):
    """Records and run of all lines."""
    sink = Kept()
    found = run(lines, sink=sink, **rules)
    found.go(lambda: False)
    return sink.records, found


def held(found):
    """All arrays of where a stream stands."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(found.stream.held.whole())]


def same(one, two):
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(held(one), held(two), strict=True))


def command(*words):
    """Words that start the command in a process of its own, and its surroundings."""
    # a shell that starts the suite in its background has interruptions ignored
    heard = ("import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
             "from motes.cli.main import main; sys.exit(main())")  # fmt: skip
    return [sys.executable, "-c", heard, *map(str, words)], os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


MODEL_FILE = """
import jax.numpy as jnp
import motes as mo


def make():
    walk = mo.LinearGaussian(jnp.eye(2), 0.1 * jnp.eye(2))
    sensor = mo.LinearGaussian(jnp.eye(2), jnp.eye(2))
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(2), jnp.eye(2)), walk, sensor, names=("east", "north"))
"""
SETTINGS = """
application = "model.py:make"
out = "out"

[data]
columns = ["a", "b"]

[filter]
kind = "particle"
n = 50

[live]
time = "t"
number = "k"
sinks = ["track.jsonl"]
checkpoint = {checkpoint}
source = "{source}"
"""


def folder_of(folder, source="in.jsonl", checkpoint=0.05, lines=0, swapped=()):
    """Write a user's files, with a file of so many messages; some of them trade places."""
    (folder / "model.py").write_text(MODEL_FILE)
    (folder / "own.toml").write_text(SETTINGS.format(source=source, checkpoint=checkpoint))
    generator = np.random.default_rng(3)
    rows = [json.dumps({"k": k, "t": 0.1 * k, "a": generator.normal(), "b": generator.normal()}) for k in range(lines)]
    for place in swapped:
        rows[place], rows[place + 3] = rows[place + 3], rows[place]
    (folder / "in.jsonl").write_text("".join(row + "\n" for row in rows))
    return folder / "own.toml"


def records(path):
    """The lines of a sink, without what depends on the clock; each must be whole."""
    text = path.read_text()
    assert text == "" or text.endswith("\n")
    return [{name: value for name, value in json.loads(line).items() if name != "seconds"} for line in text.splitlines()]
