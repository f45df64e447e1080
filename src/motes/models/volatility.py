"""Stochastic volatility: returns whose variance is the exponential of a hidden state."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.models.state_space import StateSpaceModel


def stochastic_volatility(mu: Any, phi: Any, sigma: Any, leverage: Any = None) -> StateSpaceModel:
    """Returns whose log variance goes back to a level (stochastic volatility): state `log_variance`.

        y_t = exp(h_t / 2) e_t,   h_{t+1} = mu + phi (h_t - mu) + sigma n_t,   e_t and n_t standard normal of correlation `leverage`

    h_0 has the stationary law. The sensor says of h what scatter alone can: use particles, or a grid (`mo.PointMassFilter`).

    Sources: Taylor 1982, Financial returns modelled by the product of two stochastic processes; Harvey, Ruiz, Shephard 1994,
    Multivariate stochastic variance models.

    Example:
        >>> model = mo.models.stochastic_volatility(mu=-0.6, phi=0.97, sigma=0.15)
        >>> xs, ys = mo.simulate(0, model, 500)

    Args:
        mu: level of the log variance.
        phi: persistence, between -1 and 1.
        sigma: standard deviation of a step of the log variance, above 0.
        leverage: correlation, between -1 and 1, of a return with the step of the log variance after it; None for none.

    Raises:
        MotesError: a parameter has a value it cannot have.
    """
    given = {"mu": mu, "phi": phi, "sigma": sigma}
    mu, phi, sigma = (checks.as_float(f"stochastic_volatility {name}", value) for name, value in given.items())
    for name, value in zip(given, (mu, phi, sigma), strict=True):
        checks.shape(f"stochastic_volatility {name}", value, ())
        checks.finite(f"stochastic_volatility {name}", value)
    _within("phi", phi)
    checks.above_zero("stochastic_volatility sigma", sigma)
    stationary = sigma**2 / (1 - phi**2)
    cross = None
    if leverage is not None:
        rho = checks.as_float("stochastic_volatility leverage", leverage)
        _within("leverage", rho)
        cross = lambda h, u, t: (rho * sigma * jnp.exp(h / 2))[:, None]  # noqa: E731
    return StateSpaceModel(
        Gaussian(mu[None], stationary[None, None]),
        AdditiveGaussian(lambda h, u, t: mu + phi * (h - mu), (sigma**2)[None, None]),
        AdditiveGaussian(lambda h, u, t: jnp.zeros_like(h), lambda h, u, t: jnp.exp(h)[:, None]),
        ("log_variance",),
        cross,
    )


def _within(name: str, value: Any) -> None:
    if checks.is_concrete(value) and not (np.ndim(value) == 0 and -1 < float(value) < 1):
        checks.refuse(f"stochastic_volatility {name}", "a number between -1 and 1", value)
