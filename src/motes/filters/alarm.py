"""The alarm of a filter that lies: measurements are held against what the filter predicted of them.

1. Normalized innovation squared (NIS), in units of the covariance predicted of y. Of a cloud, mean and covariance are those of what
   some of its particles predict, and the cloud says itself how its squares scatter: they are brought to the mean and variance of a
   chi-square number of `freedom` degrees (Satterthwaite 1946), fewer than components of y where the prediction has heavy tails.
2. Noises that are no Gaussians: the rank of the square among those of predicted draws, as the chi-square number of that rank.
3. Cumulative sum (Page 1954) of the log likelihood ratio of an innovation covariance four times the claimed one,
   C <- max(0, C + 3/8 nis - freedom log 2); past a threshold the alarm rings and the sum starts anew.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammainc

from motes.core import linalg, random
from motes.laws.circular import wrap
from motes.laws.conditional import AdditiveGaussian, Conditional, matrix_over
from motes.laws.density import among, measured_in, zeroed
from motes.laws.observed import Observed
from motes.native import blocks

THRESHOLD = 10.0
"""Nats of the cumulative sum at which the alarm rings: once in more than 1e5 steps where all claims are right."""
MOST = 5.0
"""Nats that one step can add: one wild measurement alone is no alarm."""
WIDER = 4.0
"""Covariance of innovations, in units of the claimed one, that the sum is made to find soonest (Lorden 1971)."""
FEWEST, MANY = 128, 256
"""Particles that are asked for predictions: a sixteenth of all, between the two."""
TOO_FEW = 4.0
"""Effective number of the particles asked, below which they do not stand for the cloud."""


class Innovation(NamedTuple):
    """How far a measurement lies from its prediction.

    Attributes:
        square: `()`, a chi-square number where the claims are right.
        freedom: its degrees of freedom, `()`; 0 where nothing was measured or no prediction is known.
    """

    square: jax.Array
    freedom: jax.Array


def advanced(total: jax.Array, square: jax.Array, freedom: jax.Array, y: Any) -> tuple[jax.Array, jax.Array]:
    """Return the cumulative sum after one more measurement y, and whether the alarm rings."""
    after = jnp.maximum(total + gain(square, freedom, _most(freedom, y)), 0)
    rings = after > THRESHOLD
    return jnp.where(rings, 0, after), rings


def advanced_in_parallel(square: jax.Array, freedom: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Do what `advanced` does for all steps `(t,)` at once; the sum is not started anew, so that a lasting cause rings once.

    Steps combine as max-plus maps x -> max(x + a, b). Returns the last sum, at most the threshold, and where the alarm rings `(t,)`.
    """
    first = gain(square, freedom)
    steps = (first, jnp.zeros_like(first))
    shift, least = jax.lax.associative_scan(lambda one, two: (one[0] + two[0], jnp.maximum(one[1] + two[0], two[1])), steps)
    over = jnp.maximum(shift, least) > THRESHOLD
    return jnp.minimum(jnp.maximum(shift, least)[-1], THRESHOLD), over & ~jnp.concatenate([jnp.zeros((1,), bool), over[:-1]])


def gain(square: jax.Array, freedom: jax.Array, most: Any = MOST) -> jax.Array:
    """Log likelihood ratio of innovations as wide as the alarm is made for; a square that is not a number counts as the largest."""
    ratio = 0.5 * (1 - 1 / WIDER) * square - 0.5 * np.log(WIDER) * freedom
    return jnp.where(freedom > 0, jnp.where(ratio < most, ratio, most), 0)


def largest_square(freedom: Any) -> Any:
    """Return the largest square that counts in an average over steps, about that which counts in the sum: one wild step is not many."""
    most = MOST * (freedom / np.maximum(np.ceil(freedom), 1)) ** 3
    return (most + 0.5 * np.log(WIDER) * freedom) / (0.5 * (1 - 1 / WIDER))


def _most(freedom: jax.Array, y: Any) -> jax.Array:
    """Nats that a measurement y can add: fewer where `freedom` lacks something of the number of its components.

    Heavier tails than a Gaussian's, which is what the lack is a sign of, are seen by few particles: the further they go, the less one
    measurement may tell.
    """
    if isinstance(y, Observed):
        return jnp.asarray(MOST, freedom.dtype)
    seen = jnp.sum(~jnp.isnan(y), dtype=freedom.dtype)
    return MOST * jnp.minimum(freedom / jnp.maximum(seen, 1), 1) ** 3


