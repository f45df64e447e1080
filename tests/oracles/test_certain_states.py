"""States without variance, which the jump-Markov filter leaves out of covariances, against covariances of all states."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.models.canonical import canonical
from tiers import each

pytestmark = pytest.mark.jax

NOISES = np.array([[[0.2, 0.05], [0.05, 0.1]]] * 5 + [[[0.2, 0.0], [0.0, 0.0]]] * 4, np.float32)
NAMES = ("gain", "symbol", "offset", "before", "sum")


def model():
    """A symbol and the one before scale two states that walk; the sum of what was has no noise of its own, and is not certain."""
    first, walk = np.zeros((5, 5)), np.zeros((5, 5))
    first[np.ix_([0, 2], [0, 2])] = [[0.8, 0.3], [0.3, 0.5]]
    walk[np.ix_([0, 2], [0, 2])] = [[0.05, 0.01], [0.01, 0.02]]

    def moved(x, u, t, mode):
        return jnp.stack([0.9 * x[0] + 0.1 * x[2] * x[1], x[1] * (1 - 2 * mode), x[2] + 0.2 * mode, x[1], 0.5 * x[4] + x[0] * x[3]])

    def seen(x, u, t):
        return jnp.stack([x[0] * x[1] + 0.4 * x[2] * x[3], x[2] + 0.3 * x[4]])

    dynamics = mo.AdditiveGaussian(moved, lambda x, u, t: walk * (1 + 0.1 * t))
    one = mo.StateSpaceModel(mo.Gaussian([0.7, 1.0, -0.4, -1.0, 0.2], first), dynamics, mo.AdditiveGaussian(seen, lambda x, u, t: u), NAMES)
    return mo.JumpMarkovModel([0.8, 0.2], [[0.7, 0.3], [0.4, 0.6]], model=one, modes=2)


def test_states_that_never_have_variance_are_found():
    """By numbers and tracing: not where dynamics make one of states that vary, nor where the initial law or the noise is unknown."""
    given = model()
    looked = canonical(given, NOISES[0])
    assert looked.noiseless == (1, 3, 4)
    assert mo.JumpMarkovFilter(n=4).prepare(looked, NOISES[0]).certain == (1, 3)
    assert mo.JumpMarkovFilter(n=4, sampled=("gain",)).prepare(looked, NOISES[0]).certain == ()
    assert mo.JumpMarkovFilter(n=4, rule=mo.gaussian.Cubature()).prepare(looked, NOISES[0]).certain == ()
    assert jax.jit(lambda model: mo.JumpMarkovFilter(n=4).prepare(canonical(model, NOISES[0]), NOISES[0]).certain == ())(given)


@pytest.mark.parametrize("wide", each({"float64": True, "float32": False}, {"float32"}))
def test_results_are_those_of_covariances_of_all_states(wide):
    """Components and rows missing, sensor noise that is correlated, and one that says nothing of a component.

    The numbers of a model that is an argument of compiled code are not known, so that no state is left out.
    """
    with jax.enable_x64(wide):
        ys = np.array(mo.simulate(2, model(), 9, NOISES)[1])
        ys[2, 0], ys[4, 1], ys[6] = np.nan, np.nan, np.nan

        def found(model):
            return mo.run(1, mo.JumpMarkovFilter(n=6, lag=2), model, ys, NOISES, keep=mo.keep.modes(lag=2))

        lean, full = found(model()), jax.jit(found)(model())
        rounding = 1e-12 if wide else 1e-5
        for name in ("kept", "info", "last"):
            for one, other in zip(*(jax.tree.leaves(getattr(history, name)) for history in (lean, full)), strict=True):
                assert np.allclose(one, other, rtol=rounding, atol=rounding, equal_nan=True)
        certain = lean.last.state.parts.reordered(np.array([1, 3]))
        assert not np.asarray(lean.last.state.parts.covariance)[[1, 3]].any() and certain.covariance.shape == (2, 2, 12)
        assert set(np.unique(certain.center)) == {-1.0, 1.0}
