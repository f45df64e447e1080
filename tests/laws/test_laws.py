"""Laws: densities against SciPy, moments of samples, conditioning, missing components."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import motes as mo
from motes.laws.law import as_law
from tiers import each

N = 200_000


class Gumbel:
    """A distribution object of another library, as numpyro's are: batch of independent components."""

    batch_shape, event_shape = (2,), ()
    mean, variance = jnp.array([0.5772157, 2 * 0.5772157]), jnp.array([np.pi**2 / 6, 4 * np.pi**2 / 6])

    def sample(self, key, shape):
        return jnp.array([1.0, 2.0]) * jax.random.gumbel(key, (*shape, 2))

    def log_prob(self, x):
        z = x / jnp.array([1.0, 2.0])
        return -z - jnp.exp(-z) - jnp.log(jnp.array([1.0, 2.0]))


LAWS = {
    "StudentT": (mo.StudentT([0.5, 2.0], 7.0), [stats.t(7, scale=0.5), stats.t(7, scale=2)]),
    "Laplace": (mo.Laplace([0.5, 2.0]), [stats.laplace(scale=0.5), stats.laplace(scale=2)]),
    "Uniform": (mo.Uniform([1.0, -2.0], [1.5, 3.0]), [stats.uniform(1, 0.5), stats.uniform(-2, 5)]),
    "Gaussian": (mo.Gaussian([1.0, -1.0], np.diag([0.25, 4.0])), [stats.norm(1, 0.5), stats.norm(-1, 2)]),
    "foreign": (as_law("law", Gumbel()), [stats.gumbel_r(scale=1), stats.gumbel_r(scale=2)]),
}


@pytest.mark.parametrize("name", LAWS)
def test_density_and_samples(name):
    law, parts = LAWS[name]
    points = np.array([[1.2, 1.1, 1.4], [-1.0, 2.5, 0.3]])
    wanted = sum(part.logpdf(row) for part, row in zip(parts, points, strict=True))
    assert np.allclose(law.log_prob(jnp.asarray(points)), wanted, atol=1e-4)
    assert np.allclose(law.log_prob(jnp.asarray(points[:, 0])), wanted[0], atol=1e-4)
    half_missing = points.copy()
    half_missing[0] = np.nan
    assert np.allclose(law.log_prob(jnp.asarray(half_missing)), parts[1].logpdf(points[1]), atol=1e-4)
    drawn = np.asarray(jax.jit(lambda key: law.sample(key, N))(jax.random.key(3)))
    assert drawn.shape == (2, N)
    for part, row, mean, variance in zip(parts, drawn, np.asarray(law.mean()), np.diag(np.asarray(law.cov())), strict=True):
        assert stats.kstest(row, part.cdf).pvalue > 1e-6
        assert np.isclose(mean, part.mean(), atol=1e-4) and np.isclose(variance, part.var(), rtol=1e-3)
    assert abs(np.corrcoef(drawn)[0, 1]) < 6 / np.sqrt(N)


def test_mixture():
    law = mo.Mixture.of([1.0, 3.0], [[0.0, 2.0], [1.0, -1.0]], np.stack([np.eye(2), [[2.0, 0.5], [0.5, 1.0]]], axis=-1))
    points = np.random.default_rng(0).normal(size=(2, 5))
    first, second = stats.multivariate_normal([0, 1], np.eye(2)), stats.multivariate_normal([2, -1], [[2, 0.5], [0.5, 1]])
    wanted = np.log(0.25 * first.pdf(points.T) + 0.75 * second.pdf(points.T))
    assert np.allclose(law.log_prob(jnp.asarray(points)), wanted, atol=1e-5)
    drawn = np.asarray(law.sample(jax.random.key(0), N))
    assert np.allclose(drawn.mean(axis=1), law.mean(), atol=0.02) and np.allclose(np.cov(drawn), law.cov(), atol=0.03)
    assert np.allclose(law.inflated(4.0).cov(), 4 * law.cov(), rtol=1e-5)


