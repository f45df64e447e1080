"""Cost-reference particle filter: its recursion worked out again in NumPy, and its claim, to need no law of the noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

pytestmark = pytest.mark.jax

BEACONS = np.array([[-6.0, -4.0], [7.0, -5.0], [0.0, 9.0]])


def ranges(x, u, t):
    return jnp.hypot(x[0] - BEACONS[:, 0], x[1] - BEACONS[:, 1])


def beacons(law=None):
    """A slow walk seen by its distance from three beacons; Gaussian noise where no law is given."""
    sensor = mo.AdditiveNoise(ranges, law) if law else mo.AdditiveGaussian(ranges, 0.09 * np.eye(3))
    dynamics = mo.AdditiveGaussian(lambda x, u, t: 0.97 * x, [[0.2, 0.05], [0.05, 0.1]])
    return mo.StateSpaceModel(mo.Gaussian([1.0, 0.5], 4 * np.eye(2)), dynamics, sensor)


def mass(phi, costs):
    if isinstance(phi, mo.resampling.InverseCost):
        return 1 / costs
    return 1 / (costs - costs.min() + phi.delta) ** phi.beta


CASES = {
    "squares": mo.CostReferenceParticleFilter(n=64, forgetting=0.8, scale=(0.4, 0.2), adaptive=True),
    "distances": mo.CostReferenceParticleFilter(n=64, q=1, phi=mo.resampling.InverseCost(), forgetting=0.6, scale=0.3),
    "sharp": mo.CostReferenceParticleFilter(n=64, phi=mo.resampling.InverseExcess(delta=0.1, beta=1.0), estimate="minimum cost"),
    "local": mo.CostReferenceParticleFilter(n=64, q=1, selection="local", scale=0.3),
}


@pytest.mark.parametrize("filter", each(CASES, {"squares", "local"}))
def test_every_step_obeys_the_recursion(filter, double):
    """Risks and costs, selection, adapted scale and estimates, from the particles that the filter drew."""
    model = beacons()
    ys = np.array(mo.simulate(1, model, 16)[1])
    ys[5, 1] = np.nan
    laws = jax.tree.map(np.asarray, mo.run(2, filter, model, ys, keep=mo.keep.laws).kept)
    law, means = laws["law"], laws["mean"]
    h = jax.vmap(lambda x: ranges(x, None, 0), -1, -1)

    def total(t):
        return law.costs[t] + law.least[t]

    def increment(t, X):
        square = np.nansum((ys[t][:, None] - np.asarray(h(X))) ** 2, axis=0)
        return square if filter.q == 2 else np.sqrt(square)

    assert np.allclose(total(0), increment(0, law.particles[0]))
    scale = np.sqrt([0.2, 0.1]) if filter.scale is None else np.broadcast_to(filter.scale, 2)
    for t in range(1, 16):
        parent, X = law.ancestors[t], law.particles[t]
        assert np.allclose(total(t), filter.forgetting * total(t - 1)[parent] + increment(t, X))
        risk = filter.forgetting * total(t - 1) + increment(t, 0.97 * law.particles[t - 1])
        if filter.selection == "local":
            around = np.stack([risk, np.roll(risk, 1), np.roll(risk, -1)])
            assert np.allclose(risk[parent], around.min(axis=0))
        else:
            expected = 64 * mass(filter.phi, risk) / mass(filter.phi, risk).sum()
            assert np.abs(np.bincount(parent, minlength=64) - expected).max() < 1 + 1e-9
        before, steps = law.spread[t - 1][parent], (X - 0.97 * law.particles[t - 1][:, parent]) / scale[:, None]
        followed = np.sqrt(((t - 1) * before**2 + (steps**2).sum(axis=0) / 2) / t)
        assert np.allclose(law.spread[t], followed if filter.adaptive and t > 10 else before)
        weights = mass(filter.phi, total(t))
        assert np.allclose(np.exp(law.log_weights[t]), weights / weights.sum())
        best = X[:, np.argmin(total(t))]
        assert np.allclose(means[t], best if filter.estimate == "minimum cost" else X @ weights / weights.sum())
    # steps have the size asked for: 15 x 128 numbers, level 1e-6
    walked = (law.particles[1] - 0.97 * law.particles[0][:, law.ancestors[1]]) / scale[:, None]
    assert 0.5 < np.mean(walked**2) < 1.6


@pytest.mark.night
def test_beats_a_filter_that_takes_heavy_tails_for_gaussian():
    """100 paired runs of 40 steps with Student t noise of 1.2 degrees of freedom, told to both as Gaussian of that scale."""
    truth, assumed = beacons(mo.StudentT([0.3] * 3, 1.2)), beacons()
    filters = (
        mo.CostReferenceParticleFilter(n=300, q=1, phi=mo.resampling.InverseExcess(delta=0.3)),
        mo.ParticleFilter(n=300, on_collapse="predict"),
        mo.ParticleFilter(n=300),
    )

    def errors(key):
        keys = jax.random.split(key)
        xs, ys = mo.simulate(keys[0], truth, 40)
        means = [mo.run(keys[1], f, m, ys).mean for f, m in zip(filters, (assumed, assumed, truth), strict=True)]
        return jnp.stack([jnp.sqrt(jnp.mean(jnp.sum((mean - xs) ** 2, axis=1))) for mean in means])

    found = np.asarray(jax.jit(jax.vmap(errors))(jax.random.split(jax.random.key(4), 100)))
    gain = np.log(found[:, 1] / found[:, 0])
    assert gain.mean() > 5 * gain.std(ddof=1) / 10
    # with the true law of the noise a particle filter is still better, but not by much
    assert found[:, 2].mean() < found[:, 0].mean() < 1.5 * found[:, 2].mean()


def test_has_no_likelihood_and_says_so():
    history = mo.run(0, CASES["squares"], beacons(), mo.simulate(1, beacons(), 5)[1])
    with pytest.raises(mo.MotesError, match="log_likelihood: expected a filter with a likelihood, got CostReference"):
        _ = history.log_likelihood
    with pytest.raises(mo.MotesError, match="expected a filter with a likelihood"):
        _ = history.log_evidence
    stream = mo.stream(0, CASES["squares"], beacons())
    with pytest.raises(mo.MotesError, match="stream.log_likelihood: expected a filter with a likelihood"):
        _ = stream.log_likelihood
