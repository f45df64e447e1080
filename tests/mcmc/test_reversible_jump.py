"""Reversible jump: every template returns the prior, and the exact posterior where it can be enumerated."""

from math import comb, factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.core import random
from motes.core.checks import MotesError
from tiers import each

mcmc = mo.mcmc
CHAINS, STEPS = 5_000, 25
LEVEL = 1e-6


def poisson(mean, most):
    weights = np.array([mean**k / factorial(k) for k in range(most + 1)])
    return weights / weights.sum()


class Components:
    """A number shared by all, and up to five components of two numbers, in a list whose order counts."""

    most, fixed, shares = 5, 1, np.array([0.05, 0.1, 0.3, 0.25, 0.2, 0.1])
    law = mo.Gaussian(jnp.array([1.0, 2.0]), jnp.array([[1.0, 0.3], [0.3, 0.5]]))

    def size(self, model):
        return 1 + 2 * model

    def index(self, model):
        return model

    def log_density(self, c):
        each = self.law.log_prob(c.x[1:].reshape(self.most, 2).T)
        live = jnp.arange(self.most) < c.model
        return jnp.log(jnp.asarray(self.shares))[c.model] + jnp.sum(jnp.where(live, each, 0)) - 0.5 * c.x[0] ** 2

    def drawn(self, key):
        k = jax.random.categorical(random.child(key, 2), jnp.log(jnp.asarray(self.shares)))
        items = self.law.sample(random.child(key, 3), self.most).T
        live = jnp.arange(self.most)[:, None] < k
        return mcmc.Configuration(k, jnp.append(jax.random.normal(random.child(key, 4)), jnp.where(live, items, 0)))

    def jumps(self):
        return mcmc.birth_death(mo.StudentT(jnp.array([2.0, 2.0]), 4.0), self.most, fixed=1)


class Positive(Components):
    """Up to five positive numbers with the law Gamma(2)."""

    fixed, shares = 0, np.array([0.0, 0.1, 0.3, 0.35, 0.15, 0.1])

    def size(self, model):
        return model

    def log_density(self, c):
        each = jnp.where(c.x > 0, jnp.log(jnp.where(c.x > 0, c.x, 1)) - c.x, -jnp.inf)
        return jnp.log(jnp.asarray(self.shares))[c.model] + jnp.sum(jnp.where(jnp.arange(self.most) < c.model, each, 0))

    def drawn(self, key):
        k = jax.random.categorical(random.child(key, 2), jnp.log(jnp.asarray(self.shares)))
        x = jax.random.gamma(random.child(key, 3), 2.0, (self.most,))
        return mcmc.Configuration(k, jnp.where(jnp.arange(self.most) < k, x, 0))

    def jumps(self):
        return mcmc.split_merge(lambda c, u: (c * u, c * (1 - u)), lambda a, b: (a + b, a / (a + b)),
                                mo.Uniform(jnp.zeros(1), jnp.ones(1)), self.most)  # fmt: skip


class Changes:
    """Up to four changes at nine places, the levels between them with the law Gamma(2)."""

    most, places, shares = 4, 9, poisson(1.5, 4)

    def size(self, model):
        return jnp.sum(model) + 1

    def index(self, model):
        return jnp.sum(model)

    def log_density(self, c):
        k = jnp.sum(c.model)
        of_places = jnp.log(jnp.asarray([share / comb(self.places, k) for k, share in enumerate(self.shares)]))
        each = jnp.where(c.x > 0, jnp.log(jnp.where(c.x > 0, c.x, 1)) - c.x, -jnp.inf)
        return of_places[k] + jnp.sum(jnp.where(jnp.arange(self.most + 1) <= k, each, 0))

    def drawn(self, key):
        k = jax.random.categorical(random.child(key, 2), jnp.log(jnp.asarray(self.shares)))
        order = jax.random.permutation(random.child(key, 3), self.places)
        x = jax.random.gamma(random.child(key, 4), 2.0, (self.most + 1,))
        return mcmc.Configuration((order < k).astype(jnp.int32), jnp.where(jnp.arange(self.most + 1) <= k, x, 0))

    def jumps(self):
        return mcmc.change_points(self.most, self.places, reach=2)


TEMPLATES = {"birth and death": Components(), "split and merge": Positive(), "change points": Changes()}


def after_jumps(prior):
    """Start many chains from the prior, and let them jump."""
    kernel = mcmc.ReversibleJump(prior.jumps(), prior.size, within=mcmc.RandomWalkMetropolis(0.6))
    return mo.sample(0, mcmc.Repeat(kernel, STEPS), prior.log_density, prior.drawn, draws=1, chains=CHAINS, burn_in=0)


