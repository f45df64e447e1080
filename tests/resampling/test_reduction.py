"""Reduction of hypotheses: none twice, few are all kept, weights are unchanged on average, and the heaviest are never lost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from motes.resampling.reduction import reduced
from tiers import each

MANY = jax.jit(jax.vmap(reduced, in_axes=(0, None, None)), static_argnums=2)
DRAWS = 4000


def log(weights):
    with np.errstate(divide="ignore"):
        return jnp.log(jnp.asarray(weights / np.sum(weights)))


def weights_of(kind, count=40):
    rng = np.random.default_rng(7)
    return {
        "uneven": rng.exponential(size=count) ** 4,
        "equal": np.ones(count),
        "one holds nearly all": np.r_[np.full(count - 1, 1e-6), 1.0],
        "halves": np.r_[np.full(count // 2, 0.975), np.full(count // 2, 0.025)],
        "many without weight": np.where(np.arange(count) % 3 == 0, rng.exponential(size=count), 0.0),
    }[kind]


def after(kind, n):
    """Weights `(draws, hypotheses)` that are left, and the weights before."""
    log_weights = log(weights_of(kind))
    found = MANY(jax.random.split(jax.random.key(0), DRAWS), log_weights, n)
    left = np.exp(np.asarray(found.log_weights, np.float64))
    table = np.zeros((DRAWS, log_weights.shape[0]))
    for row, places, amounts in zip(table, np.asarray(found.ancestors), left, strict=True):
        used = amounts > 0
        assert len(set(places[used])) == used.sum()
        row[places[used]] = amounts[used]
    return table, np.exp(np.asarray(log_weights, np.float64))


@pytest.mark.parametrize("kind", each(["uneven", "equal", "one holds nearly all", "halves", "many without weight"], {"equal", "halves"}))
@pytest.mark.parametrize("n", [1, 7])
def test_weights_are_unchanged_on_average(kind, n, precision):
    """At level 1e-6 for each hypothesis; a weight is either kept or becomes one and the same number for all."""
    table, weights = after(kind, n)
    rounding = 2e-6 if precision == "float32" else 1e-12
    assert np.allclose(table.sum(axis=1), 1, atol=10 * rounding)
    assert ((table > 0).sum(axis=1) == n).all() and not table[:, weights == 0].any()
    # a weight w becomes the threshold with probability w / threshold; few draws of a rare one are no normal number
    slack = 5.5 * np.sqrt(weights * table.max() / DRAWS) + 8 * table.max() / DRAWS
    assert np.all(np.abs(table.mean(axis=0) - weights) < slack)
    kept = (table > 0).all(axis=0) & (n > 1)
    threshold = table[:, ~kept].max()
    assert np.all(weights[kept] >= threshold - rounding)
    others = table[:, ~kept]
    assert np.allclose(others[others > 0], threshold, rtol=1e-4) and np.allclose(table[:, kept], weights[kept], atol=rounding)


@pytest.mark.parametrize("n", [14, 20])
def test_few_hypotheses_are_all_kept(n):
    weights = weights_of("many without weight")
    assert np.count_nonzero(weights) == 14
    found = jax.tree.map(lambda leaf: leaf[0], MANY(jax.random.key(3)[None], log(weights), n))
    alive = np.isfinite(found.log_weights)
    assert np.array_equal(np.asarray(found.ancestors)[alive], np.flatnonzero(weights)) and alive.sum() == 14
    assert np.allclose(np.exp(found.log_weights[alive]), weights[weights > 0] / weights.sum(), rtol=1e-5)


def test_slopes_are_finite_where_hypotheses_have_no_weight(double):
    def total(scale):
        weights = jnp.asarray(weights_of("many without weight"))
        log_weights = jnp.where(weights > 0, scale * jnp.log(jnp.where(weights > 0, weights, 1)), -jnp.inf)
        return sum(jnp.sum(jnp.exp(reduced(jax.random.key(1), jax.nn.log_softmax(log_weights), n).log_weights)) for n in (5, 20))

    assert np.isfinite(float(jax.jit(jax.grad(total))(1.0)))
