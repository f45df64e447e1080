"""Mixed models with one nonlinear and one linear state against a fine two-dimensional grid that is written here, without the library."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from tiers import each

STEPS = 6
# much to compute, once for all tests
pytestmark = [pytest.mark.optimized, pytest.mark.xdist_group("mixed grid")]


def cases():
    """For each: (f, A, Q) of both states with the cross-covariance, and (h, C, R), as functions of the nonlinear state n."""
    one = np.ones_like

    def plain(n):
        return dict(fn=0.7 * n + 0.5 * np.sin(n), An=0.6 * one(n), Qn=0.4 * one(n), fl=0.3 * n, Al=0.8 * one(n), Ql=0.3 * one(n),
                    Qnl=0 * n, h=2 * np.sin(n / 2) + 0.1 * n**2, C=0 * n, R=0.5 * one(n))

    def all_dependent(n):
        return plain(n) | dict(An=0.5 + 0.3 * np.cos(n), Al=0.6 + 0.3 * np.sin(2 * n), Qn=0.3 + 0.1 * np.sin(n) ** 2,
                               Ql=0.2 + 0.2 * np.cos(n) ** 2, C=0.5 + 0.8 * np.sin(n), R=0.3 + 0.2 * np.cos(n) ** 2)

    return {
        "C zero": plain,
        "C constant": lambda n: plain(n) | dict(C=1.2 * one(n)),
        "all depend on the particle": all_dependent,
        "correlated noises": lambda n: plain(n) | dict(C=0.7 * one(n), Qnl=0.2 * one(n)),
        "correlated and dependent": lambda n: all_dependent(n) | dict(Qnl=0.1 + 0.08 * np.sin(n)),
    }


def library_model(parts):
    """The same model through the library's front door, split by tracing."""

    def at(x):
        return {name: jnp.asarray(value) for name, value in parts(_Jax(x[0])).items()}

    def f(x, u, t):
        p = at(x)
        return jnp.array([p["fn"] + p["An"] * x[1], p["fl"] + p["Al"] * x[1]])

    def Q(x, u, t):
        p = at(x)
        return jnp.array([[p["Qn"], p["Qnl"]], [p["Qnl"], p["Ql"]]])

    def h(x, u, t):
        p = at(x)
        return jnp.array([p["h"] + p["C"] * x[1]])

    def R(x, u, t):
        return at(x)["R"][None, None]

    initial = mo.Gaussian([0.4, -0.3], [[0.8, 0.3], [0.3, 0.9]])
    return mo.StateSpaceModel(initial, mo.AdditiveGaussian(f, Q), mo.AdditiveGaussian(h, R), ("n", "l"))


class _Jax:
    """Lets the cases above, written with NumPy functions, run on JAX numbers."""

    def __init__(self, value):
        self.value = value

    def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
        return _Jax(getattr(jnp, ufunc.__name__)(*[i.value if isinstance(i, _Jax) else i for i in inputs]))

    def __array_function__(self, func, types, args, kwargs):
        return _Jax(jnp.ones(()))

    def __jax_array__(self):
        return self.value

    def _with(op):  # noqa: N805
        return lambda self, *other: _Jax(getattr(jnp.asarray(self.value), op)(*[o.value if isinstance(o, _Jax) else o for o in other]))

    __add__, __radd__, __mul__, __rmul__ = _with("__add__"), _with("__radd__"), _with("__mul__"), _with("__rmul__")
    __truediv__, __pow__ = _with("__truediv__"), _with("__pow__")


def grid_answer(parts, ys, size=161, reach=6.5):
    """Posterior means, variances and the likelihood by summing over a grid of both states."""
    axis = np.linspace(-reach, reach, size)
    area = (axis[1] - axis[0]) ** 2
    n, k = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    p = {name: np.broadcast_to(value, n.shape) for name, value in parts(n).items()}

    def normal2(dn, dl, a, b, c):
        det = a * c - b * b
        return np.exp(-0.5 * (c * dn * dn - 2 * b * dn * dl + a * dl * dl) / det) / (2 * np.pi * np.sqrt(det))

    density = normal2(n - 0.4, k + 0.3, 0.8, 0.3, 0.9)
    centre_n, centre_l = p["fn"] + p["An"] * k, p["fl"] + p["Al"] * k
    total, means, variances = 0.0, [], []
    for t, y in enumerate(ys[:, 0]):
        if t:
            density = _moved(density * area, axis, centre_n, centre_l, p, normal2)
        if not np.isnan(y):
            density = density * np.exp(-0.5 * (y - p["h"] - p["C"] * k) ** 2 / p["R"]) / np.sqrt(2 * np.pi * p["R"])
            mass = density.sum() * area
            total += np.log(mass)
            density = density / mass
        weight = density * area
        mean = np.array([weight @ n, weight @ k])
        means.append(mean)
        variances.append(np.array([weight @ n**2, weight @ k**2]) - mean**2)
    return np.array(means), np.array(variances), total


