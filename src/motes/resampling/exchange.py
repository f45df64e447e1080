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
from motes.core.record import record, replace, static, values
from motes.laws.elements import Form, Sums, masses, normalized_within
from motes.resampling.allotment import Children, allotted, as_wide, delivered, ends_of, strip_width
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
    def sent(self, n: int, elements: int, devices: int, particle: int) -> int:
        """Return the bytes that a device sends in a step, beside a few numbers of each element.

        Args:
            n: number of particles, of all elements.
            elements: number of elements.
            devices: number of devices.
            particle: bytes of a particle, without its weight and its ancestor.
        """

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


class OwnNumber(Exchange):
    """An exchange by which each element keeps its number of particles, resamples itself, and has a mass.

    Of each element a share of the particles goes, evenly spaced since neighbors are often children of one parent; none where it has no
    `share`, which is in (0, 0.5].
    """

    share: float = 0.0

    def __post_init__(self) -> None:
        """Refuse shares outside (0, 0.5]."""
        if "share" in values(self):
            checks.above_zero(f"{type(self).__name__} share", self.share, 0.5)

    @property
    def stride(self) -> int:
        """How far apart the particles are that go; 0 for none."""
        return round(1 / self.share) if self.share else 0

    def columns(self, size: int) -> int:
        """Number of particles that go, of an element of so many."""
        return -(-size // self.stride) if self.stride else 0

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """Return for each element here the columns `(..., e, c)` that it gets."""
        return columns

    def sent(self, n: int, elements: int, devices: int, particle: int) -> int:
        """The share of the last element: particles, weights, ancestors and where they came from."""
        return 0 if devices == 1 else self.columns(n // elements) * (particle + 12)

    def handed(self, crew: Crew, key: jax.Array, policy: Policy | None, form: Form, law: Any, t: Any) -> Handed:
        """See `Exchange`."""
        cut = form.cut(law, crew.here)
        size = cut.log_weights.shape[-1]
        first = (crew.first + jnp.arange(crew.here, dtype=jnp.int32)) * size
        origin = first[:, None] + jnp.arange(size, dtype=jnp.int32)
        if self.stride:
            lanes, rest = form.arrays(cut)
            goes = jnp.arange(size) % self.stride == 0
            columns = self.received(crew, [lane[..., :: self.stride] for lane in (*lanes, origin)], t)
            *lanes, origin = (jnp.where(goes, self._spread(new, size), lane) for new, lane in zip(columns, (*lanes, origin), strict=True))
            cut = form.law(lanes, rest)
        log_mass = masses(cut.log_weights).log
        return Handed(replace(cut, log_weights=normalized_within(cut.log_weights, log_mass)), None, log_mass, origin)

    def _spread(self, columns: jax.Array, size: int) -> jax.Array:
        """Return an array `(..., size)` that has columns at the places that go."""
        shape = columns.shape
        return jnp.broadcast_to(columns[..., None], (*shape, self.stride)).reshape(*shape[:-1], shape[-1] * self.stride)[..., :size]


@record
class Apart(OwnNumber):
    """No exchange: each element is a particle filter of its own, and its mass is its evidence.

    Masses drift apart like the evidences of independent runs: soon few elements have any, and the work of the others is lost. It is here
    for comparison; docs/scale.md has figures.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Apart())
    """

    def sent(self, n: int, elements: int, devices: int, particle: int) -> int:
        """Nothing."""
        return 0


@record
class Ring(OwnNumber):
    """Each element keeps its number of particles and its mass, and gives a share of them to the next one in a ring (RNA).

    Masses even out with the particles that go round. Less is sent than by automatic sharding, always the same amount, to one neighbor.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters; Miguez, Vazquez 2016, A
    proof of uniform convergence over time for a distributed particle filter.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Ring(0.1))

    Attributes:
        share: of the particles of an element that go, one in a whole number, in (0, 0.5].
    """

    share: float = static(default=0.1)

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """See `OwnNumber`."""
        before = crew.from_device([column[..., -1:, :] for column in columns], 1)
        return [jnp.concatenate([one, column[..., :-1, :]], axis=-2) for one, column in zip(before, columns, strict=True)]


@record
class Butterfly(OwnNumber):
    """Each element exchanges a share of its particles with a partner, whose distance doubles from step to step: 1, 2, 4 and so on.

    After log2 K steps every element has heard of all others, where a ring takes K; messages go further.

    Source: Heine, Whiteley, Cemgil 2020, Parallelizing particle filters with butterfly interactions.

    Example:
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Butterfly(0.25))

    Attributes:
        share: of the particles of an element that go, one in a whole number, in (0, 0.5].
    """

    share: float = static(default=0.25)

    def check(self, elements: int) -> None:
        """Refuse numbers of elements that are no powers of two."""
        if elements & (elements - 1):
            checks.refuse("Distributed elements", "a power of two, for a Butterfly", elements)

    def sent(self, n: int, elements: int, devices: int, particle: int) -> int:
        """The share of all elements at a step across devices, of which there are log2(devices) in log2 K; the mean of all steps."""
        whole = elements // devices * self.columns(n // elements) * (particle + 12)
        return round(whole * (devices.bit_length() - 1) / max(elements.bit_length() - 1, 1))

    def received(self, crew: Crew, columns: list[jax.Array], t: Any) -> list[jax.Array]:
        """See `OwnNumber`."""

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

    def sent(self, n: int, elements: int, devices: int, particle: int) -> int:
        """Two strips of children, with their ancestors."""
        return 0 if devices == 1 else 2 * strip_width(n, devices) * (particle + 4)

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
