"""Track before detect (the example) against the exact forward filter on a fine grid: a target of known motion and peak in small frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, t

import motes as mo
from examples_of import importable
from motes.laws.observed import Observed

LEVEL = 1e-6
STEPS, PEAK, FINE = 12, 2.0, 4
"""Frames, peak over the noise, and grid cells on each side of a pixel."""
THERE = range(3, 9)


@pytest.fixture(scope="module")
def example():
    """Put the folder of the example on the import path while its modules are tested."""
    with importable("track_before_detect"):
        yield {name: __import__(name) for name in ("model", "plots", "trials")}


@pytest.fixture(scope="module")
def target(example):
    """Velocity and peak are known but for what the exact answer does not see."""
    return example["model"].Target(size=8, appears=0.1, vanishes=0.1, velocity=(0.5, 0.25), speed=1e-4, wander=(0.3, 1e-5),
                                   peaks=(PEAK, PEAK + 1e-4), flicker=1e-5)  # fmt: skip


@pytest.fixture(scope="module")
def film(target):
    random = np.random.default_rng(4)
    frames = random.normal(size=(STEPS, target.size, target.size))
    for step in THERE:
        column, row = 1.2 + 0.5 * (step - THERE[0]), 2.9 + 0.25 * (step - THERE[0])
        frames[step] += PEAK * np.outer(shares(row, target.size), shares(column, target.size))
    return frames.astype(np.float32)


def shares(place, size):
    """Light of a target in each pixel of a line, as far as it counts."""
    pixels = np.arange(size)
    return np.where(np.abs(pixels - np.round(place)) <= 3, np.exp(-0.5 * (pixels - place) ** 2), 0)


def forward(target, film):
    """Filter on a grid: log evidence up to each frame `(t,)`, probability of existence `(t,)` and of its place, mean `(t, 2)`."""
    places = -4 + (np.arange(18 * FINE) + 0.5) / FINE
    inside = (places > -0.5) & (places < target.size - 0.5)
    newborn = np.outer(inside, inside) / inside.sum() ** 2

    def moving(speed):
        step = norm.pdf(places[:, None] - places - speed, scale=target.wander[0])
        return step / FINE

    right, down = (moving(speed) for speed in target.velocity)
    light = np.stack([shares(place, target.size) for place in places])
    energy = np.sum(light**2, axis=1)
    gone, there, total, found = 1.0, np.zeros((len(places), len(places))), 0.0, []
    for step, frame in enumerate(film):
        if step:
            born = target.appears * gone
            gone = (1 - target.appears) * gone + target.vanishes * there.sum()
            there = (1 - target.vanishes) * down @ there @ right.T + born * newborn
        ratio = np.exp(PEAK * (light @ frame.astype(float) @ light.T) - 0.5 * PEAK**2 * np.outer(energy, energy))
        there = there * ratio
        evidence = gone + there.sum()
        gone, there, total = gone / evidence, there / evidence, total + np.log(evidence)
        found.append((total, there.sum(), places @ there.sum(axis=0), places @ there.sum(axis=1)))
    return np.array(found)


def test_existence_and_place_equal_the_exact_ones(example, target, film):
    """Evidence is estimated without bias, and so are existence and place, each times the evidence: mean over 64 runs, in all frames."""
    exact = forward(target, film)
    assert exact[2, 1] < 0.5 < 0.95 < exact[THERE[-1], 1] and exact[-1, 1] < 0.3
    model = example["model"].tracking(target, example["model"].frames(target))
    ys = Observed(jnp.asarray(film), jnp.ones(STEPS, bool))

    for filter in (example["model"].tracker(target, 2_000), mo.ParticleFilter(n=4_000)):
        def one(key, filter=filter):
            history = mo.run(key, filter, model, ys, keep=example["model"].existence)
            return jnp.cumsum(history.info.log_evidence), history.kept["exists"], history.kept["place"]

        logs, exists, place = (np.asarray(each, float) for each in jax.jit(lambda keys: jax.lax.map(one, keys))(
            jax.random.split(jax.random.key(1), 64)))  # fmt: skip
        weights = np.exp(logs - exact[:, 0])
        drawn = np.stack([weights, weights * exists, *np.moveaxis(weights[..., None] * exists[..., None] * place, -1, 0)])
        wanted = np.stack([np.ones(STEPS), exact[:, 1], exact[:, 2], exact[:, 3]])
        error = drawn.std(axis=1, ddof=1) / np.sqrt(64)
        # the first frame is that of no target, whatever is drawn
        off = np.abs(drawn.mean(axis=1) - wanted)[:, 1:] / error[:, 1:]
        assert off.max() < t.isf(LEVEL / (2 * off.size), 63), off.round(1)
        assert error[1].max() < 0.08 and error.max() < 0.3


def test_plots_stand_where_targets_are(example):
    target = example["model"].Target()
    states = jnp.array([[4.3, 17.6, 0, 0, 30.0, 1.0], [20.0, 2.2, 0, 0, 30.0, 1.0]])
    film = jnp.moveaxis(example["model"].frames(target).sample(jax.random.key(0), states.T, None, 0), -1, 0)
    found = np.asarray(example["plots"].plots(target, film, 10.0, 5))
    assert np.isnan(found[:, 1:]).all()
    np.testing.assert_allclose(found[:, 0], states[:, :2], atol=0.15)
    noise = np.asarray(example["plots"].matched(target, jax.random.normal(jax.random.key(1), (400, 24, 24))))
    np.testing.assert_allclose(noise.std(axis=0), 1, atol=6 / np.sqrt(2 * 400))


def test_tracks_are_counted_as_said(example):
    trials = example["trials"]
    exists = np.zeros((2, trials.STEPS))
    exists[0, [3, 4, 5, 9, 10]] = [0.95, 0.5, 0.06, 0.95, 0.2]
    assert trials.false_tracks(exists, 0.9) == 2 and trials.false_tracks(exists, 0.96) == 0
    assert trials.declared(exists, 0.9)[0, :12].tolist() == [False] * 3 + [True] * 3 + [False] * 3 + [True] * 2 + [False]
    truth = np.zeros((2, trials.STEPS, 6))
    truth[:, trials.APPEARS : trials.VANISHES, 5] = 1
    exists = np.zeros((2, trials.STEPS))
    exists[0, trials.APPEARS + 4 : trials.VANISHES + 3] = 1
    exists[0, trials.APPEARS + 10 : trials.APPEARS + 16] = 0
    score, held, _ = trials.scored(trials.Found(exists, np.zeros((2, trials.STEPS, 2))), 0.9, truth)
    life = trials.VANISHES - trials.APPEARS
    assert (score.missed, score.delay, score.lost, score.after) == (1, (4 + life) / 2, 1, 3)
    assert held[0].sum() == life - 10 and not held[1].any()
