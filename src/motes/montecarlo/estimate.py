"""What an average over random points tells, and how far it is to be trusted."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, logspace
from motes.core.findings import Diagnosis, Finding
from motes.core.record import record
from motes.diagnostics.weights import TRUSTED, pareto_k
from motes.laws.law import Law

FEW = 50.0
"""Effective points below which a standard error is itself a guess."""


@record
class Estimate:
    """An estimate by Monte Carlo.

    Attributes:
        value: of each component of the function, `(m,)`, or `()` where the function gives one number.
        error: standard errors, of the same shape.
        n: points drawn.
        ess: effective number of points under their weights; n without weights.
        pareto_k: how heavy the tail of the weights is (`mo.diagnostics.pareto_k`); NaN without weights or with few points.
        log_evidence: log of the integral of the unnormalized density, `()`; NaN where it was not asked for.
        log_evidence_error: its standard error.
        invalid: points whose weight was NaN; they got none.
    """

    value: jax.Array
    error: jax.Array
    n: jax.Array | int
    ess: jax.Array
    pareto_k: jax.Array
    log_evidence: jax.Array
    log_evidence_error: jax.Array
    invalid: jax.Array | int = 0

    def diagnose(self) -> Diagnosis:
        """Say in words whether to trust the estimate."""
        return Diagnosis.of(_findings(self))

    @property
    def trusted(self) -> bool:
        """Whether nothing serious was found."""
        return self.diagnose().trusted

    def __str__(self) -> str:
        """Print values with their errors, and the verdict."""
        pairs = zip(np.ravel(np.asarray(self.value)), np.ravel(np.asarray(self.error)), strict=True)
        values = ", ".join(f"{value:.6g} +- {error:.2g}" for value, error in pairs)
        evidence = f"; log evidence {float(self.log_evidence):.6g} +- {float(self.log_evidence_error):.2g}"
        also = evidence if np.isfinite(self.log_evidence) else ""
        return f"{values} ({int(self.n)} points, {float(self.ess):.0f} effective{also})\n{self.diagnose()}"


def _findings(estimate: Estimate) -> list[Finding]:
    found = []
    if not np.isfinite(np.asarray(estimate.value)).all():
        advice = "Look for points where function or density is not one."
        found.append(Finding("not finite", "the estimate is not a finite number.", advice, True))
    if float(estimate.pareto_k) > TRUSTED:
        text = f"weights have too heavy a tail for the error to be believed (Pareto k {float(estimate.pareto_k):.2f}, above {TRUSTED})."
        found.append(Finding("heavy weights", text, "Use a proposal with heavier tails than the density, or adapt it.", True))
    if int(estimate.invalid):
        text = f"log_density over the proposal's was NaN at {int(estimate.invalid)} of {int(estimate.n)} points; they got no weight."
        found.append(Finding("invalid", text, "Look for logarithms and roots of negative numbers; give impossible points -inf.", True))
    if not float(estimate.ess) >= FEW:
        text = f"only {float(np.nan_to_num(estimate.ess)):.1f} of {int(estimate.n)} points count."
        found.append(Finding("few points", text, "Draw more, or use a proposal nearer to the density.", True))
    return found


def warned(estimate: Estimate, asked_by: str) -> Estimate:
    """Return the estimate, with a warning if it cannot be trusted (outside jit only)."""
    if checks.is_concrete(estimate.value):
        for finding in estimate.diagnose().findings:
            if finding.serious:
                checks.warn(f"{asked_by}: {finding.name}: {finding.text} {finding.advice}")
    return estimate


def values_at(function: Any, points: jax.Array) -> jax.Array:
    """Return a user function f(x) at points `(x, n)`, as `(m, n)`, or `(n,)` where it gives one number.

    Raises:
        MotesError: it is no function, or gives something else than a number or a vector.
    """
    if not callable(function):
        checks.refuse("function", "a function of one point (x,)", type(function).__name__)
    found = jax.vmap(lambda x: jnp.asarray(function(x)), in_axes=-1, out_axes=-1)(points)
    if found.ndim > 2:
        checks.refuse("function", "one that gives a number or a vector", f"shape {found.shape[:-1]}")
    return found.astype(jnp.result_type(found, points.dtype))


def densities_at(log_density: Any, points: jax.Array) -> jax.Array:
    """Return a log density at points `(x, n)`: of a law, or of a user function of one point.

    Raises:
        MotesError: it is neither, or gives no single number.
    """
    if isinstance(log_density, Law):
        return log_density.log_prob(points)
    if not callable(log_density):
        checks.refuse("log_density", "a law or a function of one point (x,)", type(log_density).__name__)
    found = jax.vmap(lambda x: jnp.asarray(log_density(x)), in_axes=-1, out_axes=-1)(points)
    checks.shape("log_density", found, (points.shape[-1],), "(one number for each point)")
    return found


def mixture_log_prob(laws: Sequence[Any], proportions: jax.Array, points: jax.Array) -> jax.Array:
    """Log density of a mixture of laws at points `(x, n)`, in proportion to proportions."""
    each = jnp.stack([law.log_prob(points) for law in laws])
    return jax.nn.logsumexp(each + jnp.log(proportions / jnp.sum(proportions))[:, None], axis=0)


def averaged(log_weights: jax.Array, values: jax.Array, normalized: bool) -> Estimate:
    """Average values `(m, n)` or `(n,)` under log weights `(n,)` (importance sampling).

    Args:
        log_weights: log of density over proposal; NaN counts as no weight.
        values: of the function.
        normalized: whether the density is, so that weights need not be divided by their sum.
    """
    n = log_weights.shape[0]
    invalid = jnp.isnan(log_weights)
    log_weights = jnp.where(invalid, -jnp.inf, log_weights)
    normal, total = logspace.normalize(log_weights)
    weights = jnp.exp(normal)
    # a point without weight tells nothing, whatever the function is there
    seen = jnp.where(weights > 0, values, 0)
    if normalized:
        weighed = seen * jnp.exp(log_weights)
        value, error = jnp.mean(weighed, axis=-1), jnp.std(weighed, axis=-1, ddof=1) / n**0.5
        log_evidence = log_evidence_error = jnp.full((), jnp.nan, log_weights.dtype)
    else:
        value = jnp.sum(seen * weights, axis=-1)
        # by the delta method; Geweke 1989
        error = jnp.sqrt(jnp.sum((weights * jnp.where(weights > 0, values - value[..., None], 0)) ** 2, axis=-1))
        log_evidence, log_evidence_error = total - jnp.log(jnp.asarray(n, total.dtype)), jnp.std(n * weights, ddof=1) / n**0.5
    size, tail = logspace.effective_size(normal), pareto_k(log_weights)
    return Estimate(value, error, n, size, tail, log_evidence, log_evidence_error, jnp.sum(invalid))