def test_conditioning_equals_the_joint_normal_law(double):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    P, H, d = root @ root.T, rng.normal(size=(2, 3)), rng.normal(size=2)
    R = np.array([[0.5, 0.2], [0.2, 0.8]])
    mean, y = rng.normal(size=3), rng.normal(size=2)
    law, evidence = mo.Gaussian(mean, P).given(jnp.asarray(y), jnp.asarray(H), jnp.asarray(d), jnp.asarray(R))
    M = H @ P @ H.T + R
    gain = P @ H.T @ np.linalg.inv(M)
    assert np.allclose(law.mean(), mean + gain @ (y - H @ mean - d)) and np.allclose(law.cov(), P - gain @ M @ gain.T)
    assert np.isclose(evidence, stats.multivariate_normal(H @ mean + d, M).logpdf(y))
    batch = mo.Gaussian(np.stack([mean, 2 * mean], axis=1), np.stack([P, 2 * P], axis=-1))
    each, _ = batch.given(jnp.asarray(np.stack([y, y], axis=1)), jnp.asarray(H), jnp.asarray(d), jnp.asarray(R))
    assert np.allclose(each.mean()[:, 0], law.mean()) and np.allclose(each.cov()[..., 0], law.cov())
    assert np.allclose(np.asarray(mo.Gaussian(mean, P).through(jnp.asarray(H), jnp.asarray(d), jnp.asarray(R)).cov()), M)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_gain_in_float32_for_tiny_and_huge_noise(scale):
    """N3: the gain of float32 against float64 within 1e-3, and covariances stay semi-definite."""
    P, H = np.array([[2.0, 0.7], [0.7, 1.0]]), np.array([[1.0, 0.3]])
    M = H @ P @ H.T + scale
    exact = (P @ H.T / M)[:, 0]
    law, _ = mo.Gaussian(np.zeros(2), P).given(jnp.ones(1), jnp.asarray(H, jnp.float32), jnp.zeros(1), jnp.full((1, 1), scale, jnp.float32))
    assert law.mean().dtype == jnp.float32
    assert np.allclose(law.mean(), exact, rtol=1e-3)
    assert np.linalg.eigvalsh(np.asarray(law.cov(), np.float64)).min() > -1e-7


def bearing_model(angles):
    """A target that circles the sensor, seen by its bearing, which jumps at the western axis."""
    turn = 0.3
    A = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return mo.StateSpaceModel(
        mo.Gaussian([-10.0, 1.0], 0.3 * np.eye(2)),
        mo.LinearGaussian(A, 0.01 * np.eye(2)),
        mo.AdditiveGaussian(lambda x, u, t: jnp.array([jnp.arctan2(x[1], x[0])]), [[0.02]], angles=angles),
    )


@pytest.mark.parametrize("filter", [mo.ExtendedKalmanFilter(), mo.ParticleFilter(n=2000)], ids=lambda f: type(f).__name__)
def test_angles_are_wrapped(filter):
    xs, ys = mo.simulate(4, bearing_model((0,)), 60)
    turns = 2 * np.pi * np.resize([0, 1, -1, 2, 0], ys.shape)
    history = mo.run(0, filter, bearing_model((0,)), ys)
    assert np.sqrt((np.asarray(history.mean - xs) ** 2).sum(axis=1).mean()) < 1.2
    turned = mo.run(0, filter, bearing_model((0,)), ys + turns)
    assert np.allclose(turned.mean, history.mean, atol=0.02) and np.isclose(turned.log_likelihood, history.log_likelihood, atol=0.1)
    across = np.abs(np.diff(np.arctan2(np.sin(ys), np.cos(ys))[:, 0])).max()
    assert across > 5  # the bearing does jump from pi to -pi on the way


def test_differences_of_angles_lie_in_the_half_open_circle():
    part = mo.AdditiveGaussian(lambda x, u, t: x, np.eye(2), angles=(-1,))
    values = jnp.array([[7.0, 7.0, 0.1], [np.pi + 0.1, -np.pi - 0.1, 0.2]])
    found = np.asarray(part.residual(values, jnp.zeros((2, 3))))
    assert np.allclose(found[0], [7.0, 7.0, 0.1]) and np.allclose(found[1], [0.1 - np.pi, np.pi - 0.1, 0.2], atol=1e-6)


@pytest.mark.parametrize("noise", [mo.AdditiveGaussian(lambda x, u, t: 2 * x, [[1.0, 0.3], [0.3, 2.0]]),
                                   mo.AdditiveNoise(lambda x, u, t: 2 * x, mo.StudentT([1.0, 2.0], 5.0))], ids=["Gaussian", "Student"])
def test_what_was_drawn_cannot_be_missing(noise):
    """NaN in a measurement is left out; NaN in a particle of a proposal is a fault, which gives that particle no density."""
    X = jnp.array([[1.0, -2.0, 0.5], [0.2, 0.1, 3.0]])
    values = jnp.array([[2.5, -4.0, jnp.nan], [0.3, 0.9, 5.0]])
    each = noise.log_prob(values, X, None, 0)
    assert np.isnan(each[2])
    for i in (0, 1):
        assert np.isclose(each[i], noise.log_prob(values[:, i], X, None, 0)[i], rtol=1e-5)
    assert np.isfinite(noise.log_prob(values[:, 2], X, None, 0)).all()


def test_laws_print_compare_and_hash():
    first, second = mo.Gaussian([1.0], [[2.0]]), mo.Gaussian([1.0], [[2.0]])
    assert first == second and hash(first) == hash(second) and first != mo.Gaussian([1.5], [[2.0]])
    assert "Gaussian" in repr(first) and "2." in repr(first)
    with pytest.raises(AttributeError):
        first.center = 3


