"""Augmented recovery (Thrun, Burgard, Fox 2005, section 8.3.3): a lost filter gets particles drawn anew, as many as it has been wrong.

1. The inner filter takes its step; its evidence p(y | measurements before) goes into a slow and a fast running mean.
2. Where the fast mean falls below the slow one, a share max(0, 1 - margin fast / slow) of the particles is drawn anew; resample first.

A filter that never was right has no slow mean to fall below. Where `usual` says what evidence a filter on its track would have, evidence
counts by its ratio to that, and both means begin at 1.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, replace, static
from motes.core.user_functions import called
from motes.filters.info import Info
from motes.filters.interface import Guide
from motes.filters.wrapper import Wrapper, cloud_of, with_cloud
from motes.laws.carried import Carried
from motes.laws.cloud import Cloud
from motes.laws.observed import is_nothing, value_of
from motes.resampling.schemes import Systematic


@record
class Recovering(Wrapper):
    """A filter that finds its way back: after a kidnapping, a long silence or a wrong start; its state is a `Carried` cloud.

    `info.recovered` is the share of the particles that were drawn anew. Where measurements differ in size from step to step their evidence
    is comparable by `usual` alone.

    Source: Thrun, Burgard, Fox 2005, Probabilistic Robotics.

    Example:
        >>> model = mo.textbook.constant_velocity()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> near = lambda key, y, u, t: jnp.concatenate([y, jnp.zeros(2)]) + jax.random.normal(key, (4,))
        >>> mo.run(1, mo.Recovering(mo.ParticleFilter(n=1000), near), model, ys).info.recovered.shape
        (50,)

    Attributes:
        filter: whose law is a `Cloud`, such as `ParticleFilter`.
        fresh: `(key, y, u, t)` draws one state `(x,)` where the system may be, knowing the measurement of the step; NaN for a
            state that the particle keeps, such as a sensor's bias.
        slow: share of the present evidence in the slow mean.
        fast: share of it in the fast mean.
        margin: how much lower the fast mean must be before anything is drawn; 1 is the form of the book, which draws at all times.
        usual: `(y, u, t)` gives the log evidence that a measurement has on the average where the filter is right; None for the slow mean
            alone, which takes the evidence of the beginning for right.
    """

    guide = Guide(
        needs="what the inner filter needs, and a way to draw states that fit a measurement",
        cost="that of the inner filter, and n draws while it is lost",
        use="the target may jump, or the start is unknown",
    )

    fresh: Callable[..., Any] = static()
    slow: float = static(default=0.002)
    fast: float = static(default=0.1)
    margin: float = static(default=3.0)
    usual: Callable[..., Any] | None = static(default=None)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: fresh or usual is no function, a share does not lie between 0 and 1, slow is not below fast, or margin is below 1.
        """
        if not callable(self.fresh):
            checks.refuse("Recovering fresh", "a function (key, y, u, t) that draws a state", type(self.fresh).__name__)
        if self.usual is not None and not callable(self.usual):
            checks.refuse("Recovering usual", "a function (y, u, t) that gives a log evidence, or None", type(self.usual).__name__)
        for name in ("slow", "fast", "margin"):
            checks.above_zero(f"Recovering {name}", getattr(self, name))
        if not 0 < self.slow < self.fast <= 1:
            checks.refuse("Recovering slow, fast", "0 < slow < fast <= 1", f"{self.slow} and {self.fast}")
        if not self.margin >= 1:
            checks.refuse("Recovering margin", "a number of at least 1", self.margin)

    @property
    def traits(self) -> dict[str, Any]:
        """What a history says: particles drawn anew come from no others."""
        return self.filter.traits | {"descends": False}

    def begun(self, key: jax.Array, model: Any, law: Any) -> Any:
        """Begin with no evidence, or with what is usual: logs of the slow and of the fast mean."""
        first = jnp.full((), -jnp.inf if self.usual is None else 0, cloud_of("Recovering", law).log_weights.dtype)
        return first, first

    def after(self, key: jax.Array, before: Carried, law: Any, info: Info, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Draw particles anew where the evidence has fallen."""
        missing = is_nothing(y)
        evidence = jax.lax.stop_gradient(jnp.where(info.collapsed | jnp.isnan(info.log_evidence), -jnp.inf, info.log_evidence))
        if self.usual is not None:
            evidence -= _expected(self.usual, value_of(y), u, t).astype(evidence.dtype)
        slow, fast = (jnp.where(missing, mean, _running_mean(mean, evidence, share))
                      for mean, share in zip(before.beside, (self.slow, self.fast), strict=True))  # fmt: skip
        known = jnp.isfinite(slow)
        rate = jnp.where(missing | ~known, 0, jnp.clip(1 - self.margin * jnp.exp(fast - jnp.where(known, slow, 0)), 0, 1))
        cloud = cloud_of("Recovering", law)

        def anew() -> tuple[Cloud, jax.Array]:
            n = cloud.log_weights.shape[0]
            chosen = Systematic().ancestors(random.child(key, random.RESAMPLE), cloud.log_weights, n)
            keys = random.step_keys(random.child(key, random.NOISE), n)
            drawn = jax.vmap(lambda key: self._drawn(key, value_of(y), u, t, cloud.particles), out_axes=-1)(keys)
            new = random.uniform(random.child(key, random.UPDATE), (n,), cloud.log_weights.dtype) < rate
            kept = replace(cloud.resampled(chosen), ancestors=cloud.ancestors[chosen])
            return replace(kept, particles=jnp.where(new & ~jnp.isnan(drawn), drawn, kept.particles)), jnp.mean(new, dtype=rate.dtype)

        cloud, share = jax.lax.cond(rate > 0, anew, lambda: (cloud, jnp.zeros_like(rate)))
        size = jnp.where(share > 0, logspace.effective_size(cloud.log_weights), info.ess)
        return Carried(with_cloud(law, cloud), (slow, fast)), replace(info, recovered=share, ess=size)

    def _drawn(self, key: jax.Array, y: Any, u: Any, t: Any, particles: jax.Array) -> jax.Array:
        """Draw a state of the user's function."""
        drawn = called("Recovering fresh(key, y, u, t)", self.fresh, key, y, u, t)
        if jnp.shape(drawn) != particles.shape[:1]:
            checks.refuse("Recovering fresh", f"a state {particles.shape[:1]}", f"shape {jnp.shape(drawn)}")
        return jnp.asarray(drawn).astype(particles.dtype)


def _expected(usual: Callable[..., Any], y: Any, u: Any, t: Any) -> jax.Array:
    """Return the log evidence that the user's function expects of a measurement."""
    told = jnp.asarray(called("Recovering usual(y, u, t)", usual, y, u, t))
    if told.shape:
        checks.refuse("Recovering usual", "one number", f"shape {told.shape}")
    return told


def _running_mean(log_mean: jax.Array, log_value: jax.Array, share: float) -> jax.Array:
    """Log of a running mean with one more value in it; the first value is the mean."""
    mixed = jnp.logaddexp(jnp.log1p(-share) + log_mean, jnp.log(jnp.asarray(share, log_mean.dtype)) + log_value)
    return jnp.where(jnp.isfinite(log_mean), mixed, log_value)
