"""Gaussian densities from factors, also where the covariance is singular or components were not measured."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import linalg

LOG_2PI = float(np.log(2 * np.pi))
ROUNDING = 64.0
"""So many units in the last place rounding may have added up to."""


def measured_in(y: jax.Array, R: jax.Array) -> jax.Array:
    """Tell which components of y `(y,)` were measured, `(y,)` or `(y, n)`: neither NaN nor with an infinite variance in R `(y, y, *n)`."""
    finite = jnp.isfinite(linalg.diagonal_of(R))
    return finite & ~(jnp.isnan(y)[:, None] if finite.ndim == 2 else jnp.isnan(y))


def slack(dtype: Any) -> float:
    """Rounding that numbers are trusted to, as a share of their size."""
    return ROUNDING * float(jnp.finfo(dtype).eps)


def carried(dtype: Any) -> float:
    """Share of their size that states found from measurements are trusted to: dividing by small variances costs half the digits."""
    return float(jnp.finfo(dtype).eps) ** 0.5


def noiseless(R: jax.Array) -> jax.Array:
    """Tell of each component of a noise of covariance R `(y, y, *n)` whether those before it say all of it, `(y, *n)`."""
    return ~(linalg.diagonal_of(linalg.cholesky(R)) > 0)


def log_normal(
    residual: jax.Array,
    cov: jax.Array,
    seen: jax.Array | None = None,
    size: jax.Array | float = 0.0,
    exact: jax.Array | None = None,
    trusted: float | None = None,
) -> jax.Array:
    """Log density of a zero-mean Gaussian at residuals `(y, *n)`, of the components in `seen` (`(y,)`, `(y, n)`, None for all).

    Args:
        residual: difference of a value and its mean.
        cov: covariance `(y, y, *n)`; where it is singular the density is that on its span, and zero elsewhere.
        seen: see above.
        size: see `log_density`.
        exact: likewise.
        trusted: likewise.
    """
    return log_density(*_reduced(residual, cov, seen), seen, size, exact, trusted)[0]


def max_log_normal(residual: jax.Array, cov: jax.Array, seen: jax.Array | None = None) -> jax.Array:
    """Largest value that `log_normal` takes with the same covariance and components, `()` or `(n,)`."""
    return log_density(*_reduced(residual, cov, seen), seen)[1]


def _reduced(residual: jax.Array, cov: jax.Array, seen: jax.Array | None) -> tuple[jax.Array, jax.Array]:
    if seen is None:
        return residual, linalg.cholesky(cov)
    return zeroed(residual, seen), linalg.cholesky(among(cov, seen))


def zeroed(rows: jax.Array, seen: jax.Array, small_axes: int = 1) -> jax.Array:
    """Put zeros where a component is not seen, `(y,)` or `(y, n)`, in rows `(y, *n)`, or with two small axes `(y, k, *n)`."""
    batch = max(rows.ndim - small_axes, seen.ndim - 1)
    wide = seen.reshape(seen.shape[0], *[1] * (small_axes - 1), *(seen.shape[1:] or [1] * batch))
    return jnp.where(wide, rows.reshape(*rows.shape, *[1] * (batch + small_axes - rows.ndim)), 0)


def among(R: jax.Array, seen: jax.Array) -> jax.Array:
    """Covariance with unseen components made independent of the rest, with variance one."""
    both = seen[:, None] & seen[None]
    unit = jnp.eye(R.shape[0], dtype=R.dtype)
    if both.ndim == 3 or R.ndim == 3:
        unit = unit[..., None]
        both = both if both.ndim == 3 else both[..., None]
        R = R if R.ndim == 3 else R[..., None]
    return jnp.where(both, R, unit)


def log_density(
    residual: jax.Array,
    factor: jax.Array,
    seen: jax.Array | None,
    size: jax.Array | float = 0.0,
    exact: jax.Array | None = None,
    trusted: float | None = None,
) -> tuple[jax.Array, jax.Array]:
    """`log_normal` and its maximum, from the lower factor of the covariance; components not seen are zero and of variance one.

    Args:
        residual: `(y, *n)`.
        factor: `(y, y, *n)`; a pivot of zero says that the components before it say all of this one.
        seen: see `log_normal`.
        size: how large the numbers are whose difference the residual is, `(y, *n)`: how far rounding may have led off the span.
        exact: components `(y, *n)` whose zero pivots are to be believed; others are left out, since rounding made them. None for all.
        trusted: share of the size that rounding may have; None for that of the type.
    """
    factor, residual = same_batch(factor, residual, 1)
    white, beyond = _whitened(factor, residual, size, slack(factor.dtype) if trusted is None else trusted)
    alive = linalg.diagonal_of(factor) > 0
    believed = ~alive if exact is None else ~alive & (exact[:, None] if exact.ndim < alive.ndim else exact)
    off = jnp.any(believed[:, None] & (beyond > 0) if believed.ndim < beyond.ndim else believed & (beyond > 0), axis=0)
    counted = alive if seen is None else alive & (seen[:, None] if seen.ndim < alive.ndim else seen)
    highest = -0.5 * (linalg.log_determinant(factor) + LOG_2PI * jnp.sum(counted, axis=0))
    return jnp.where(off, -jnp.inf, highest - 0.5 * jnp.sum(white**2, axis=0)), highest


def _whitened(factor: jax.Array, residual: jax.Array, size: jax.Array | float, trusted: float) -> tuple[jax.Array, jax.Array]:
    """Solve L z = b as `solve_lower` does; also return by how much what is left of each component exceeds its rounding, `(y, *n)`."""
    size = jnp.abs(residual) + (size[:, None] if isinstance(size, jax.Array) and size.ndim < residual.ndim else size)
    rows: list[jax.Array] = []
    sizes: list[jax.Array] = []
    beyond: list[jax.Array] = []
    for i in range(factor.shape[0]):
        inverse = linalg.inverse(factor[i, i])
        left = residual[i] - sum(factor[i, j] * row for j, row in enumerate(rows))
        reach = size[i] + sum(jnp.abs(factor[i, j]) * one for j, one in enumerate(sizes))
        rows.append(left * inverse)
        sizes.append(reach * inverse)
        beyond.append(jnp.abs(left) - trusted * reach)
    return jnp.stack(rows), jnp.stack(beyond)


def same_batch(factor: jax.Array, b: jax.Array, small_axes: int = 2) -> tuple[jax.Array, jax.Array]:
    """Give b, of so many small axes, a particle axis where the factor `(y, y, *n)` has one."""
    if factor.ndim == 3 and b.ndim == small_axes:
        b = b[..., None]
    return factor, b
