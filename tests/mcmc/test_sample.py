"""The loop: resuming, files, trees of positions, warnings, words."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core.checks import MotesError, MotesWarning

mcmc = mo.mcmc
PRECISION = jnp.array([[1.0, 0.6], [0.6, 2.0]])


def log_density(x):
    return -0.5 * x @ PRECISION @ x


ADAPTIVE = mcmc.Adaptive(mcmc.RandomWalkMetropolis(), steps=150)


@pytest.mark.optimized
def test_a_run_cut_within_its_warm_up_equals_the_uncut_one(tmp_path):
    whole = mo.sample(5, ADAPTIVE, log_density, jnp.zeros(2), draws=200, chains=3, burn_in=0)
    first = mo.sample(5, ADAPTIVE, log_density, jnp.zeros(2), draws=80, chains=3, burn_in=0)
    first.save(tmp_path / "chains.npz")
    back = mo.Chains.load(tmp_path / "chains.npz", ADAPTIVE, log_density)
    second = mo.sample(5, ADAPTIVE, log_density, back, draws=120)
    both = mcmc.joined([back, second])
    for one, other in zip(jax.tree.leaves((whole.positions, whole.log_density, whole.last)),
                          jax.tree.leaves((both.positions, both.log_density, both.last)), strict=True):  # fmt: skip
        assert np.array_equal(np.asarray(one), np.asarray(other))
    assert int(both.steps) == 200
    assert np.asarray(both.info.tried).tolist() == np.asarray(whole.info.tried).tolist()


def test_positions_are_any_tree():
    kernel = mcmc.within_gibbs({"level": mcmc.RandomWalkMetropolis(1.0), "slopes": mcmc.RandomWalkMetropolis(0.8)})
    chains = mo.sample(1, kernel, lambda p: -0.5 * (p["level"] - 2.0) ** 2 - jnp.sum(p["slopes"] ** 2),
                       {"level": 0.0, "slopes": jnp.zeros(3)}, draws=2_000)  # fmt: skip
    assert list(chains.columns()) == ["level", "slopes[0]", "slopes[1]", "slopes[2]"]
    assert chains.positions["slopes"].shape == (4, 2_000, 3)
    table = chains.summary()
    assert abs(table.column("mean")[0] - 2) < 5 * table.column("s.e. of mean")[0]
    tree = chains.to_datatree()
    assert dict(tree["posterior"].sizes)["chain"] == 4 and dict(tree["posterior"].sizes)["draw"] == 2_000
    assert set(chains.acceptance) == {"level: RandomWalkMetropolis", "slopes: RandomWalkMetropolis"}


def test_thinning():
    kernel = mcmc.RandomWalkMetropolis(1.5)
    fine = mo.sample(2, mcmc.Repeat(kernel, 1), log_density, jnp.zeros(2), draws=50, burn_in=0)
    assert np.asarray(mo.sample(2, mcmc.Repeat(kernel, 4), log_density, jnp.zeros(2), draws=50, burn_in=0).info.tried).max() == 200
    assert np.asarray(fine.info.tried).max() == 50


def test_starts_may_be_drawn():
    chains = mo.sample(1, ADAPTIVE, log_density, lambda key: 3 * jax.random.normal(key, (2,)), draws=1, chains=50, burn_in=0)
    assert np.asarray(chains.positions).std() > 1.5


def test_learning_finds_scale_and_shape():
    factor = jnp.array([[1.0, 0.0], [9.5, 0.5]])

    def narrow(x):
        return -0.5 * jnp.sum(jax.scipy.linalg.solve_triangular(factor, x, lower=True) ** 2)

    plain, learned = (mo.sample(3, kernel, narrow, jnp.zeros(2), draws=2_000) for kernel in (
        mcmc.RandomWalkMetropolis(0.7), mcmc.Adaptive(mcmc.RandomWalkMetropolis())))  # fmt: skip
    assert abs(list(learned.acceptance.values())[0] - 0.337) < 0.1
    assert learned.summary().column("bulk ESS")[1] > 5 * plain.summary().column("bulk ESS")[1]
    found = np.cov(np.asarray(learned.positions).reshape(-1, 2).T)
    np.testing.assert_allclose(found, np.asarray(factor @ factor.T), rtol=0.25, atol=0.3)


def test_words():
    good = mo.sample(3, mcmc.Adaptive(mcmc.RandomWalkMetropolis()), log_density, jnp.zeros(2), draws=3_000)
    assert good.diagnose().trusted and "Nothing wrong" in str(good)
    apart = mo.Mixture.of(jnp.array([0.5, 0.5]), jnp.array([[-20.0, 20.0]]), jnp.ones((1, 1, 2)))
    bad = mo.sample(3, mcmc.RandomWalkMetropolis(1.0), apart.log_prob, lambda key: 20 * jax.random.rademacher(key, (1,)).astype(float),
                    draws=500, chains=8)  # fmt: skip
    assert "not mixed" in bad.diagnose() and not bad.diagnose().trusted
    short = mo.sample(3, mcmc.RandomWalkMetropolis(0.05), log_density, jnp.zeros(2), draws=200, chains=1)
    assert "few draws" in short.diagnose() and "one chain" in short.diagnose()


def test_a_chain_that_never_moves_is_told():
    with pytest.warns(MotesWarning, match="stuck: chain 0, 1"):
        chains = mo.sample(0, mcmc.RandomWalkMetropolis(1e6), log_density, jnp.zeros(2), draws=100, chains=2)
    assert np.isnan(chains.summary().column("R-hat")).all()
    assert "never accepted" in chains.diagnose()


SEVERAL = [mcmc.RandomWalkMetropolis(1.0), mcmc.HMC(step_size=0.3), mcmc.NUTS(0.3), mcmc.MALA(0.5),
           mcmc.MultipleTry(mo.LinearGaussian(jnp.eye(2), jnp.eye(2)), 3)]  # fmt: skip


@pytest.mark.parametrize("kernel", SEVERAL, ids=lambda kernel: type(kernel).__name__)
def test_densities_that_are_no_numbers_are_never_accepted_and_told(kernel):
    def holes(x):
        return log_density(x) + 0 * jnp.log(x[0] + 0.5)

    with pytest.warns(MotesWarning, match="invalid: log_density was NaN"):
        chains = mo.sample(0, kernel, holes, jnp.zeros(2), draws=400)
    assert np.isfinite(np.asarray(chains.log_density)).all() and (np.asarray(chains.positions)[..., 0] > -0.5).all()


def test_interrupted_chains_are_given_back(monkeypatch):
    from motes.mcmc import sample as module

    true, calls = module._advance, []

    def interrupted(*args):
        calls.append(1)
        if len(calls) > 12:
            raise KeyboardInterrupt
        return true(*args)

    monkeypatch.setattr(module, "_advance", interrupted)
    with pytest.warns(MotesWarning, match="interrupted after 120 steps"):
        part = mo.sample(4, ADAPTIVE, log_density, jnp.zeros(2), draws=200, burn_in=0)
    monkeypatch.undo()
    assert part.log_density.shape == (4, 120)


def other(to, back, log_volume=None):
    return dict(kernel=mcmc.Reparametrized(mcmc.RandomWalkMetropolis(1.0), to, back, log_volume), init=jnp.ones(2))


REFUSED = [
    (dict(init=jnp.array([1, 2])), "RandomWalkMetropolis position: expected real numbers, or proposals that are whole"),
    (dict(init={"k": 3, "z": 0.0}, kernel=mcmc.Adaptive(mcmc.RandomWalkMetropolis()), log_density=lambda p: -p["z"] ** 2 - p["k"] ** 2),
     "RandomWalkMetropolis position: expected real numbers"),
    (dict(kernel=mcmc.within_gibbs({0: mcmc.RandomWalkMetropolis(1.0), 2: mcmc.RandomWalkMetropolis(1.0)})),
     r"Block part: expected a part of the position \(\(2,\)\), got 2"),
    (dict(kernel=mcmc.Gibbs({5: lambda key, x: x[0]})), r"Gibbs draws\[5\]: expected a part of the position"),
    (dict(kernel=mcmc.Gibbs({"b": lambda key, x: x["a"]}), init={"a": 0.0}, log_density=lambda x: -x["a"] ** 2),
     r"Gibbs draws\['b'\]: expected a part of the position \(\['a'\]\)"),
    (other(jnp.log, lambda z: jnp.exp(2 * z)), "Reparametrized back: expected the inverse of to, got .* by to"),
    (other(lambda x: jnp.append(x, 0.0), lambda z: z[:2]), "Reparametrized to: expected 2 numbers, as many as in the position, got 3"),
    (other(jnp.log, jnp.exp, lambda z: -jnp.sum(z) + 1), "Reparametrized log_volume: expected .* near the start, .* got"),
    (dict(kernel=3), "sample kernel: expected a kernel"),
    (dict(log_density=3), "sample log_density: expected a function"),
    (dict(draws=0), "sample draws: expected a whole number of at least 1"),
    (dict(burn_in=-1), "sample burn_in: expected a whole number of at least 0"),
    (dict(init={}), "sample init: expected a position with at least one number"),
    (dict(init="here"), "sample init: expected a position"),
    (dict(log_density=lambda x: jnp.nan * x[0]), "log_density at init: expected a finite number, got nan for chain 0"),
    (dict(log_density=lambda x: -jnp.inf + 0 * x[0]), "log_density at init: expected a finite number, got -inf"),
    (dict(log_density=lambda x: x), "log_density at init: expected shape \\(any,\\) \\(one number for each chain\\)"),
    (dict(kernel=mcmc.RandomWalkMetropolis(jnp.ones(3))), "RandomWalkMetropolis scale: expected one number or 2"),
    (dict(kernel=mcmc.Block("mu", mcmc.RandomWalkMetropolis(1.0))), "Block part: expected a part of the position"),
    (dict(kernel=mcmc.NUTS(), init=jnp.zeros(2, int), log_density=lambda x: 0.0 * x.sum()), "NUTS position: expected real numbers"),
]


@pytest.mark.parametrize("changes, message", REFUSED, ids=lambda value: value[:40] if isinstance(value, str) else "")
def test_refusals(changes, message):
    given = dict(kernel=mcmc.RandomWalkMetropolis(1.0), log_density=log_density, init=jnp.zeros(2), draws=10) | changes
    with pytest.raises(MotesError, match=message):
        mo.sample(0, **given)


PARAMETERS = [
    (lambda: mcmc.Cycle(mcmc.HMC()), "Cycle kernels: expected a list of kernels"),
    (lambda: mcmc.Block("a", 3), "Block kernel: expected a kernel"),
    (lambda: mcmc.raftery_lewis(np.arange(150.0), 0.5, error=0.1), "raftery_lewis draws: expected at least 200 draws"),
    (lambda: mcmc.geweke(np.arange(150.0)), r"geweke draws: expected shape \(\*, \*\)|geweke draws: expected shape"),
    (lambda: mcmc.r_hat(np.zeros((2, 10, 3))), "rhat draws: expected shape"),
    (lambda: mcmc.Reparametrized(3, jnp.log, jnp.exp), "Reparametrized kernel: expected a kernel"),
    (lambda: mcmc.Reparametrized(mcmc.RandomWalkMetropolis(), 3, jnp.exp), "Reparametrized to: expected a function"),
    (lambda: mcmc.RandomWalkMetropolis(-1.0), "RandomWalkMetropolis scale: expected positive numbers"),
    (lambda: mcmc.RandomWalkMetropolis(jnp.ones((2, 3))), "RandomWalkMetropolis scale: expected a number"),
    (lambda: mcmc.IndependenceMetropolis(3), "IndependenceMetropolis law: expected a law"),
    (lambda: mcmc.MetropolisHastings(3), "MetropolisHastings proposal: expected a conditional"),
    (lambda: mcmc.MultipleTry(mo.LinearGaussian(jnp.eye(1), jnp.eye(1)), 0), "MultipleTry tries: expected a whole number"),
    (lambda: mcmc.Cycle([]), "Cycle kernels: expected at least one kernel"),
    (lambda: mcmc.Cycle([3]), "Cycle kernel: expected a kernel"),
    (lambda: mcmc.Mix([mcmc.HMC()], [0.0]), "Mix weights: expected 1 positive numbers"),
    (lambda: mcmc.Adaptive(mcmc.Cycle([mcmc.HMC()])), "Adaptive kernel: expected RandomWalkMetropolis"),
    (lambda: mcmc.Gibbs({}), "Gibbs draws: expected a dictionary"),
    (lambda: mcmc.Gibbs({"a": 3}), "Gibbs draws\\['a'\\]: expected a function"),
    (lambda: mcmc.HMC(num_steps=0), "HMC num_steps: expected a whole number of at least 1"),
    (lambda: mcmc.NUTS(max_tree_depth=1.5), "NUTS max_tree_depth: expected a whole number"),
    (lambda: mcmc.HMC(step_size=0.0), "HMC step_size: expected a number above 0"),
    (lambda: mcmc.joined([]), "pieces: expected at least one Chains"),
]


@pytest.mark.parametrize("make, message", PARAMETERS, ids=[message[:30] for _, message in PARAMETERS])
def test_refused_knobs(make, message):
    with pytest.raises(MotesError, match=message):
        make()


def test_moves_of_one_name_are_counted_apart():
    kernel = mcmc.Cycle([mcmc.RandomWalkMetropolis(0.01), mcmc.RandomWalkMetropolis(1.0), mcmc.RandomWalkMetropolis(30.0)])
    rates = mo.sample(0, kernel, log_density, jnp.zeros(2), draws=300).acceptance
    assert rates["RandomWalkMetropolis"] > 0.9 > rates["RandomWalkMetropolis 2"] > rates["RandomWalkMetropolis 3"]


def test_a_scale_is_drawn_by_its_logarithm():
    """Gamma with shape 3: log x has no bound, and the draws are those of x."""
    kernel = mcmc.Adaptive(mcmc.RandomWalkMetropolis(), steps=500)
    kernel = mcmc.Reparametrized(kernel, lambda x: jnp.log(x), lambda z: jnp.exp(z), lambda z: jnp.sum(z))
    chains = mo.sample(0, kernel, lambda x: jnp.where(x[0] > 0, 2 * jnp.log(x[0]) - x[0], -jnp.inf), jnp.ones(1), draws=8_000, chains=8)
    draws = np.asarray(chains.positions)[..., 0].astype(float)
    for power, truth in ((1, 3.0), (2, 12.0), (-1, 0.5)):
        assert abs((draws**power).mean() - truth) < 4.9 * mcmc.standard_error(draws**power)
    np.testing.assert_allclose(chains.log_density, 2 * np.log(draws) - draws, atol=2e-5)


def test_whole_numbers_are_drawn_by_proposals_of_whole_numbers():
    """Poisson with mean 3 by steps of one; no random walk on the line could."""
    def stepped(key, x, u, t):
        return x + 2 * jnp.round(jax.random.uniform(key, x.shape)) - 1

    steps = mo.Custom(sample=stepped, log_prob=lambda new, x, u, t: jnp.zeros(()))
    chains = mo.sample(0, mcmc.MetropolisHastings(steps), lambda k: jnp.where(k >= 0, k * jnp.log(3.0) - jax.lax.lgamma(k + 1.0), -jnp.inf),
                       jnp.int32(3), draws=20_000)  # fmt: skip
    draws = np.asarray(chains.positions)
    assert draws.dtype == np.int32 and abs(draws.mean() - 3) < 4.9 * mcmc.standard_error(draws)


@pytest.mark.night
def test_a_kernel_drawn_now_and_then_learns_its_shape_too():
    wide = mo.Gaussian(jnp.zeros(2), jnp.diag(jnp.array([1.0, 1e4])))
    kernel = mcmc.Mix([mcmc.Adaptive(mcmc.RandomWalkMetropolis(), steps=4_000), mcmc.RandomWalkMetropolis(0.1)], [1, 3])
    chains = mo.sample(0, kernel, wide.log_prob, jnp.zeros(2), draws=100, chains=8, burn_in=4_000)
    assert np.median(chains.last.kernel_state[0].factor[:, 1, 1]) > 30


def test_continuing_with_what_does_not_fit_is_refused(tmp_path):
    chains = mo.sample(0, mcmc.RandomWalkMetropolis(1.0), log_density, jnp.zeros(2), draws=10)
    with pytest.raises(MotesError, match="sample kernel: expected that of the chains, RandomWalk.*got Adaptive"):
        mo.sample(0, ADAPTIVE, log_density, chains, draws=10)
    loaded = mo.Chains.load(chains.save(tmp_path / "c.npz"))
    with pytest.raises(MotesError, match="sample init: expected chains that were loaded with their kernel"):
        mo.sample(0, mcmc.RandomWalkMetropolis(1.0), log_density, loaded, draws=10)
    fewer = mo.sample(0, mcmc.RandomWalkMetropolis(1.0), log_density, jnp.zeros(2), draws=10, chains=2)
    with pytest.raises(MotesError, match="pieces: expected chains of one number"):
        mcmc.joined([chains, fewer])


def test_what_cannot_be_judged_is_not_trusted():
    few = mo.sample(0, mcmc.RandomWalkMetropolis(1.0), log_density, jnp.zeros(2), draws=2)
    assert not few.diagnose().trusted and "few draws" in str(few.diagnose())
    kernel = mcmc.within_gibbs({"a": mcmc.RandomWalkMetropolis(1.0), "b": mcmc.RandomWalkMetropolis(1e9)})
    still = mo.sample(0, kernel, lambda x: -x["a"] ** 2 - x["b"] ** 2, {"a": 0.0, "b": 0.0}, draws=3_000)
    assert not still.diagnose().trusted and "b never changed" in str(still.diagnose())


def test_no_warning_without_a_reason():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mo.sample(3, ADAPTIVE, log_density, jnp.zeros(2), draws=300)
