"""Structural models: log likelihoods of statsmodels' UnobservedComponents, to 1e-8; what they refuse."""

import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from tiers import each

RNG = np.random.default_rng(0)
X = RNG.normal(size=(60, 2))
Y = 50 + np.cumsum(RNG.normal(size=60)) + 3 * np.tile(RNG.normal(size=6), 10) + RNG.normal(size=60) + X @ [1.0, -2.0]
Y[[3, 20, 21]] = np.nan
LEVEL, WAVE = {"level": "llevel"}, 2 * np.pi / 10
CASES = {
    "level": (lambda: mo.models.local_level(3.0, 0.5), LEVEL, (3.0, 0.5)),
    "trend": (lambda: mo.models.local_linear_trend(3.0, 0.5, 0.1), {"level": "lltrend"}, (3.0, 0.5, 0.1)),
    "smooth": (lambda: mo.models.local_linear_trend(3.0, 0.0, 0.1), {"level": "strend"}, (3.0, 0.1)),
    "walk": (lambda: mo.models.structural(level=0.5), {"level": "rwalk"}, (0.5,)),
    "all": (lambda: mo.models.structural(3.0, 0.5, 0.1, (6, 0.2)), {"level": "lltrend", "seasonal": 6}, (3.0, 0.5, 0.1, 0.2)),
    "season": (lambda: mo.models.seasonal(3.0, 6, 0.2), {"seasonal": 6, "irregular": True}, (3.0, 0.2)),
    "waves": (lambda: mo.models.structural(3.0, 0.5, seasonal=(6, 0.2, 3)),
              LEVEL | {"freq_seasonal": [{"period": 6, "harmonics": 3}]}, (3.0, 0.5, 0.2)),
    "two seasons": (lambda: mo.models.structural(3.0, 0.5, seasonal=[(6, 0.2), (5, 0.3, 2)]),
                    LEVEL | {"seasonal": 6, "freq_seasonal": [{"period": 5, "harmonics": 2}]}, (3.0, 0.5, 0.2, 0.3)),
    "cycle": (lambda: mo.models.structural(3.0, 0.5, cycle=(10.0, 0.2, 0.9)),
              LEVEL | {"cycle": True, "stochastic_cycle": True, "damped_cycle": True}, (3.0, 0.5, 0.2, WAVE, 0.9)),
    "cycle alone": (lambda: mo.models.cycle(3.0, 10.0, 0.2),
                    {"cycle": True, "stochastic_cycle": True, "irregular": True}, (3.0, 0.2, WAVE)),
    "regression": (lambda: mo.models.structural(3.0, 0.5, regressors=2), LEVEL | {"exog": X, "mle_regression": False}, (3.0, 0.5)),
}  # fmt: skip


@pytest.mark.parametrize("name", each({name: name for name in CASES}, set(CASES) - {"all"}))
def test_the_log_likelihood_is_that_of_statsmodels(name, double):
    statsmodels = pytest.importorskip("statsmodels.api", reason="statsmodels is not installed")
    model, words, values = CASES[name]
    reference = statsmodels.tsa.UnobservedComponents(Y, **words)
    history = mo.run(0, mo.KalmanFilter(), model(), Y[:, None], X if "exog" in words else None)
    found = float(np.sum(np.asarray(history.info.log_evidence)[reference.loglikelihood_burn :]))
    assert abs(found - reference.loglike(np.array(values))) < 1e-8


def test_states_have_names():
    both = mo.models.structural(1.0, 0.1, 0.01, [4, (5, 0.1, 1)], (10.0, 0.1, 0.9), {"price": 0.0, "rain": 0.2})
    assert both.names == ("level", "slope", "seasonal4", "seasonal4_1", "seasonal4_2", "seasonal5_cos1", "seasonal5_sin1",
                          "cycle", "cycle_sin", "price", "rain")  # fmt: skip
    assert mo.models.seasonal(1.0, 4, 0.1, harmonics=2).names == ("seasonal_cos1", "seasonal_sin1", "seasonal_cos2")
    assert mo.models.regression(1.0, jnp.array([0.0, 0.1])).names == ("coefficient0", "coefficient1")
    law = mo.Gaussian([3.0], [[2.0]])
    assert mo.models.local_level(1.0, 0.1, law).initial == law
    assert mo.models.regression(1.0, 1).initial.covariance[0, 0] == 1e6


