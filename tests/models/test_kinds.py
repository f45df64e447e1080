"""A model of any kind: what is asked of it is one contract, and a new kind is one class."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes.core.record import record, static
from motes.models.correlated import Augmented, users
from motes.models.interface import Model


@record
class Autoregression(Model):
    """y_t = c_1 y_{t-1} + c_2 y_{t-2} + noise, measured with noise: a kind of model that the library does not know."""

    coefficients: jax.Array
    noise: float
    names: tuple[str, ...] = static(default=("now", "before"))
    circular: tuple[int, ...] = static(default=())

    @property
    def dtype(self):
        return jnp.result_type(float)

    def check(self, inputs_of_step):
        if inputs_of_step is not None:
            raise mo.MotesError("an autoregression takes no inputs")

    def measurement_size(self, inputs_of_step):
        return 1

    def as_state_space(self):
        A = jnp.stack([self.coefficients, jnp.array([1.0, 0.0])])
        Q = jnp.diag(jnp.array([self.noise, 0.0]))
        first, sensor = mo.Gaussian([0.0, 0.0], np.eye(2)), mo.LinearGaussian([[1.0, 0.0]], [[0.3]])
        return mo.StateSpaceModel(first, mo.LinearGaussian(A, Q), sensor, self.names)


def test_a_new_kind_of_model_is_simulated_filtered_smoothed_and_studied():
    model = Autoregression(jnp.array([0.6, 0.3]), 0.5)
    known = model.as_state_space()
    xs, ys = mo.simulate(1, model, 6)
    assert np.array_equal(xs, mo.simulate(1, known, 6)[0])
    exact, same = (mo.run(2, mo.KalmanFilter(), m, ys, keep=mo.keep.laws) for m in (model, known))
    assert np.allclose(exact.mean, same.mean, atol=1e-4) and exact.names == ("now", "before")
    drawn = mo.run(2, mo.MarginalizedParticleFilter(n=1), model, ys)
    assert np.allclose(drawn.mean, exact.mean, atol=1e-4)
    stream = mo.stream(2, mo.KalmanFilter(), model)
    stream.update(ys[0])
    assert np.allclose(stream.mean, exact.mean[0], atol=1e-4)
    smoothed = mo.smooth(3, mo.smoothers.RauchTungStriebelSmoother(), model, exact)
    assert np.allclose(smoothed.mean[-1], exact.mean[-1], atol=1e-4)
    assert mo.structure(model).linear == (0, 1)
    result = mo.study(mo.Experiment(model, {"exact": mo.KalmanFilter()}, steps=6, runs=2))
    assert result.estimates.shape == (1, 2, 6, 2) and result.states == ("now", "before")


GOOD = {
    "particle": lambda x, u, t: (x, jnp.ones((1, 2)), jnp.eye(1)),
    "kalman": lambda x, u, t: (jnp.zeros(2), jnp.eye(2), jnp.eye(2)),
    "sensor": lambda x, u, t: (x, jnp.ones((1, 2)), jnp.eye(1)),
}


def mixed(**changes):
    return mo.MixedLinearModel(mo.Gaussian([0.0], [[1.0]]), mo.Gaussian([0.0, 0.0], np.eye(2)), **GOOD | changes)


def test_what_does_not_fit_is_refused_whatever_the_kind():
    with pytest.raises(mo.MotesError, match="takes no inputs"):
        mo.run(0, mo.KalmanFilter(), Autoregression(jnp.ones(2), 0.5), np.ones((2, 1)), np.ones(2))
    with pytest.raises(mo.MotesError) as error:
        mo.run(0, mo.KalmanFilter(), Autoregression(jnp.ones(2), 0.5), np.ones((2, 3)))
    refused(error, "ys: expected shape (t, 1), as the sensor measures")
    for name, size, y, said in (("particle", 2, 1, "particle(x_p, u, t) f"), ("kalman", 1, 1, "kalman(x_p, u, t) A"),
                                ("sensor", 1, 2, "sensor(x_p, u, t) A")):  # fmt: skip
        model = mixed(**{name: lambda x, u, t, size=size: (jnp.zeros(2), jnp.ones((2, size)), jnp.eye(2))})
        with pytest.raises(mo.MotesError) as error:
            mo.run(0, mo.ParticleFilter(n=9), model, np.ones((2, y)))
        refused(error, said)
    with pytest.raises(mo.MotesError) as error:
        mixed(cross_cov=lambda x, u, t: jnp.ones((2, 1))).check(None)
    refused(error, "cross_cov(x_p, u, t)")
    assert mixed().measurement_size(None) == 1 and mixed().check(None) is None


FILTERS = {
    "plain": mo.ParticleFilter(n=8), "auxiliary": mo.AuxiliaryParticleFilter(n=8), "marginalized": mo.MarginalizedParticleFilter(n=8),
    "kernel": mo.KalmanParticleKernelFilter(n=8), "extended": mo.ExtendedKalmanFilter(), "modes": mo.InteractingMultipleModel(),
}  # fmt: skip


@pytest.mark.night
def test_functions_of_the_users_see_the_users_inputs_where_noises_are_correlated():
    seen = []

    def asked(function):
        def of(x, u, t):
            seen.append(u)
            assert set(u) == {"dt", "push"}
            return function(x, u, t)

        return of

    model = mo.StateSpaceModel(
        mo.Gaussian([0.0, 1.0], 0.5 * np.eye(2)),
        mo.AdditiveGaussian(asked(lambda x, u, t: jnp.array([x[0] + u["dt"] * x[1], x[1] + u["push"]])),
                            asked(lambda x, u, t: u["dt"] * jnp.array([[0.3, 0.02], [0.02, 0.2]]))),
        mo.AdditiveGaussian(asked(lambda x, u, t: x[:1] + 0.1 * jnp.sin(x[:1]) + u["dt"]), asked(lambda x, u, t: u["dt"] * jnp.eye(1))),
        noise_cross_cov=asked(lambda x, u, t: u["dt"] * jnp.array([[0.1], [0.05]])))  # fmt: skip
    inputs = {"dt": jnp.linspace(0.5, 1.0, 4), "push": jnp.zeros(4)}
    ys = jnp.zeros((4, 1))
    jax.eval_shape(lambda: mo.simulate(0, model, 4, inputs))

    def proposed(x, uy, t):
        u, y = uy
        return asked(lambda x, u, t: x + 0 * u["push"])(x, u, t) + 0.1 * y

    def added(before, after, u, t):
        return asked(lambda x, u, t: u["dt"] * x)(after, u, t)

    guided = {
        "proposal": mo.ParticleFilter(n=8, proposal=mo.AdditiveGaussian(proposed, np.eye(2))),
        "sums": mo.smoothers.PaRIS(8, added, 2),
    }
    for name, filter in (FILTERS | guided).items():
        seen.clear()
        jax.eval_shape(lambda filter=filter: mo.run(0, filter, model, ys, inputs).mean)
        assert seen, name
    posterior = mo.parameters.PathPosterior(mo.Gaussian([0.0], [[1.0]]), lambda theta: model, ys, inputs)
    jax.eval_shape(lambda key: posterior(posterior.start(key)), jax.random.key(0))


def test_inputs_of_the_step_before_are_handed_on_only_where_they_are_needed():
    base = Autoregression(jnp.array([0.6, 0.3]), 0.5).as_state_space()
    same, drive = base.independent()
    assert same is base and drive.of(1, 2, 3) == 1 and drive.over({"a": np.ones(3)}, None)["a"].shape == (3,)
    crossed = mo.StateSpaceModel(base.initial, base.dynamics, base.sensor, noise_cross_cov=[[0.1], [0.0]])
    apart, drive = crossed.independent()
    assert crossed.correlated and not apart.correlated
    assert drive.of(1, 2, 3) == Augmented(1, 2, 3) and users(Augmented(1, 2, 3)) == 1 and users(4) == 4
    rows = drive.over({"a": np.arange(3.0)}, np.arange(3.0)[:, None])
    assert rows.before["a"].tolist() == [0, 0, 1] and rows.y[:, 0].tolist() == [0, 0, 1]