def unknown(dtype: Any) -> Innovation:
    """Return what is said of a measurement without a prediction."""
    return Innovation(jnp.zeros((), dtype), jnp.zeros((), dtype))


def some_of(n: int, most: int = MANY) -> slice:
    """Places of the particles that are asked: evenly spaced, since resampling leaves the offspring of one parent side by side."""
    return slice(0, n, max(1, n // min(max(n // 16, FEWEST), most)))


def few_of(log_weights: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Indices `(k,)` of columns of log weights `(m, n)` that stand for all, and their log weights `(m, k)`.

    Every column, or where they are many some, taken evenly along the sum of their weights, which are too uneven for `some_of`.
    """
    n = log_weights.shape[1]
    if n <= FEWEST:
        return jnp.arange(n), log_weights
    totals = jax.nn.logsumexp(log_weights, axis=0)
    sums = jnp.cumsum(jnp.exp(totals))
    at = (jnp.arange(FEWEST, dtype=sums.dtype) + 0.5) / FEWEST * sums[-1]
    taken = jnp.clip(jnp.searchsorted(sums, at), 0, n - 1)
    return taken, log_weights[:, taken] - totals[taken]


def within(gate: float, square: jax.Array, freedom: jax.Array) -> jax.Array:
    """Tell whether a measurement lies in the region that holds a share `gate` of chi-square numbers."""
    return gammainc(0.5 * jnp.maximum(freedom, 1e-3), 0.5 * square) <= gate


def of_cloud(  # noqa: PLR0913 (a step's, and the size of the whole cloud)
    key: jax.Array, sensor: Conditional, X: jax.Array, log_weights: jax.Array, y: jax.Array, u: Any, t: Any, n: int = 0
) -> Innovation:
    """Normalized innovation squared of y `(y,)` given weighted particles X `(x, m)` before they saw it.

    Args:
        key: for sensors whose noise is drawn.
        sensor: the sensor.
        X: some of the particles.
        log_weights: of these, not normalized, `(m,)`.
        y: the measurement.
        u: inputs of the step.
        t: its number.
        n: of how many particles they are some, where native kernels may judge by that whether they pay.
    """
    if isinstance(y, Observed):
        return unknown(X.dtype)
    X, log_weights = _apart((X, log_weights))
    if isinstance(sensor, AdditiveGaussian):
        given = (sensor.means(X, u, t), matrix_over(sensor.Q, X, u, t), log_weights, y)
        in_jax = partial(of_mixture, sensor.angles)
        return Innovation(*(blocks.innovation(n, in_jax, sensor.angles, *given) or in_jax(*given)))
    if not sensor.draws:
        return unknown(X.dtype)
    return _ranked(sensor, sensor.sample(random.child(key, random.MEASURE), X, u, t), log_weights, y)


def of_mixture(
    angles: tuple[int, ...], centers: jax.Array, covs: jax.Array, log_weights: jax.Array, y: jax.Array, drawn: bool = True
) -> Innovation:
    """Normalized innovation squared of a measurement where m Gaussians are predicted of it.

    Args:
        angles: components of y that are angles in radians.
        centers: means `(y, m)`.
        covs: `(y, y)` or `(y, y, m)`.
        log_weights: not normalized, `(m,)`.
        y: the measurement.
        drawn: whether the Gaussians are a sample of more.
    """
    seen = measured_in(y, covs)
    seen = jnp.all(seen, axis=1) if seen.ndim == 2 else seen
    spread = _spread(angles, centers, log_weights, y, seen)
    off, weights, size, inside = spread.off, spread.weights, y.shape[0], among(covs, seen)
    factor = linalg.cholesky(spread.cov + (inside @ weights if inside.ndim == 3 else inside))
    square = jnp.sum(linalg.solve_lower(factor, spread.middle) ** 2)
    # about the predicted mean the squares of the m Gaussians have the mean `size`; their second moment says how they scatter
    off = linalg.solve_lower(factor, off - spread.middle[:, None])
    inside = linalg.solve_lower(factor, linalg.transpose(linalg.solve_lower(factor, inside)))
    own, twice = jnp.trace(inside), jnp.sum(inside**2, axis=(0, 1))
    between = jnp.sum(off**2, axis=0)
    if inside.ndim == 3:
        across = jnp.sum(off * linalg.times_vector(inside, off), axis=0)
        second, share = weights @ ((own + between) ** 2 + 2 * twice + 4 * across), (weights @ between) / size
    else:
        # spread and own covariance add up to the identity: two of the sums over particles are known
        second, share = weights @ between**2 + own * (2 * size - own) + 4 * own - 2 * twice, 1 - own / size
    # few particles know their spread badly: the square scatters as Student's does
    count = spread.count if drawn else jnp.inf
    variance = second - size**2 + 2 * size * (size + 2) * share**2 / count
    wider = jnp.maximum(variance / (2 * size), 1)
    freedom = jnp.sum(seen, dtype=y.dtype) / wider
    square = square / (wider * (1 + share / count))
    # a cloud so uneven that the particles asked have none of its weight predicts nothing: its starvation is told otherwise
    known = spread.count > TOO_FEW if drawn else jnp.ones((), bool)
    return Innovation(jnp.where(known, square, 0), jnp.where(known, freedom, 0))


class _Spread(NamedTuple):
    """Predicted values about a measurement: differences `(y, m)`, their weights, effective number, mean and covariance."""

    off: jax.Array
    weights: jax.Array
    count: jax.Array
    middle: jax.Array
    cov: jax.Array


def _spread(angles: tuple[int, ...], values: jax.Array, log_weights: jax.Array, y: jax.Array, seen: jax.Array) -> _Spread:
    """Take values `(y, m)` less the measurement, zero where it is missing; what is not a number has no weight.

    Differences of angles are wrapped about the heaviest value, so that those of one side stay together.
    """
    about = values[:, jnp.argmax(log_weights)] if angles else y
    off = zeroed(wrap(values - about[:, None], angles), seen)
    off = off - zeroed(wrap(y - about, angles), seen)[:, None] if angles else off
    valid = jnp.all(jnp.isfinite(off), axis=0)
    weights, off = jnp.where(valid, jnp.exp(log_weights), 0), jnp.where(valid, off, 0)
    # all sums over particles in one product: one after the other they take most of the time
    rows = jnp.concatenate([off, weights[None], jnp.ones_like(weights)[None]])
    sums = linalg.product_transposed(rows * weights, rows)
    total, middle = sums[-1, -1], sums[-1, :-2] / sums[-1, -1]
    return _Spread(off, weights / total, total**2 / sums[-1, -2], middle, sums[:-2, :-2] / total - middle[:, None] * middle)


def _ranked(sensor: Conditional, draws: jax.Array, log_weights: jax.Array, y: jax.Array) -> Innovation:
    """Normalized innovation squared of y among weighted draws `(y, m)` of what was predicted."""
    from scipy.special import gammaincinv  # here, because to load it takes a tenth of the time in which a program begins

    size, count = draws.shape
    seen = ~jnp.isnan(y)
    spread = _spread(sensor.angles, draws, log_weights, y, seen)
    factor = linalg.cholesky(among(spread.cov, seen))
    square, others = (jnp.sum(linalg.solve_lower(factor, e) ** 2, axis=0) for e in (spread.middle, spread.off - spread.middle[:, None]))
    rank = jnp.sum(jnp.where(others < square, spread.weights, 0))
    ranks = (np.arange(count + 1) + 0.5) / (count + 1)
    table = np.stack([2 * gammaincinv(degrees / 2, ranks) if degrees else np.zeros(count + 1) for degrees in range(size + 1)])
    measured = jnp.sum(seen)
    square = jnp.asarray(table, y.dtype)[measured, jnp.clip(jnp.round(rank * count), 0, count).astype(jnp.int32)]
    return Innovation(square, measured.astype(y.dtype))


def _apart(tree: Any) -> Any:
    """Keep what is read here out of the loops that filter: neither its bits nor its derivatives are to depend on the alarm."""
    return jax.lax.optimization_barrier(jax.lax.stop_gradient(tree))
