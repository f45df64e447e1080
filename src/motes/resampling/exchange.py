"""How the elements of a filter exchange particles, so that none is left with all of the weight, or without any.

An element is a part of the particles that resamples on its own; see `filters/distributed.py`. All exchanges move particles with their
weights: the law that they stand for does not change by that.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.devices import Crew
from motes.core.record import record, replace, static
from motes.laws.elements import Form, Sums, masses, within
from motes.resampling.allotment import Children, allotted, as_wide, delivered, ends_of
from motes.resampling.policy import Policy
from motes.resampling.schemes import Given


class Handed(NamedTuple):
    """What the inner filter is handed for the elements here.

    Attributes:
        law: particles to begin with: cut `(..., e, m)`, or not `(..., s)` where `given` picks from them.
        given: children of each element, arrays `(e, m)`; None where the filter resamples itself.
        log_mass: log masses of the elements after that, `(e,)`, where the weights are normalized within each; None where over all.
        origin: the index of each particle among all those of the step before, `(e, m)`.
    """

    law: Any
    given: Given | None
    log_mass: jax.Array | None
    origin: jax.Array


class Exchange(ABC):
    """Says how elements exchange particles."""

    resamples: ClassVar[bool] = False
    """Whether the exchange resamples over all elements itself."""

    def check(self, elements: int) -> None:  # noqa: B027 (most take any number)
        """Refuse numbers of elements that the exchange cannot serve."""

    @abstractmethod
    def handed(self, crew: Crew, key: jax.Array, policy: Policy | None, form: Form, law: Any, t: Any) -> Handed:
        """Return what each element begins a step with.

        Args:
            crew: the elements here.
            key: of the step, for resampling.
            policy: of the inner filter; asked by exchanges that resample.
            form: of the law.
            law: the particles here, not cut, with weights normalized over all.
            t: number of the step.
        """


@record
class Apart(Exchange):
    """No exchange: each element is a particle filter of its own, and its mass is its evidence.

    Masses drift apart like the evidences of independent runs: soon few elements have any, and the rest of the work is lost. It is here
    for comparison, and for `mo.combined`'s sake; docs/scale.md has figures.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Apart())
    """

    def handed(self, crew: Crew, key: jax.Array, policy: Policy | None, form: Form, law: Any, t: Any) -> Handed:
        """See `Exchange`."""
        cut = form.cut(law, crew.here)
        size = cut.log_weights.shape[-1]
        first = (crew.first + jnp.arange(crew.here, dtype=jnp.int32)) * size
        cut, origin = self.swapped(crew, form, cut, first[:, None] + jnp.arange(size, dtype=jnp.int32), t)
        log_mass = masses(cut.log_weights).log
        return Handed(replace(cut, log_weights=within(cut.log_weights, log_mass)), None, log_mass, origin)

    def swapped(self, crew: Crew, form: Form, cut: Any, origin: jax.Array, t: Any) -> tuple[Any, jax.Array]:
        """Return the cut law and the origin of its particles once they have been exchanged."""
        return cut, origin


class _Strided(Apart):
    """An exchange of a share of the columns of each element, evenly spaced: neighbors are often children of one parent."""

    share: float

    def _check_share(self) -> None:
        checks.above_zero(f"{type(self).__name__} share", self.share, 0.5)

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """Return for each element here the columns `(..., e, c)` that it gets."""
        raise NotImplementedError

    def swapped(self, crew: Crew, form: Form, cut: Any, origin: jax.Array, t: Any) -> tuple[Any, jax.Array]:
        """See `Apart`."""
        lanes, rest = form.arrays(cut)
        stride = round(1 / self.share)
        size = origin.shape[-1]
        goes = jnp.arange(size) % stride == 0
        columns = self.received(crew, [lane[..., ::stride] for lane in (*lanes, origin)], t)
        spread = [jnp.broadcast_to(column[..., None], (*column.shape, stride)).reshape(*column.shape[:-1], -1)[..., :size] for column in columns]
        *lanes, origin = (jnp.where(goes, new, lane) for new, lane in zip(spread, (*lanes, origin), strict=True))
        return form.law(lanes, rest), origin


@record
class Ring(_Strided):
    """Each element keeps its number of particles and its mass, and gives a share of them to the next one in a ring (RNA).

    Masses even out with the particles that go round. Less is sent than by automatic sharding, always the same amount, to one neighbor.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters; Miguez, Vazquez 2016, A proof
    of uniform convergence over time for a distributed particle filter.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Ring(0.1))

    Attributes:
        share: of the particles of an element that go, one in a whole number, in (0, 0.5].
    """

    share: float = static(default=0.1)

    def __post_init__(self) -> None:
        """Refuse shares outside (0, 0.5]."""
        self._check_share()

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """See `_Strided`."""
        before = crew.from_device([column[..., -1:, :] for column in columns], 1)
        return [jnp.concatenate([one, column[..., :-1, :]], axis=-2) for one, column in zip(before, columns, strict=True)]


@record
class Butterfly(_Strided):
    """Each element exchanges a share of its particles with a partner, at distances 1, 2, 4, ... from step to step.

    After log2 K steps every element has heard of all others, where a ring takes K; messages go further.

    Source: Heine, Whiteley, Cemgil 2020, Parallelising particle filters with butterfly interactions.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Butterfly(0.25))

    Attributes:
        share: of the particles of an element that go, one in a whole number, in (0, 0.5].
    """

    share: float = static(default=0.25)

    def __post_init__(self) -> None:
        """Refuse shares outside (0, 0.5]."""
        self._check_share()

    def check(self, elements: int) -> None:
        """Refuse numbers of elements that are no powers of two."""
        if elements & (elements - 1):
            checks.refuse("Distributed elements", "a power of two, for a Butterfly", elements)

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """See `_Strided`."""

        def across(distance: int) -> list[jax.Array]:
            if distance >= crew.here:
                return crew.from_partner(columns, distance // crew.here)
            return [column[..., jnp.arange(crew.here) ^ distance, :] for column in columns]

        stages = [1 << k for k in range(crew.elements.bit_length() - 1)]
        if not stages:
            return columns
        return jax.lax.switch(t % len(stages), [lambda distance=distance: across(distance) for distance in stages])


@record
class Proportional(Exchange):
    """All particles are resampled by one comb, and each element has as many children as its mass asks for: proportional allocation (RPA).

    The result is that of a single filter of all particles. Few children leave their element, about 1.7 sqrt(N^2 / ESS) at a border:
    between devices they travel in strips of 16 sqrt(N), or in whole blocks where that is too few.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Proportional())
    """

    resamples = True

    def handed(self, crew: Crew, key: jax.Array, policy: Policy | None, form: Form, law: Any, t: Any) -> Handed:
        """See `Exchange`."""
        lanes, rest = form.particles(law)
        log_weights = law.log_weights.reshape(crew.here, -1)
        n = crew.elements * log_weights.shape[1]
        own = masses(log_weights)
        sums = crew.gathered(own.sums)
        assert policy is not None
        needed = policy.needed_by(Sums(*(jnp.sum(each) for each in sums)), n)
        u = random.uniform(key, (), log_weights.dtype)

        def anew() -> tuple[Children, jax.Array]:
            shares = allotted(sums.weights, u, n)
            ends = ends_of(crew, log_weights, own.log, shares, u)
            return delivered(crew, lanes, ends.reshape(-1), shares.start), jnp.full_like(law.log_weights, -jnp.log(n))

        def as_before() -> tuple[Children, jax.Array]:
            indices = jnp.arange(log_weights.size, dtype=jnp.int32)
            return Children(as_wide(crew, lanes), indices, crew.place * log_weights.size + indices), law.log_weights

        found, weights = (anew() if needed else as_before()) if isinstance(needed, bool) else jax.lax.cond(needed, anew, as_before)
        given = Given(found.indices.reshape(log_weights.shape), weights.reshape(log_weights.shape))
        return Handed(form.of_particles(found.source, rest), given, None, found.ancestors.reshape(log_weights.shape))