@pytest.mark.parametrize("noise", each(["correlated", "none in one component", "per particle"], {"correlated"}))
def test_components_in_turn_equal_all_at_once(noise, double):
    rng = np.random.default_rng(3)
    roots = rng.normal(size=(4, 4, 6))
    law = mo.Gaussian(jnp.asarray(rng.normal(size=(4, 6))), jnp.asarray(np.einsum("ijn,kjn->ikn", roots, roots)))
    R = np.array([[1.0, 0.3, 0.1], [0.3, 0.5, 0.2], [0.1, 0.2, 0.7]])
    R = {"correlated": R, "none in one component": np.diag([0.4, 0.0, 1.0]), "per particle": R[..., None] * rng.exponential(size=6)}[noise]
    H = rng.normal(size=(3, 4)) if noise == "correlated" else rng.normal(size=(3, 4, 6))
    innovation, seen = jnp.asarray(rng.normal(size=(3, 6))), rng.random((3, 6)) < 0.6
    for mask in (None, jnp.array([True, False, True]), jnp.asarray(seen)):
        one = law.corrected(innovation, jnp.asarray(H), jnp.asarray(R), mask)
        parts = [((2,), jnp.asarray(H[:, [2]])), ((3, 0, 1), jnp.asarray(H[:, [3, 0, 1]]))]
        other = law.corrected_in_turn(innovation, parts, jnp.asarray(R), mask)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            assert np.allclose(a, b, rtol=1e-9, atol=1e-9)


def test_a_sharp_measurement_leaves_a_variance_in_float32():
    law = mo.Gaussian(jnp.zeros((2, 1), jnp.float32), jnp.asarray([[[400.0], [60.0]], [[60.0], [10.0]]], jnp.float32))
    H = jnp.asarray([[1.0, 0.3]], jnp.float32)
    for _ in range(20):
        law = law.corrected_in_turn(jnp.ones((1, 1), jnp.float32), [((0, 1), H)], jnp.full((1, 1), 1e-9, jnp.float32)).law
        assert np.linalg.eigvalsh(np.asarray(law.covariance[..., 0], np.float64)).min() > -1e-4
        assert np.isfinite(np.asarray(law.center)).all() and np.abs(np.asarray(law.center)).max() < 1e3


def test_drawn_states_leave_the_law_as_a_mixture_over_draws(double):
    """Pinned laws have no variance in the drawn states, and mean and covariance of the law when averaged over draws (five errors)."""
    cov = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 0.5]])
    n = 40_000
    laws = mo.Gaussian(jnp.repeat(jnp.array([[1.0], [-2.0], [0.5]]), n, axis=1), jnp.repeat(jnp.asarray(cov)[..., None], n, axis=2))
    pinned = jax.jit(lambda noise: laws.pinned((0, 2), noise))(jax.random.normal(jax.random.key(0), (2, n)))
    left = np.asarray(pinned.covariance)
    assert not left[[0, 2]].any() and not left[:, [0, 2]].any() and np.allclose(left[1, 1], left[1, 1, 0])
    assert np.allclose(np.asarray(pinned.center).mean(axis=1), [1.0, -2.0, 0.5], atol=5 * np.sqrt(2 / n))
    assert np.allclose(np.cov(np.asarray(pinned.center)) + left[..., 0], cov, atol=5 * 2 * np.sqrt(2 / n))


@pytest.mark.parametrize("n", each([1, 2, 3, 5], {"1", "3", "5"}))
def test_what_each_law_sees_is_its_own_whatever_their_number(n):
    """As many laws as states, or measured components, or neither: components that some laws see and others do not."""
    rng = np.random.default_rng(n)
    H, half = rng.normal(size=(2, 3)), rng.normal(size=(3, 3))
    law = mo.Gaussian(rng.normal(size=(3, n)), half @ half.T)
    R = np.tile(np.diag([0.3, 0.5])[..., None], n)
    y, seen = rng.normal(size=2), rng.uniform(size=(2, n)) < 0.5
    found = law.corrected(y[:, None] - H @ law.center, jnp.asarray(H), jnp.asarray(R), jnp.asarray(seen))
    for i in range(n):
        rows = seen[:, i]
        alone = mo.Gaussian(law.center[:, i], law.covariance)
        if not rows.any():
            np.testing.assert_allclose(found.law.center[:, i], alone.center, atol=1e-6)
            continue
        one = alone.corrected((y - H @ law.center[:, i])[rows], H[rows], R[rows][:, rows, i])
        np.testing.assert_allclose(found.law.center[:, i], one.law.center, atol=1e-5)
        np.testing.assert_allclose(found.law.covariance[..., i], one.law.covariance, atol=1e-5)
        np.testing.assert_allclose(found.log_evidence[i], one.log_evidence, atol=1e-5)