def p_values(prior, chains):
    """Chi-square of the number of components, and Kolmogorov-Smirnov of single numbers of x against fresh draws."""
    counts = np.asarray(jax.vmap(prior.index)(chains.positions.model[:, 0]))
    seen = np.bincount(counts, minlength=len(prior.shares))
    some = prior.shares > 0
    found = [stats.chisquare(seen[some], prior.shares[some] * CHAINS).pvalue]
    x = np.asarray(chains.positions.x[:, 0])
    keys = jax.vmap(lambda k: random.step_key(random.as_key(77), k))(jnp.arange(4 * CHAINS))
    fresh = jax.vmap(prior.drawn)(keys)
    fresh_counts, fresh_x = np.asarray(jax.vmap(prior.index)(fresh.model)), np.asarray(fresh.x)
    for k in (1, 3):
        for place in range(min(2 * k, x.shape[1])):
            found.append(stats.ks_2samp(x[counts == k, place], fresh_x[fresh_counts == k, place]).pvalue)
    return np.array(found)


@pytest.mark.parametrize("name", each(list(TEMPLATES), {"change points", "birth and death"}))
def test_without_data_the_prior_comes_back(name):
    prior = TEMPLATES[name]
    chains = after_jumps(prior)
    assert p_values(prior, chains).min() > LEVEL
    assert all(rate > 0.05 for rate in chains.acceptance.values())
    if name == "change points":
        model = np.asarray(chains.positions.model[:, 0])
        assert stats.chisquare(model[model.sum(axis=1) == 1].sum(axis=0)).pvalue > LEVEL


def test_a_forgotten_jacobian_is_seen(monkeypatch):
    from motes.mcmc import reversible_jump

    monkeypatch.setattr(reversible_jump, "_live", lambda jacobian, *_: jnp.eye(min(jacobian.shape)))
    assert p_values(TEMPLATES["split and merge"], after_jumps(TEMPLATES["split and merge"])).min() < 1e-12


@pytest.mark.night
def test_probabilities_of_jumps_may_differ_between_models():
    prior = TEMPLATES["birth and death"]
    kernel = mcmc.ReversibleJump(prior.jumps(), prior.size, probabilities=lambda model, x: jnp.array([0.0, 1.0 + 0.5 * model]))
    chains = mo.sample(0, mcmc.Repeat(kernel, STEPS), prior.log_density, prior.drawn, draws=1, chains=CHAINS, burn_in=0)
    assert p_values(prior, chains).min() > LEVEL


@pytest.mark.night
def test_selection_of_variables_by_exact_evidence():
    """Linear regression, three candidate variables, unit noise and N(0, 4) slopes: the evidence of each subset is Gaussian."""
    design = np.random.default_rng(3).normal(size=(12, 3)) @ np.array([[1, 0.7, 0], [0, 1, 0.2], [0, 0, 1]])
    y = design @ np.array([0.9, 0.0, -0.4]) + np.random.default_rng(4).normal(size=12)
    subsets = [np.array([(code >> k) & 1 for k in range(3)], bool) for code in range(8)]
    covs = [np.eye(12) + 4 * design[:, subset] @ design[:, subset].T for subset in subsets]
    evidence = np.array([stats.multivariate_normal(np.zeros(12), cov).logpdf(y) for cov in covs])
    exact = np.exp(evidence - evidence.max())
    exact /= exact.sum()
    X, data = jnp.asarray(design), jnp.asarray(y)

    def slots(model):
        """Place of each variable's slope in x."""
        return jnp.cumsum(model) - 1

    def log_density(c):
        slopes = jnp.where(c.model > 0, c.x[slots(c.model)], 0.0)
        prior = jnp.sum(jnp.where(c.model > 0, -slopes**2 / 8 - jnp.log(2 * jnp.sqrt(2 * jnp.pi)), 0))
        return prior - 0.5 * jnp.sum((data - X @ slopes) ** 2)

    def into(model, x, u, which):
        place = jnp.sum(jnp.where(jnp.arange(3) < which, model, 0))
        return model.at[which].set(1), _put_in(x, place, u[0]), u[:0], which

    def out(model, x, u, which):
        place = slots(model)[which]
        return model.at[which].set(0), jnp.where(jnp.arange(3) < place, x, jnp.append(x[1:], 0.0)), x[place][None], which

    jumps = {"in": mcmc.Jump(into, "out", mo.Gaussian(jnp.zeros(1), 2 * jnp.eye(1)), lambda model, x: jnp.where(model == 0, 0.0, -jnp.inf)),
             "out": mcmc.Jump(out, "in", None, lambda model, x: jnp.where(model == 1, 0.0, -jnp.inf))}  # fmt: skip
    kernel = mcmc.ReversibleJump(jumps, jnp.sum, within=mcmc.RandomWalkMetropolis(0.3))
    start = mcmc.Configuration(jnp.zeros(3, jnp.int32), jnp.zeros(3))
    chains = mo.sample(0, mcmc.Repeat(kernel, 4), log_density, start, draws=2_000, chains=12)
    codes = np.asarray(chains.positions.model) @ np.array([1, 2, 4])
    for code in range(8):
        share = 1.0 * (codes == code)
        assert abs(share.mean() - exact[code]) < 4.9 * mcmc.standard_error(share) + 1e-3


