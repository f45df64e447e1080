"""When to resample: a value apart from how (schemes.py)."""

from abc import ABC, abstractmethod

import jax
import jax.numpy as jnp

from motes.core import checks, engine, logspace
from motes.core.record import record
from motes.laws.elements import Sums
from motes.resampling import gradients
from motes.resampling.schemes import Scheme, W


class Policy(ABC):
    """Decides from the weights whether to resample."""

    @abstractmethod
    def needed(self, log_weights: jax.Array) -> jax.Array | bool:
        """Tell whether to resample, from normalized log weights `(n,)`."""

    def needed_by(self, sums: Sums, n: int) -> jax.Array | bool | None:
        """Tell the same from sums over n particles; None of a policy that asks for more."""
        return None


@record
class Always(Policy):
    """Resample at every step (SIR, the bootstrap filter of Gordon, Salmond, Smith 1993)."""

    def needed(self, log_weights: jax.Array) -> bool:
        """Yes."""
        return True

    def needed_by(self, sums: Sums, n: int) -> bool:
        """Yes."""
        return True


@record
class Never(Policy):
    """Never resample (sequential importance sampling); weights degenerate in time."""

    def needed(self, log_weights: jax.Array) -> bool:
        """No."""
        return False

    def needed_by(self, sums: Sums, n: int) -> bool:
        """No."""
        return False


@record
class ESS(Policy):
    """Resample when the effective sample size falls below a share of n (the generic filter of Arulampalam, Maskell, Gordon, Clapp 2002).

    Attributes:
        share: between 0 and 1.
    """

    share: float = 0.5

    def __post_init__(self) -> None:
        """Refuse shares outside (0, 1]."""
        checks.above_zero("ESS share", self.share, 1.0)

    def needed(self, log_weights: jax.Array) -> jax.Array:
        """Compare the effective sample size with the share."""
        return logspace.effective_size(log_weights) < self.share * log_weights.shape[0]

    def needed_by(self, sums: Sums, n: int) -> jax.Array:
        """Compare the effective sample size with the share."""
        return sums.weights**2 < self.share * n * sums.squares


@record
class Entropy(Policy):
    """Resample when log n minus the entropy of the weights exceeds a threshold (Dahia, Musso, Pham, Guibert 2004, criterion Ent).

    Attributes:
        threshold: in nats; 0.25 leaves 78 percent of the particles effective, 0.7 half of them.
    """

    threshold: float = 0.7

    def __post_init__(self) -> None:
        """Refuse thresholds that are not positive."""
        checks.above_zero("Entropy threshold", self.threshold)

    def needed(self, log_weights: jax.Array) -> jax.Array:
        """Compare the entropy deficit with the threshold."""
        return logspace.entropy_deficit(log_weights) > self.threshold

    def needed_by(self, sums: Sums, n: int) -> jax.Array:
        """Compare the entropy deficit with the threshold."""
        return jnp.log(jnp.asarray(n, sums.terms.dtype)) + sums.terms / sums.weights - jnp.log(sums.weights) > self.threshold


def resample(key: jax.Array, scheme: Scheme, policy: Policy, cloud: W, log_score: jax.Array | None = None) -> W:
    """Return the cloud resampled where the policy says so; the law it stands for is unchanged on average.

    Args:
        key: JAX key.
        scheme: how.
        policy: when, judged by the weights that particles are resampled by.
        cloud: law of n weighted particles.
        log_score: log of factors on the weights that particles are resampled by, `(n,)`, for a filter that looks ahead. Particles that were
            resampled then keep the inverse of their factor as weight: weights add up to one on average, not each time.
    """
    after = resampled(key, scheme, policy, cloud, log_score)
    return gradients.noticed(after) if gradients.loses(scheme, policy) else after


@engine.replaceable
def resampled(key: jax.Array, scheme: Scheme, policy: Policy, cloud: W, log_score: jax.Array | None) -> W:
    """Do what `resample` does."""
    first = None if log_score is None else logspace.normalize(cloud.log_weights + log_score)[0]

    def chosen() -> W:
        return scheme.resampled(key, cloud, first)

    needed = policy.needed(cloud.log_weights if first is None else first)
    if isinstance(needed, bool):
        return chosen() if needed else cloud.not_resampled()  # type: ignore[return-value]
    return jax.lax.cond(jnp.asarray(needed), chosen, cloud.not_resampled)