@pytest.mark.parametrize(
    ("make", "words"),
    [(lambda: mo.models.local_level(-1.0, 0.1), ("irregular", "at least 0", "-1")),
     (lambda: mo.models.local_level(1.0, [0.1, 0.2]), ("level", "(a variance)")),
     (lambda: mo.models.local_level(1.0, "x"), ("level", "number")),
     (lambda: mo.models.local_level(1.0, np.nan), ("level", "nan")),
     (lambda: mo.models.local_level(1.0, 1.0, -2.0), ("initial", "-2")),
     (lambda: mo.models.local_level(1.0, 1.0, mo.Gaussian([0.0, 0.0], np.eye(2))), ("names",)),
     (lambda: mo.models.seasonal(1.0, 12.5), ("seasonal period", "whole number")),
     (lambda: mo.models.seasonal(1.0, 1), ("seasonal period", "at least 2")),
     (lambda: mo.models.seasonal(1.0, 12, 0.1, 7), ("harmonics", "at most half of the period, 6")),
     (lambda: mo.models.cycle(1.0, 2.0), ("cycle period", "above 2")),
     (lambda: mo.models.cycle(1.0, 9.0, damping=1.1), ("cycle damping", "at most 1")),
     (lambda: mo.models.regression(1.0, 0), ("regressors", "at least 1")),
     (lambda: mo.models.regression(1.0, None), ("regressors", "how many")),
     (lambda: mo.models.regression(1.0, ["price", "promo"]), ("regressors", "'price', 'promo'", "{'price': 0.0}")),
     (lambda: mo.models.regression(1.0, "price"), ("regressors", "got 'price'", "{'price': 0.0}")),
     (lambda: mo.models.structural(1.0), ("structural", "none of them")),
     (lambda: mo.models.structural(1.0, trend=0.1), ("structural level", "None")),
     (lambda: mo.models.structural(1.0, 0.1, seasonal=(12, 0.1, 2, 3)), ("structural seasonal", "harmonics")),
     (lambda: mo.run(0, mo.KalmanFilter(), mo.models.regression(1.0, 2), Y[:, None]), ("inputs", "2 regressors", "none")),
     (lambda: mo.run(0, mo.KalmanFilter(), mo.models.regression(1.0, 3), Y[:, None], X), ("inputs", "3 regressors", "(2,)")),
     (lambda: mo.models.stochastic_volatility(0.0, 1.0, 0.1), ("phi", "between -1 and 1")),
     (lambda: mo.models.stochastic_volatility(0.0, 0.9, 0.0), ("sigma", "above 0")),
     (lambda: mo.models.stochastic_volatility(0.0, 0.9, 0.1, -1.0), ("leverage", "between -1 and 1"))],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(make, words):
    with pytest.raises(mo.MotesError) as error:
        make()
    refused(error, *words)


def by_a_grid(ys, mu, phi, sigma, rho, nodes=1_200, reach=7.0):
    """Log likelihood of stochastic volatility with leverage, by sums over a fine grid."""
    h = np.linspace(mu - reach, mu + reach, nodes)
    step = h[1] - h[0]

    def normal(x, mean, var):
        return np.exp(-0.5 * (x - mean) ** 2 / var) / np.sqrt(2 * np.pi * var)

    law, total = normal(h, mu, sigma**2 / (1 - phi**2)), 0.0
    for y in ys:
        seen = law if np.isnan(y) else law * normal(y, 0.0, np.exp(h))
        pull = 0.0 if np.isnan(y) else rho * sigma * y * np.exp(-h / 2)
        total += np.log(seen.sum() * step)
        spread = sigma**2 * (1 - (0 if np.isnan(y) else rho**2))
        law = normal(h[:, None], (mu + phi * (h - mu) + pull)[None], spread) @ (seen / seen.sum())
    return total


@pytest.mark.parametrize("rho", each([-0.6, None], {"None"}))
def test_stochastic_volatility_has_the_likelihood_of_a_grid(rho, double):
    model = mo.models.stochastic_volatility(-0.5, 0.9, 0.4, rho)
    ys = np.array(mo.simulate(1, model, 25)[1])
    ys[4] = np.nan
    found = mo.run(0, mo.PointMassFilter((-5.0,), (4.0,), (400,)), model, ys).log_likelihood
    assert abs(float(found) - by_a_grid(ys[:, 0], -0.5, 0.9, 0.4, rho or 0.0)) < 1e-5


def test_regressors_with_names_are_taken_from_tables_by_name(double):
    pandas = pytest.importorskip("pandas")
    model = mo.models.structural(irregular=0.1, level=0.01, regressors={"price": 0.0, "promo": 0.0})
    draw = np.random.default_rng(0)
    table = pandas.DataFrame({"price": draw.normal(size=30), "other": 1.0, "promo": draw.normal(size=30)})
    xs, ys = mo.simulate(1, model, 30, table)
    turned = table[["promo", "price"]]
    np.testing.assert_array_equal(mo.simulate(1, model, 30, turned)[1], ys)
    found, wanted = (mo.run(0, mo.KalmanFilter(), model, ys, inputs) for inputs in (turned, table[["price", "promo"]].to_numpy()))
    np.testing.assert_array_equal(found.mean, wanted.mean)
    ahead = mo.forecast(found, 3, turned[:3]).mean, mo.forecast(wanted, 3, table[["price", "promo"]].to_numpy()[:3]).mean
    np.testing.assert_array_equal(*ahead)
    smoothed = [mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, found, ys, inputs).mean for inputs in (turned, table)]
    np.testing.assert_array_equal(*smoothed)
    with pytest.raises(mo.MotesError, match="inputs: expected the columns price, promo, got price, place"):
        mo.run(0, mo.KalmanFilter(), model, ys, table.rename(columns={"promo": "place"})[["price", "place"]])
    chain = mo.JumpMarkovModel([0.5, 0.5], [[0.9, 0.1], [0.1, 0.9]], [model, model])
    np.testing.assert_array_equal(*(mo.run(0, mo.InteractingMultipleModel(), chain, ys, inputs).mean for inputs in (turned, table)))
    shouted = turned.rename(columns=str.upper)[["PRICE", "PROMO"]]
    np.testing.assert_array_equal(mo.run(0, mo.KalmanFilter(), model, ys, shouted).mean, wanted.mean)