def _moved(mass, axis, centre_n, centre_l, p, normal2):
    """Push every node's mass through its Gaussian transition, node by node over a window of the grid (compiled, in blocks)."""
    keep = mass > 1e-12 * mass.max()
    args = [jnp.asarray(a[keep]) for a in (mass, centre_n, centre_l, p["Qn"], p["Qnl"], p["Ql"])]

    @jax.jit
    def rows(target_n):
        m, cn, cl, a, b, c = args
        det = a * c - b * b
        dn = target_n - cn
        dl = jnp.asarray(axis)[:, None] - cl[None]
        quad = (c * dn * dn)[None] - 2 * (b * dn)[None] * dl + a[None] * dl * dl
        return jnp.exp(-0.5 * quad / det) @ (m / (2 * jnp.pi * jnp.sqrt(det)))

    return np.concatenate([np.asarray(rows(value)) for value in axis])


class Answers(dict):
    """Model, measurements and the grid's answer of each case, worked out when it is asked for."""

    def __missing__(self, name):
        with jax.enable_x64(True):
            parts = cases()[name]
            model = library_model(parts)
            ys = np.array(mo.simulate(32, model, STEPS)[1])
            ys[3] = np.nan
            self[name] = (model, ys, grid_answer(parts, ys))
        return self[name]


@pytest.fixture(scope="module")
def answers():
    return Answers()


@pytest.mark.parametrize("name", each(list(cases()), {"C zero", "C constant"}))
def test_posterior_equals_the_grid(answers, name, double):
    model, ys, (means, variances, total) = answers[name]
    history = mo.run(5, mo.MarginalizedParticleFilter(n=100_000, linear=("l",)), model, ys)
    assert np.abs(history.mean - means).max() < 0.02
    assert np.abs(np.diagonal(history.cov, axis1=1, axis2=2) - variances).max() < 0.02
    assert abs(float(history.log_likelihood) - total) < 0.02


@pytest.mark.parametrize("name", each(list(cases()), {"C zero", "C constant", "correlated noises"}))
def test_likelihood_is_unbiased(answers, name, double):
    model, ys, (_, _, total) = answers[name]
    keys = jax.random.split(jax.random.key(8), 100)
    filter = mo.MarginalizedParticleFilter(n=500, linear=("l",))
    ratio = np.exp(np.asarray(jax.jit(jax.vmap(lambda key: mo.run(key, filter, model, ys).log_likelihood))(keys)) - total)
    assert abs(ratio.mean() - 1) < 3 * ratio.std(ddof=1) / np.sqrt(100)


@pytest.mark.parametrize("name", each(["C constant", "all depend on the particle"], {"C constant"}))
def test_float32_agrees(answers, name):
    model, ys, (means, variances, _) = answers[name]
    model = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), model)
    history = mo.run(5, mo.MarginalizedParticleFilter(n=100_000, linear=("l",)), model, ys)
    assert history.mean.dtype == jnp.float32
    assert np.abs(history.mean - means).max() < 0.02


def test_structure_of_the_cases():
    found = {name: mo.structure(library_model(parts)) for name, parts in cases().items()}
    assert all(s.linear == (1,) for s in found.values())
    assert found["C zero"].covariance == found["C constant"].covariance == found["correlated noises"].covariance == "shared"
    assert found["all depend on the particle"].covariance == "per-particle"


@pytest.mark.night
def test_mixed_linear_model_by_hand_equals_the_traced_one(answers, double):
    parts = cases()["correlated and dependent"]

    def at(x):
        return {name: jnp.asarray(value) for name, value in parts(_Jax(x[0])).items()}

    model = mo.MixedLinearModel(
        initial_p=mo.Gaussian([0.4], [[0.8]]),
        initial_k=mo.Gaussian([-0.3], [[0.9 - 0.3**2 / 0.8]]),
        particle=lambda x, u, t: (at(x)["fn"][None], at(x)["An"][None, None], at(x)["Qn"][None, None]),
        kalman=lambda x, u, t: (at(x)["fl"][None], at(x)["Al"][None, None], at(x)["Ql"][None, None]),
        sensor=lambda x, u, t: (at(x)["h"][None], at(x)["C"][None, None], at(x)["R"][None, None]),
        cross_cov=lambda x, u, t: at(x)["Qnl"][None, None],
        initial_gain=jnp.array([[0.3 / 0.8]]),
        names=("n", "l"),
    )
    traced, ys, (means, _, _) = answers["correlated and dependent"]
    ours, theirs = (mo.run(5, mo.MarginalizedParticleFilter(n=5000), m, ys) for m in (model, traced))
    assert np.allclose(ours.mean, theirs.mean, atol=1e-9)
    plain = mo.run(5, mo.ParticleFilter(n=50_000), model, ys)
    nothing = mo.run(5, mo.MarginalizedParticleFilter(n=50_000, linear=()), model, ys)
    assert nothing.state.kalman.center.shape[0] == 0  # asked for fewer than the model's own: not the model's own
    for history in (plain, nothing):
        assert np.abs(history.mean - means).max() < 0.05