def _put_in(x, place, value):
    where = jnp.arange(x.shape[0])
    return jnp.where(where < place, x, jnp.where(where == place, value, x[jnp.maximum(where - 1, 0)]))


def broken(**changes):
    prior = TEMPLATES["birth and death"]
    jumps = prior.jumps()
    parts = dict(map=jumps["death"].map, reverse="birth", law=None, choices=jumps["death"].choices) | changes
    return prior, {"birth": jumps["birth"], "death": mcmc.Jump(**parts)}


def test_a_map_whose_inverse_is_wrong_is_refused():
    def death(k, x, u, place):
        # always the last component, whatever was chosen
        return k - 1, x, jax.lax.dynamic_slice(x, (2 * k - 1,), (2,)), place

    prior, jumps = broken(map=death)
    with pytest.raises(MotesError, match=r"ReversibleJump jumps\['(birth|death)'\] map: expected one that '(birth|death)' undoes"):
        mo.sample(0, mcmc.ReversibleJump(jumps, prior.size), prior.log_density, prior.drawn)


def test_a_jump_without_its_reverse_is_refused():
    prior = TEMPLATES["birth and death"]
    birth = prior.jumps()["birth"]
    with pytest.raises(MotesError, match=r"jumps\['birth'\]: expected a reverse among the jumps .*, got no jump 'death'"):
        mcmc.ReversibleJump({"birth": birth}, prior.size)
    with pytest.raises(MotesError, match="got 'death', whose reverse is 'other'"):
        mcmc.ReversibleJump({"birth": birth, "death": mcmc.Jump(birth.map, "other")}, prior.size)


def test_a_reverse_that_is_never_chosen_is_refused():
    prior, jumps = broken(choices=lambda k, x: jnp.full(5, -jnp.inf))
    with pytest.raises(MotesError, match=r"jumps\['birth'\]: expected a map to where 'death' can come back from"):
        mo.sample(0, mcmc.ReversibleJump(jumps, prior.size), prior.log_density, prior.drawn)


def test_other_refusals():
    prior = TEMPLATES["birth and death"]
    kernel = mcmc.ReversibleJump(prior.jumps(), prior.size)
    with pytest.raises(MotesError, match="ReversibleJump init: expected a mo.mcmc.Configuration"):
        mo.sample(0, kernel, lambda x: -jnp.sum(x**2), jnp.zeros(3))
    with pytest.raises(MotesError, match="ReversibleJump jumps: expected a dictionary"):
        mcmc.ReversibleJump({}, prior.size)
    with pytest.raises(MotesError, match="birth_death law: expected a law"):
        mcmc.birth_death(lambda k, x, j: None, 3)
    with pytest.raises(MotesError, match="change_points most: expected a whole number"):
        mcmc.change_points(0, 3)


def test_kernels_within_a_model_see_zeros_where_nothing_lives():
    """A density that sums all of x, dead numbers too, is that of its live ones."""
    def density(configuration):
        return -0.5 * (jnp.sum(configuration.x) - 1) ** 2 - 0.5 * jnp.sum(configuration.x**2) - 5 * configuration.model

    jumps = mcmc.birth_death(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), most=3)
    kernel = mcmc.ReversibleJump(jumps, size=lambda k: k, within=mcmc.RandomWalkMetropolis(0.7))
    chains = mo.sample(0, kernel, density, mcmc.Configuration(1, jnp.zeros(3)), draws=500)
    positions = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), chains.positions)
    np.testing.assert_allclose(chains.log_density.reshape(-1), jax.vmap(density)(positions), atol=1e-4)
