"""Rauch-Tung-Striebel smoothing where the predicted covariance is singular or nearly so, against exact rational arithmetic."""

from fractions import Fraction

import jax
import numpy as np
import pytest

import motes as mo
from motes.smoothers import rauch_tung_striebel
from tiers import each

Matrix = list[list[Fraction]]


def exact(values) -> Matrix:
    return [[Fraction(float(v)) for v in row] for row in values]


def times(a: Matrix, b: Matrix) -> Matrix:
    return [[sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0)) for column in zip(*b, strict=True)] for row in a]


def turned(a: Matrix) -> Matrix:
    return [list(row) for row in zip(*a, strict=True)]


def solved(a: Matrix, b: Matrix) -> Matrix:
    """a^-1 b by elimination, without any rounding."""
    rows = [left + right for left, right in zip(a, b, strict=True)]
    for i in range(len(rows)):
        pivot = next(k for k in range(i, len(rows)) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for k in range(len(rows)):
            if k != i and rows[k][i] != 0:
                rows[k] = [x - rows[k][i] * y for x, y in zip(rows[k], rows[i], strict=True)]
    return [row[len(a) :] for row in rows]


def smoothed_exactly(P0, A, Q, H, R, ys) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances of all states given all measurements, from their joint law; zero initial mean."""
    A, Q, H, size, steps = exact(A), exact(Q), exact(H), len(A), len(ys)
    cov: list[list[Matrix]] = [[[] for _ in range(steps)] for _ in range(steps)]
    cov[0][0] = exact(P0)
    for t in range(1, steps):
        moved = times(times(A, cov[t - 1][t - 1]), turned(A))
        cov[t][t] = [[x + q for x, q in zip(r, s, strict=True)] for r, s in zip(moved, Q, strict=True)]
    for s in range(steps):
        for t in range(s + 1, steps):
            cov[t][s] = times(A, cov[t - 1][s])
            cov[s][t] = turned(cov[t][s])
    seen = [t for t in range(steps) if not np.isnan(ys[t])]
    between = [[times(times(H, cov[s][t]), turned(H))[0][0] + (Fraction(R) if s == t else 0) for t in seen] for s in seen]
    values = [[Fraction(float(ys[t]))] for t in seen]
    means, covs = np.zeros((steps, size)), np.zeros((steps, size, size))
    for t in range(steps):
        across = turned([[row[0] for row in times(cov[t][s], turned(H))] for s in seen])
        gain = turned(solved(between, turned(across)))
        means[t] = np.array([[float(v) for v in row] for row in times(gain, values)])[:, 0]
        left = times(gain, turned(across))
        covs[t] = [[float(c - g) for c, g in zip(r, s, strict=True)] for r, s in zip(cov[t][t], left, strict=True)]
    return means, covs


def arma(phi, theta, r, steps=16, gap=(5, 6, 7, 8, 12)):
    """ARMA(2, 1) in Harvey's form, from its stationary law, measured without noise (r = 0), with gaps."""
    A, g = np.array([[phi[0], 1], [phi[1], 0]]), np.array([[1.0], [theta]])
    Q, P0 = g @ g.T, np.eye(2)
    for _ in range(400):
        P0 = A @ P0 @ A.T + Q
    P0 = np.round(P0 * 2**20) / 2**20
    rng = np.random.default_rng(3)
    x, ys = np.linalg.cholesky(P0 + 1e-12 * np.eye(2)) @ rng.normal(size=2), []
    for _ in range(steps):
        ys.append(x[0] + np.sqrt(r) * rng.normal())
        x = A @ x + g[:, 0] * rng.normal()
    ys = np.float32(ys).astype(float)
    ys[list(gap)] = np.nan
    return P0, A, Q, [[1.0, 0.0]], r, ys


CASES = {
    "measured exactly": arma((0.5, 0.25), 0.375, 0.0),
    "nearly exactly": arma((0.5, 0.25), 0.375, 2.0**-30),
    "no moving average": arma((1.25, -0.5), 0.0, 0.0),
    "root near one": arma((0.5, 0.25), -0.96875, 0.0),
    "long": arma((0.5, 0.25), 0.375, 0.0, 34, (17, 18, 19)),
}
FILTERS = {"Kalman": mo.KalmanFilter(), "square root": mo.SquareRootKalmanFilter(), "extended": mo.ExtendedKalmanFilter()}


@pytest.mark.parametrize("name", each(list(CASES), {"no moving average", "root near one", "long"}))
def test_arma_with_a_gap(name: str) -> None:
    P0, A, Q, H, r, ys = CASES[name]
    mean, cov = smoothed_exactly(P0, A, Q, H, r, ys)
    for bits, atol in ((True, 1e-8), (False, 1e-3)):
        with jax.enable_x64(bits):
            model = mo.StateSpaceModel(mo.Gaussian(np.zeros(2), P0), mo.LinearGaussian(A, Q), mo.LinearGaussian(H, [[r]]))
            for label, filter in FILTERS.items():
                smoother = mo.smoothers.RauchTungStriebelSmoother()
                found = mo.smooth(0, smoother, model, mo.run(0, filter, model, ys[:, None]))
                np.testing.assert_allclose(np.asarray(found.mean), mean, atol=atol, err_msg=label)
                np.testing.assert_allclose(np.asarray(found.cov), cov, atol=atol, err_msg=label)


def test_what_is_noise_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the test of what the future says, rounding multiplies up over the steps: what smoothers without it do."""
    monkeypatch.setattr(rauch_tung_striebel, "_ROUNDING", -1.0)
    P0, A, Q, H, r, ys = CASES["long"]
    _, cov = smoothed_exactly(P0, A, Q, H, r, ys)
    model = mo.StateSpaceModel(mo.Gaussian(np.zeros(2), P0), mo.LinearGaussian(A, Q), mo.LinearGaussian(H, [[r]]))
    jax.clear_caches()
    found = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, mo.run(0, mo.KalmanFilter(), model, ys[:, None]))
    jax.clear_caches()
    assert np.abs(np.asarray(found.cov) - cov).max() > 0.1


def test_wide_priors_in_float32() -> None:
    """Through the factors a prior of 1e7 costs a smoother no digits: the square-root filter's moments are smoothed as in float64."""
    ys = np.cumsum(np.random.default_rng(0).normal(0, 0.5, 30)) + 50 + np.random.default_rng(1).normal(0, 1, 30)
    found = {}
    for bits in (True, False):
        with jax.enable_x64(bits):
            model = mo.StateSpaceModel(
                mo.Gaussian([0.0, 0.0], 1e7 * np.eye(2)),
                mo.LinearGaussian([[1, 1], [0, 1]], np.diag([0.25, 0.01])),
                mo.LinearGaussian([[1.0, 0]], [[1.0]]),
            )
            history = mo.run(0, mo.SquareRootKalmanFilter(), model, ys[:, None])
            done = mo.smooth(0, mo.smoothers.RauchTungStriebelSmoother(), model, history)
            found[bits] = np.asarray(done.mean, float), np.asarray(done.cov, float)
    for single, right in zip(found[False], found[True], strict=True):
        np.testing.assert_allclose(single, right, rtol=2e-3, atol=2e-3)
