"""A filter written outside of the library, as its users would: one file, and nothing else knows of it."""

import jax.numpy as jnp

import motes as mo
from motes.core.checks import refuse
from motes.core.record import record
from motes.filters.info import single
from motes.laws.gaussian import Correction


@record
class TextbookFilter(mo.filters.TwoStageFilter):
    """Kalman filter (Kalman 1960) for models that are given as matrices; its state is a `Gaussian`."""

    weighs = False

    def prepare(self, model, u):
        if not isinstance(model.dynamics, mo.LinearGaussian) or not isinstance(model.sensor, mo.LinearGaussian):
            refuse("TextbookFilter model", "matrices", type(model.dynamics).__name__, "Use KalmanFilter.")
        return model

    def init(self, key, model):
        return mo.Gaussian(model.initial.mean(), model.initial.cov())

    def predict(self, key, model, state, u, t):
        A, Q = model.dynamics.A, model.dynamics.Q
        return mo.Gaussian(A @ state.center, A @ state.covariance @ A.T + Q)

    def correct(self, key, model, state, y, u, t):
        seen = ~jnp.isnan(y)
        # a component that was not measured becomes one of variance 1 that tells of nothing
        H = jnp.where(seen[:, None], model.sensor.A, 0)
        R = jnp.where(seen[:, None] & seen, model.sensor.Q, jnp.eye(y.size, dtype=y.dtype))
        innovation = jnp.where(seen, y - H @ state.center, 0)
        S = H @ state.covariance @ H.T + R
        gain = jnp.linalg.solve(S, H @ state.covariance).T
        cov = state.covariance - gain @ S @ gain.T
        law = mo.Gaussian(state.center + gain @ innovation, (cov + cov.T) / 2)
        max_log_evidence = -0.5 * (jnp.sum(seen) * jnp.log(2 * jnp.pi) + jnp.linalg.slogdet(S)[1])
        evidence = max_log_evidence - 0.5 * innovation @ jnp.linalg.solve(S, innovation)
        return law, single(Correction(law, evidence, max_log_evidence, jnp.sum(seen)))
