"""The Gaussian law: affine maps of it and conditioning on measurements; Kalman filters are written with these two alone."""

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks, linalg, random
from motes.core.record import record
from motes.laws.density import LOG_2PI, ROUNDING, among, carried, log_density, log_normal, noiseless, same_batch, zeroed
from motes.laws.law import Law

L = TypeVar("L")


@record
class Gaussian(Law):
    """A Gaussian law, or a batch of n of them with the particle axis last.

    Attributes:
        center: mean, `(x,)` or `(x, n)`.
        covariance: covariance, `(x, x)` (in a batch: shared by all) or `(x, x, n)`; positive semi-definite.
    """

    center: jax.Array
    covariance: jax.Array

    def __init__(self, mean: ArrayLike | Sequence[Any], cov: ArrayLike | Sequence[Any]):
        """Check shapes and, where the numbers are known, that the covariance is one.

        Args:
            mean: mean, `(x,)` or `(x, n)`.
            cov: covariance, `(x, x)` or `(x, x, n)`.

        Raises:
            MotesError: shapes do not fit, numbers are not finite, or the covariance is not positive semi-definite.
        """
        center, covariance = checks.as_float("Gaussian mean", mean), checks.as_float("Gaussian cov", cov)
        dtype = jnp.result_type(center, covariance)
        if center.ndim not in (1, 2):
            checks.refuse("Gaussian mean", "shape (x,) or (x, n)", f"shape {center.shape}")
        if covariance.ndim == 3:
            checks.shape("Gaussian cov", covariance, (center.shape[0], center.shape[0], center.shape[-1]))
        else:
            checks.covariance("Gaussian cov", covariance, center.shape[0])
        checks.finite("Gaussian mean", center)
        object.__setattr__(self, "center", center.astype(dtype))
        object.__setattr__(self, "covariance", covariance.astype(dtype))

    def mean(self) -> jax.Array:
        """Mean, `(x,)` or `(x, n)`."""
        return self.center

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)` or `(x, x, n)`."""
        return self.covariance

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points `(x, n)`; a batch of n laws gives one point each."""
        noise = random.normal(key, (self.center.shape[0], n), self.center.dtype)
        return linalg.add_vectors(linalg.times_vector(linalg.cholesky(self.covariance), noise), self.center)

    def sample_each(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points of each of a batch of m laws, `(x, n, m)`; covariances are `(x, x, m)`."""
        size, laws = self.center.shape
        noise = random.normal(key, (size, n * laws), self.center.dtype).reshape(size, n, laws)
        factor = linalg.cholesky(self.covariance)
        # written out: compilers hand a batch of such small products to a library that takes four times as long
        return self.center[:, None] + linalg.times_vector(factor[:, :, None], noise)

    def log_prob(self, value: jax.Array, size: jax.Array | None = None) -> jax.Array:
        """Log density at `(x,)` or `(x, n)`; NaN components are left out (the density of the rest).

        Where the covariance is singular it is the density on its span, and minus infinity elsewhere; `log_density` says what size is, here
        None for that of the value.
        """
        size = jnp.abs(value) if size is None else size
        return log_normal(linalg.add_vectors(value, -self.center), self.covariance, ~jnp.isnan(value), size)

    def through(self, A: jax.Array, b: jax.Array, Q: jax.Array) -> "Gaussian":
        """Return the law of A x + b + noise of covariance Q.

        Args:
            A: `(z, x, *n)`.
            b: `(z, *n)`.
            Q: `(z, z, *n)`.
        """
        moved = linalg.add_vectors(linalg.times_vector(A, self.center), b)
        return Gaussian(moved, linalg.add(linalg.sandwich(A, self.covariance), Q))

    def given(self, y: jax.Array, H: jax.Array, d: jax.Array, R: jax.Array) -> tuple["Gaussian", jax.Array]:
        """Condition on a measurement y = H x + d + e, e of covariance R; NaN components of y are left out.

        The covariance is kept in Joseph form, which stays positive semi-definite when R is tiny beside H P H'.

        Args:
            y: measurement, `(y,)` or `(y, n)`.
            H: `(y, x, *n)`.
            d: `(y, *n)`.
            R: `(y, y, *n)`.

        Returns:
            The conditional law, and the log density of y before it was known, `()` or `(n,)`.
        """
        prediction = linalg.add_vectors(linalg.times_vector(H, self.center), d)
        corrected = self.corrected(linalg.add_vectors(y, -prediction), H, R, ~jnp.isnan(y))
        return corrected.law, corrected.log_evidence

    def corrected(self, innovation: jax.Array, H: jax.Array, R: jax.Array, seen: jax.Array | None = None) -> "Correction[Gaussian]":
        """Condition on an innovation that was formed outside (an angle wrapped, say); otherwise as `given`.

        Args:
            innovation: `(y, *n)`.
            H: `(y, x, *n)`.
            R: `(y, y, *n)`.
            seen: which components were measured, `(y,)` or `(y, n)`; None for all.
        """
        if seen is not None:
            innovation, H, R = zeroed(innovation, seen), zeroed(H, seen, 2), among(R, seen)
        P = self.covariance
        cross = linalg.product(H, P)
        exact = noiseless(R)
        S = linalg.symmetric(linalg.add(linalg.product_transposed(cross, H), R))
        factor = linalg.cholesky(S, _pivots(S, exact, _terms(H, P)))
        # the barriers keep compilers from working factor and gain out again for every entry that uses them
        factor = jax.lax.optimization_barrier(factor)
        size = linalg.times_vector(jnp.abs(H), jnp.abs(self.center))
        log_evidence, max_log_evidence = log_density(innovation, factor, seen, size, exact, carried(P.dtype))
        gain = jax.lax.optimization_barrier(linalg.transpose(linalg.solve(*same_batch(factor, cross))))
        usable = jnp.where(jnp.isfinite(innovation), innovation, 0)
        center = linalg.add_vectors(linalg.times_vector(gain, usable), self.center)
        kept = linalg.add(linalg.identity_like(P), -linalg.product(gain, H))
        terms = linalg.add(linalg.identity_like(P), linalg.product(jnp.abs(gain), jnp.abs(H)))  # those that `kept` is the sum of
        known = jnp.any(exact, axis=0)
        joseph = linalg.add(_without_rounding(linalg.sandwich(kept, P), known, _terms(terms, P)),
                            _without_rounding(linalg.sandwich(gain, R), known, _terms(gain, R)))
        return Correction(_kept_where(jnp.isnan(log_evidence), self, Gaussian(center, joseph)), log_evidence, max_log_evidence)

    def corrected_in_turn(
        self,
        innovation: jax.Array,
        slopes: Sequence[tuple[Sequence[int], jax.Array]],
        R: jax.Array,
        seen: jax.Array | None = None,
        certain: Sequence[int] = (),
    ) -> "Correction[Gaussian]":
        """Condition as `corrected` does, but one component after the other by rank-one updates: cheaper where each law has its own P.

        The triangular factor of R makes the components independent first. P - c c' / s is no Joseph form; instead the variance along a
        measured direction never falls below the rounding of what it was.

        Args:
            innovation: `(y, *n)`.
            slopes: the columns of H in parts: indices of k states, and `(y, k, *n)`. They are not joined, since compilers would then pick
                them apart again for every entry of P.
            R: `(y, y, *n)`.
            seen: which components were measured, `(y,)` or `(y, n)`; None for all.
            certain: states that are known to have no variance: what they are does not change, and P is worked out without them.
        """
        if seen is not None:
            innovation, R = zeroed(innovation, seen), among(R, seen)
        spread = [state for state in range(self.center.shape[0]) if state not in certain]
        law = self.marginal(spread) if certain else self
        factor, noise = linalg.unit_factor(R)
        innovation = linalg.solve_lower(*same_batch(factor, innovation, 1))
        parts = [linalg.solve_lower(*same_batch(factor, part)) for _, part in slopes]
        places = [(state, part, j) for (states, _), part in zip(slopes, parts, strict=True) for j, state in enumerate(states)]
        center, P = law.center, law.covariance
        max_log_evidence, distance, off = (jnp.zeros((), P.dtype),) * 3
        for i in range(innovation.shape[0]):
            row = [(spread.index(state), part[i, j]) for state, part, j in places if state not in certain]
            zero = jnp.zeros_like(self.center[0])
            cross = linalg.total([P[:, state] * slope for state, slope in row], jnp.zeros_like(center))
            before = jnp.maximum(linalg.total([slope * cross[state] for state, slope in row], zero), 0)
            variance = before + noise[i]
            residual = innovation[i] - linalg.total([slope * (center - law.center)[state] for state, slope in row], zero)
            # components that were not seen are left out here: masked rows of H would be masked again for every entry of P
            used = True if seen is None else seen[i]
            inverse = jnp.where(used, linalg.inverse(variance), 0)
            lower = jnp.where(used, linalg.inverse(jnp.maximum(variance, (1 + ROUNDING * jnp.finfo(P.dtype).eps) * before)), 0)
            center = center + cross * (inverse * jnp.where(jnp.isfinite(residual), residual, 0))
            P = linalg.rank_update(P, cross, -lower)
            half = 0.5 * (jnp.log(jnp.where(variance > 0, variance, 1)) + LOG_2PI)
            max_log_evidence = max_log_evidence - jnp.where(used & (variance > 0), half, 0)
            distance = distance + inverse * residual**2
            size = linalg.total([jnp.abs(part[i, j] * self.center[state]) for state, part, j in places], zero) + jnp.abs(innovation[i])
            off = jnp.maximum(off, jnp.where(used & ~(variance > 0), jnp.abs(residual) - carried(P.dtype) * size, 0))
        evidence = jnp.where(off > 0, -jnp.inf, max_log_evidence - 0.5 * distance)
        after = _kept_where(jnp.isnan(evidence), law, Gaussian(center, P))
        return Correction(self.with_marginal(spread, after) if certain else after, evidence, max_log_evidence)

    def marginal(self, states: Sequence[int]) -> "Gaussian":
        """Return the law of some states, at increasing indices known now."""
        rows = linalg.take(self.covariance, states)
        return Gaussian(linalg.take(self.center, states), linalg.take(rows, states, axis=1))

    def with_marginal(self, states: Sequence[int], law: "Gaussian") -> "Gaussian":
        """Return the law in which some states have another one, and the rest keep their means and have no variance."""
        size, batch = self.center.shape[0], law.covariance.shape[2:]
        rows = linalg.put(jnp.zeros((len(states), size, *batch), law.covariance.dtype), law.covariance, states, axis=1)
        cov = linalg.put(jnp.zeros((size, size, *batch), law.covariance.dtype), rows, states)
        return Gaussian(linalg.put(self.center, law.center, states), cov)

    def pinned(self, states: Sequence[int], noise: jax.Array) -> "Gaussian":
        """Draw some of the states of each law and condition it on the draw; the drawn states are left with no variance at all.

        Args:
            states: indices of the s states.
            noise: standard normal numbers `(s, *n)`.
        """
        factor = linalg.cholesky(linalg.take(linalg.take(self.covariance, states), states, axis=1))
        along = linalg.transpose(linalg.solve_lower(factor, linalg.take(self.covariance, states)))
        rest = linalg.add(self.covariance, -linalg.symmetric(linalg.product_transposed(along, along)))
        free = ~np.isin(np.arange(self.center.shape[0]), states)
        both = (free[:, None] & free)[..., None] if rest.ndim == 3 else free[:, None] & free
        return Gaussian(linalg.add_vectors(self.center, linalg.times_vector(along, noise)), jnp.where(both, rest, 0))

    def reordered(self, order: jax.Array | np.ndarray) -> "Gaussian":
        """Return the law of the states in another order, indices `(k,)`, or of some of them."""
        return Gaussian(self.center[order], self.covariance[order][:, order])

    def with_first(self, after: "Gaussian") -> "Gaussian":
        """Return the law when that of the first states becomes another, and that of the rest given them stays."""
        size, states = after.center.shape[0], np.arange(self.center.shape[0])
        before, rest = self.reordered(states[:size]), self.reordered(states[size:])
        slope = linalg.transpose(linalg.solve(linalg.cholesky(before.covariance), self.covariance[:size, size:]))
        moved = linalg.add_vectors(rest.center, linalg.times_vector(slope, linalg.add_vectors(after.center, -before.center)))
        cov = linalg.add(rest.covariance, linalg.sandwich(slope, linalg.add(after.covariance, -before.covariance)))
        across = linalg.product(slope, after.covariance)
        rows = [jnp.concatenate([after.covariance, linalg.transpose(across)], axis=1), jnp.concatenate([across, cov], axis=1)]
        return Gaussian(jnp.concatenate([after.center, moved]), jnp.concatenate(rows))

    def inflated(self, factor: float) -> "Gaussian":
        """Return the law with its covariance times a factor."""
        return Gaussian(self.center, self.covariance * factor)


class Correction(NamedTuple, Generic[L]):
    """What conditioning a law gives.

    Attributes:
        law: the conditional law.
        log_evidence: log density of the measurement before it was known, `()` or `(n,)`; NaN where the prediction is not a number.
        max_log_evidence: the same for a perfect prediction; half the squared Mahalanobis distance is the difference.
        count: number of components that were used, where whoever chose them says so.
    """

    law: L
    log_evidence: jax.Array
    max_log_evidence: jax.Array
    count: jax.Array | int = 0


def _kept_where(lost: jax.Array, before: Gaussian, after: Gaussian) -> Gaussian:
    """Keep the laws that a measurement tells nothing of, as its prediction is no number: zero weight would not hide NaN moments."""
    cov, old = after.covariance, before.covariance
    if cov.ndim == lost.ndim + 2:
        cov = jnp.where(lost, old if old.ndim == cov.ndim else old[..., None], cov)
    return Gaussian(jnp.where(lost, before.center, after.center), cov)


def _terms(a: jax.Array, cov: jax.Array) -> jax.Array:
    """Size of what the diagonal of A P A' is made of, `(y, *n)`, for A `(y, x, *n)` and P `(x, x, *n)`."""
    return jnp.square(linalg.reach(a, jnp.sqrt(jnp.maximum(linalg.diagonal_of(cov), 0))))


def _without_rounding(cov: jax.Array, exact: jax.Array, terms: jax.Array) -> jax.Array:
    """Take out the variances that are rounding of their terms, where a sensor has no noise: what it says of a state is known for good."""
    known = exact & (linalg.diagonal_of(cov) <= 2 * jnp.finfo(cov.dtype).eps * terms)
    return jnp.where(known[:, None] | known[None], 0, cov)


def _pivots(S: jax.Array, exact: jax.Array, terms: jax.Array) -> jax.Array:
    """Size by which pivots of S = H P H' + R are judged, `(y, *n)`: of terms; where there is noise of S, which is never below R."""
    own = linalg.diagonal_of(S)
    exact = exact[:, None] if own.ndim > exact.ndim else exact
    return jnp.where(exact, terms if terms.ndim == own.ndim else terms[:, None], own)
