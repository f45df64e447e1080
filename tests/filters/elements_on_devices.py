"""A program with eight host devices: runs of a `Distributed` filter on 1, 2, 4 and 8 of them, and what they exchange. Prints JSON.

Arguments: JSON of a list of cases, each a list of filter, particles, exchange and numbers of devices, of the word "bytes" and particles,
of "chains", of "messages", or of "derivatives" and exchange.
"""

import json
import re
import sys
import tempfile
import warnings
from pathlib import Path

import jax
import numpy as np

import motes as mo
from motes.core.devices import shared_out
from motes.filters.setup import setup

SIZES = {"f32": 4, "s32": 4, "u32": 4, "f64": 8, "pred": 1}


def model_and_filter(name, n):
    if name == "particle":
        return mo.textbook.growth(), mo.ParticleFilter(n=n)
    if name == "marginalized":
        return mo.textbook.radar_tracking(), mo.MarginalizedParticleFilter(n=n)
    return mo.textbook.constant_velocity(), mo.ParticleFilter(n=n, proposal=mo.OptimalProposal())


def numbers(*trees):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(trees)]


def recorded(history):
    """The record of each step but for the alarm's squares, which JAX may round otherwise where a device has one element alone."""
    return mo.replace(history.info, nis=0.0, freedom=0.0)


def streamed(filter, model, ys):
    """The last law, mean and covariance of a stream, and the evidence of each step."""
    stream, evidence = mo.stream(1, filter, model), []
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        evidence.append(stream.update(y).log_evidence)
    return numbers(stream.mean, stream.cov, stream.state), np.stack(evidence)


def bits(name, n, exchange, counts):
    """Names of what differs from the run on one device; where there are several numbers of them, also of what goes on after a half."""
    model, inner = model_and_filter(name, n)
    filter = mo.Distributed(inner, elements=8, exchange=getattr(mo, exchange)())
    ys = np.array(mo.simulate(0, model, 6)[1])
    ys[3] = np.nan
    alone = mo.run(1, filter, model, ys, keep=mo.keep.laws)
    last = jax.tree.map(lambda leaf: leaf[-1], (alone.mean, alone.cov, alone.law))
    wrong = []

    def ask(what, one, other):
        if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True)):
            wrong.append(what)

    for count in counts:
        with mo.devices(count):
            found = mo.run(1, filter, model, ys, keep=mo.keep.laws)
            half = mo.run(1, filter, model, ys[:3], keep=mo.keep.means) if len(counts) > 1 else None
            ask(f"run on {count}", numbers(found.kept, recorded(found)), numbers(alone.kept, recorded(alone)))
            law, evidence = streamed(filter, model, ys)
            ask(f"stream on {count}", [*law, evidence], [*numbers(*last), np.asarray(alone.log_evidence)])
        if alone.label != found.label:
            wrong.append("label")
        if half is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            kept = mo.History.load(half.save(Path(folder) / "half.npz"))
        for what, before in (("resumed", half), ("saved, resumed", kept)):
            rest = mo.run(1, filter, model, ys[3:], after=before)
            ask(f"{what} after {count}", numbers(rest.mean, rest.cov, rest.state), numbers(alone.mean[3:], alone.cov[3:], alone.state))
    return wrong


def chains():
    """Names of what differs from chains on one device; more devices than divide them are refused."""
    def drawn(count):
        with mo.devices(count):
            return numbers(mo.sample(1, mo.mcmc.RandomWalkMetropolis(), lambda x: -(x @ x), np.zeros(2), draws=20, chains=8, burn_in=20))

    alone = drawn(1)
    wrong = [f"chains on {count}" for count in (2, 8) if not all(map(np.array_equal, drawn(count), alone))]
    try:
        drawn(3)
    except mo.MotesError as reason:
        return wrong if "devices count: expected a divisor of the number of chains, 8, got 3" in str(reason) else [str(reason)]
    return [*wrong, "three devices"]


def derivatives(exchange):
    """Whether the derivative of the log likelihood is another on two devices than on one."""
    ys = np.array([[1.0], [2.0], [0.5]], np.float32)

    def derivative(count):
        filter = mo.Distributed(mo.ParticleFilter(n=32), 2, getattr(mo, exchange)())

        def likelihood(mean):
            walk = mo.LinearGaussian(np.eye(1), np.eye(1))
            return mo.run(1, filter, mo.StateSpaceModel(mo.Gaussian(mean, np.eye(1)), walk, walk), ys).log_likelihood

        with mo.devices(count):
            return jax.grad(likelihood)(np.ones(1, np.float32))

    return [] if np.allclose(derivative(1), derivative(2), rtol=1e-4) else ["another"]


def messages():
    """Whether a derivative is lost on the way from device to device."""
    def total(x):
        return shared_out(lambda crew, cut, whole: ([], crew.gathered(cut[0] ** 2)), 2, [x], [], [])[1].sum()

    with mo.devices(2):
        return [] if np.allclose(jax.grad(total)(np.ones(2, np.float32)), 2) else ["lost"]


def shape_bytes(text):
    return sum(SIZES[kind] * int(np.prod([int(d) for d in dims.split(",") if d], dtype=np.int64))
               for kind, dims in re.findall(r"\b(f32|s32|u32|f64|pred)\[([\d,]*)\]", text))  # fmt: skip


def exchanged(n):
    """Bytes that each device sends and receives to predict, by the compiled program, on the way by strips; and the largest message."""
    model = mo.textbook.radar_tracking()
    filter = mo.Distributed(mo.ParticleFilter(n=n), elements=8)
    key = jax.random.key(0)
    ready = setup(key, filter, model, None, np.zeros(2, np.float32)).model
    law = filter.init(key, ready)
    with mo.devices(8):
        text = jax.jit(lambda law: filter.predict(key, ready, law, None, 1)).lower(law).compile().as_text()
    blocks = set(re.findall(r"body=%?([\w.\-]+)", text))
    found = []
    for part in re.split(r"\n(?=%|ENTRY)", text):
        name = re.match(r"(?:ENTRY )?%?([\w.\-]+)", part)
        if name and name.group(1) not in blocks:
            lines = re.findall(r"= (.*?) (?:all-gather|all-reduce|collective-permute|all-to-all|reduce-scatter)(?:-start)?\(", part)
            found += [shape_bytes(line) for line in lines]
    return {"all": sum(found), "largest": max(found), "whole blocks": len(blocks), "own": filter.sent(model, 8)}


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    kinds = {"bytes": exchanged, "chains": chains, "derivatives": derivatives, "messages": messages}
    answers = [kinds[case[0]](*case[1:]) if case[0] in kinds else bits(*case) for case in json.loads(sys.argv[1])]
    print(json.dumps(answers))
