"""Measurements that come late, and recordings that are longer than memory."""

import subprocess
import sys
from itertools import islice

import numpy as np
import pytest

import motes as mo
from tiers import each

STEPS, LAG = 30, 5
MODEL = mo.textbook.constant_velocity()
XS, YS = (np.array(drawn) for drawn in mo.simulate(1, MODEL, STEPS))
FILTERS = {
    "Kalman": mo.KalmanFilter(), "particle": mo.ParticleFilter(n=200), "auxiliary": mo.AuxiliaryParticleFilter(n=200),
    "marginalized": mo.MarginalizedParticleFilter(n=100, linear=("vx", "vy")),
}  # fmt: skip
DELAYS = np.random.default_rng(0).integers(0, LAG + 1, STEPS)
DELAYS[[0, STEPS - 1]] = 0


def delayed(stream, ys=YS):
    """Feed measurements, each so many steps late."""
    for t in range(STEPS):
        if t:
            stream.predict()
        if DELAYS[t] == 0:
            stream.update(ys[t])
        for late in range(max(0, t - LAG), t):
            if late + DELAYS[late] == t:
                stream.insert(ys[late], late)
    for late in range(STEPS - LAG, STEPS):
        if late + DELAYS[late] >= STEPS:
            stream.insert(ys[late], late)


@pytest.mark.optimized
@pytest.mark.parametrize("name", each(list(FILTERS), {"auxiliary", "marginalized"}))
def test_late_measurements_equal_those_in_order_to_the_bit(name):
    stream = mo.stream(3, FILTERS[name], MODEL, lag=LAG)
    delayed(stream)
    wanted = mo.run(3, FILTERS[name], MODEL, YS)
    assert np.array_equal(stream.mean, wanted.mean[-1]) and np.array_equal(stream.cov, wanted.cov[-1])
    assert float(stream.log_likelihood) == float(wanted.log_likelihood)


def test_a_component_can_come_late():
    stream, ys = mo.stream(3, mo.KalmanFilter(), MODEL, lag=2), YS[:4]
    for t, y in enumerate(ys):
        if t:
            stream.predict()
        stream.update([y[0], np.nan])
        if t:
            stream.insert([np.nan, ys[t - 1][1]], t - 1)
    stream.insert([np.nan, ys[3][1]], 3)
    np.testing.assert_allclose(stream.mean, mo.run(3, mo.KalmanFilter(), MODEL, ys).mean[-1], rtol=1e-5)


@pytest.mark.parametrize(("insert", "words"), [
    ((YS[0], 0), r"insert t: expected one of the steps 3 to 5, got 0. Start the stream with a larger lag="),
    ((YS[0], 7), "insert t: expected one of the steps 3 to 5, got 7"),
    ((YS[0], 4), r"insert y: expected what was not measured at that step, got component \[0\]"),
])  # fmt: skip
def test_what_cannot_come_late_is_refused_and_nothing_is_lost(insert, words):
    stream = mo.stream(3, mo.KalmanFilter(), MODEL, lag=2)
    for t in range(6):
        if t:
            stream.predict()
        stream.update(YS[t])
    before = np.asarray(stream.mean)
    with pytest.raises(mo.MotesError, match=words):
        stream.insert(*insert)
    assert np.array_equal(stream.mean, before)
    with pytest.raises(mo.MotesError, match="stream lag: expected a whole number"):
        mo.stream(3, mo.KalmanFilter(), MODEL, lag=-1)


@pytest.mark.optimized
def test_iterators_give_what_arrays_give(monkeypatch):
    monkeypatch.setattr("motes.filters.pieces.STEPS", 7)
    filter, gappy = FILTERS["particle"], YS.copy()
    gappy[4] = np.nan
    whole = mo.run(3, filter, MODEL, gappy)
    rows = [None if t == 4 else y for t, y in enumerate(YS)]
    for given in (iter(rows), (row for row in gappy), iter([list(gappy[:11]), gappy[11], gappy[12:]])):
        found = mo.run(3, filter, MODEL, given)
        assert np.array_equal(found.mean, whole.mean) and found.info.ess.shape == (STEPS,)
    driven = mo.StateSpaceModel(MODEL.initial, mo.AdditiveGaussian(lambda x, u, t: x + u, np.eye(4)), MODEL.sensor)
    u = np.ones((STEPS, 4), np.float32)
    wanted = mo.run(3, filter, driven, YS, u)
    for inputs in (u, iter(u)):
        assert np.array_equal(mo.run(3, filter, driven, iter(YS), inputs).mean, wanted.mean)
    for few in (u[:9], iter(u[:9])):
        with pytest.raises(mo.MotesError, match="inputs"):
            mo.run(3, filter, driven, iter(YS), few)
    with pytest.raises(mo.MotesError, match="ys: expected at least one measurement"):
        mo.run(3, filter, MODEL, iter([]))


CLIP = """
import resource, sys
import jax.numpy as jnp, numpy as np
import motes as mo

def frames(count):
    frame = np.zeros((432, 768, 3), np.uint8)
    for t in range(count):
        frame = np.roll(frame, 1, axis=1)
        frame[200, t % 768] = 255
        yield frame.copy()

def log_prob(frame, x, u, t):
    return -0.5 * ((frame[200, jnp.clip(x[0], 0, 767).astype(int), 0] - 255.0) / 100) ** 2

model = mo.StateSpaceModel(mo.Gaussian(np.array([5.0]), np.eye(1)), mo.LinearGaussian(np.eye(1), np.eye(1)), mo.Custom(log_prob=log_prob))
mo.run(0, mo.ParticleFilter(n=200), model, frames(40))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
history = mo.run(0, mo.ParticleFilter(n=200), model, frames(int(sys.argv[1])))
print(history.mean.shape[0], (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


@pytest.mark.optimized
def test_a_clip_longer_than_memory_takes_little():
    """1 000 frames of a megabyte each stay below 300 MB above the start."""
    done = subprocess.run([sys.executable, "-c", CLIP, "1000"], capture_output=True, text=True, check=True, timeout=500)
    steps, megabytes = done.stdout.split()
    assert int(steps) == 1000 and float(megabytes) < 300


def test_iterators_are_not_run_ahead():
    """A device that gives one measurement after the other is asked for no more than a piece at a time."""
    asked = []

    def device():
        for t, y in enumerate(YS):
            asked.append(t)
            yield y

    mo.run(3, mo.KalmanFilter(), MODEL, islice(device(), 5))
    assert asked == [0, 1, 2, 3, 4]
