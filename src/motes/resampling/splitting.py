"""How the kernels of a Gaussian mixture are kept small: each becomes a smaller one whose center is drawn, its mean and covariance kept.

A kernel N(x, P) is replaced by N(x + U, P - C) with U ~ N(0, C): on average nothing changes, but what follows may linearize over less.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, replace
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture

Splitting = Callable[[jax.Array, Mixture], Mixture]


class Kernels(ABC):
    """Says how small kernels are made."""

    @abstractmethod
    def fitted(self, law: Mixture, states: Sequence[int]) -> Splitting:
        """Return what splits each kernel on its own, from a key and a mixture.

        Args:
            law: the mixture before selection; covariances `(x, x, n)`.
            states: indices of the states in which kernels are to be small.
        """


@record
class SplitKernels(Kernels):
    """Split each kernel in the nonlinear states only, and only along the directions in which it is too wide.

    Other states move by their correlation with the nonlinear ones, and narrow directions are left alone. (Dahia et al. 2004 have
    another rule, `CommonKernel`.)

    Attributes:
        cap: largest standard deviation of a kernel along any direction, as a share of that of the whole mixture; in (0, 1].
        longest: largest standard deviation along any direction, in the unit that the nonlinear states must then share; over a map,
            about one cell. None for no such cap.
    """

    cap: float = 0.5
    longest: float | None = None

    def __post_init__(self) -> None:
        """Refuse caps that are not positive, or a share above one."""
        checks.above_zero("SplitKernels cap", self.cap, 1.0)
        if self.longest is not None:
            checks.above_zero("SplitKernels longest", self.longest)

    def fitted(self, law: Mixture, states: Sequence[int]) -> Splitting:
        """Work out what all kernels share; see `Kernels`."""
        if not states:
            return lambda key, law: law
        whole = linalg.take(linalg.take(law.cov(), states), states, axis=1)
        factor, limit = linalg.cholesky(whole), jnp.square(jnp.asarray(self.cap, whole.dtype))
        if self.longest is not None:
            limit = jnp.minimum(limit, self.longest**2 / jnp.maximum(jnp.max(linalg.eigen(whole)[0]), jnp.finfo(whole.dtype).tiny))

        def split(key: jax.Array, law: Mixture) -> Mixture:
            center, P = law.parts.center, law.parts.covariance
            rows = linalg.solve_lower(factor, linalg.take(P, states))
            values, directions = linalg.eigen(linalg.solve_lower(factor, linalg.transpose(linalg.take(rows, states, axis=1))))
            wide = values > limit
            removed = jnp.where(wide, (1 - limit / jnp.where(wide, values, 1)) / jnp.where(wide, values, 1), 0)
            noise = random.normal(key, (len(states), center.shape[-1]), center.dtype)
            for k in range(len(states)):
                column = linalg.times_vector(linalg.transpose(rows), directions[:, k])
                center = center + jnp.sqrt(removed[k]) * noise[k] * column
                P = linalg.rank_update(P, column, -removed[k])
            return replace(law, parts=Gaussian(center, P))

        return split


@record
class CommonKernel(Kernels):
    """The rule of Dahia et al. (2004): one kernel h^2 Pi for all, Pi being the covariance of the whole mixture, in all states.

    h is at most h*, the largest h that leaves every P - h^2 Pi a covariance. One kernel that is narrow in one direction thus makes all
    narrow in all directions, and few points are left in many dimensions: on real relief the rule without its guard loses nearly every run.
    It is here for comparison, and for states that are all alike.

    Attributes:
        cap: largest h, in (0, 1].
        guard: where h* is smaller, kernels are left as they are; in (0, 1]. The paper has none; a small number comes close to it.
    """

    cap: float = 0.9
    guard: float = 0.5

    def __post_init__(self) -> None:
        """Refuse numbers outside (0, 1]."""
        checks.above_zero("CommonKernel cap", self.cap, 1.0)
        checks.above_zero("CommonKernel guard", self.guard, 1.0)

    def fitted(self, law: Mixture, states: Sequence[int]) -> Splitting:
        """Work out Pi and h; see `Kernels`. The states are not asked for: the rule is for all."""
        whole = law.cov()
        factor = linalg.cholesky(whole)
        values = linalg.solve_lower(factor, linalg.transpose(linalg.solve_lower(factor, law.parts.covariance)))
        least = jnp.min(linalg.eigen(linalg.symmetric(values))[0])
        cap, guard = (jnp.square(jnp.asarray(parameter, whole.dtype)) for parameter in (self.cap, self.guard))
        common = jnp.clip(least, 0, cap) * whole
        small = least >= guard

        def split(key: jax.Array, law: Mixture) -> Mixture:
            before = law.parts
            rest = Gaussian(before.center, linalg.symmetric(before.covariance - common[..., None]))
            center = jnp.where(small, rest.sample(key, before.center.shape[-1]), before.center)
            return replace(law, parts=Gaussian(center, jnp.where(small, common[..., None], before.covariance)))

        return split
