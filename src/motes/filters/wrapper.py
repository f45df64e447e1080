"""Filters around another: what they do not say themselves is the inner one's. They can be put around each other.

1. The inner filter takes its step, or its update.
2. The wrapper looks at what came of it, and changes the law, or what it carries beside it.
"""

from abc import abstractmethod
from typing import Any

import jax

from motes.core import checks, random
from motes.core.record import record, replace
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.laws.carried import Carried
from motes.laws.cloud import Cloud


class Around:
    """What a filter around another does not say itself is the inner one's; it is put before the class of the filter.

    `on_collapse` is that of the inner filter, unless it is given here.
    """

    filter: Filter
    on_collapse: str

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the inner filter is none, or a parameter has a value it cannot have.
        """
        checks.instance(f"{type(self).__name__} filter", self.filter, Filter, "a filter such as ParticleFilter(n=1000)")
        super().__post_init__()  # type: ignore[misc]
        if self.on_collapse == "raise":
            object.__setattr__(self, "on_collapse", self.filter.on_collapse)

    @property
    def inner(self) -> Filter:
        """The inner filter, which answers a collapse as this one is asked to."""
        return replace(self.filter, on_collapse=self.on_collapse)

    @property
    def gate(self) -> Any:  # type: ignore[override]
        """That of the inner filter."""
        return self.filter.gate

    def with_gate(self, gate: float | None) -> Any:
        """Return the same around the inner filter with another gate."""
        return replace(self, filter=self.filter.with_gate(gate))

    @property
    def particle_count(self) -> int | None:
        """That of the inner filter."""
        return self.filter.particle_count

    @property
    def fixed_count(self) -> int | None:
        """That of the inner filter."""
        return self.filter.fixed_count

    def with_particles(self, n: int) -> Any:
        """Return the same around the inner filter with n particles."""
        return replace(self, filter=self.filter.with_particles(n))

    @property
    def adds_inputs(self) -> bool:  # type: ignore[override]
        """Whether the inner filter does."""
        return self.filter.adds_inputs

    @property
    def look_ahead(self) -> bool:  # type: ignore[override]
        """That of the inner filter."""
        return self.filter.look_ahead

    @property
    def has_evidence(self) -> bool:  # type: ignore[override]
        """That of the inner filter."""
        return self.filter.has_evidence

    @property
    def weighs(self) -> bool:  # type: ignore[override]
        """That of the inner filter."""
        return self.filter.weighs

    @property
    def loses_derivatives(self) -> bool:
        """Whether the inner filter does."""
        return self.filter.loses_derivatives

    @property
    def traits(self) -> dict[str, Any]:
        """What a history says of the inner filter."""
        return self.filter.traits

    def seen_inputs(self, u: Any) -> Any:
        """Return the inputs of a step as the model's functions get them, under all wrappers."""
        return self.filter.seen_inputs(u)

    def prepare(self, model: Any, u: Any) -> Any:
        """Ask of the model what the inner filter asks."""
        return self.filter.prepare(model, u)

    def ask(self, model: Any, u: Any) -> None:
        """Refuse what the inner filter refuses."""
        self.filter.ask(model, u)


@record
class Wrapper(Around, Filter[Carried]):
    """A filter around another, whose law carries something beside it. Subclasses write `begun` and `after`, and perhaps `inputs_with`.

    Attributes:
        filter: the inner filter.
    """

    filter: Filter

    @abstractmethod
    def begun(self, key: jax.Array, model: Any, law: Any) -> Any:
        """Return what is carried beside the first law."""

    @abstractmethod
    def after(self, key: jax.Array, before: Carried, law: Any, info: Info, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Return what is handed on after the inner filter took in a measurement.

        Args:
            key: of the step.
            before: what was handed to the inner filter.
            law: what it made of it.
            info: its record of the step.
            y: the measurement.
            u: inputs of the step.
            t: its number.
        """

    def inputs_with(self, u: Any, beside: Any) -> Any:
        """Return the inputs that the model's functions see, knowing what is carried: the user's own, unless said otherwise."""
        return u

    def init(self, key: jax.Array, model: Any) -> Carried:
        """Begin as the inner filter does."""
        law = self.inner.init(key, model)
        return Carried(law, self.begun(key, model, law))

    def predict(self, key: jax.Array, model: Any, state: Carried, u: Any, t: Any) -> Carried:
        """Predict as the inner filter does."""
        u = self.inputs_with(u, state.beside)
        return replace(state, law=self.inner.predict(key, model, state.law, u, t))  # type: ignore[attr-defined]

    def update(self, key: jax.Array, model: Any, state: Carried, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Take in the measurement of the present time."""
        taken = self.inner.update(key, model, state.law, y, self.inputs_with(u, state.beside), t)
        return self._looked_at(key, state, taken, y, u, t)

    def step(self, key: jax.Array, model: Any, state: Carried, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Go to the next time t and take in its measurement."""
        taken = self.inner.step(key, model, state.law, y, self.inputs_with(u, state.beside), t)
        return self._looked_at(random.child(key, random.UPDATE), state, taken, y, u, t)

    def _looked_at(self, key: jax.Array, before: Carried, taken: tuple[Any, Info], y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        # numbers of its own, and the same bits whether the inner filter took its step in one or in two
        law, info = jax.lax.optimization_barrier(taken)
        return self.after(random.child(key, random.FILTER), before, law, info, y, u, t)


def cloud_of(asked_by: str, law: Any) -> Cloud:
    """Return the particles of a law, whatever is carried beside them.

    Raises:
        MotesError: it has none.
    """
    if isinstance(law, Carried):
        return cloud_of(asked_by, law.law)
    return checks.instance(f"{asked_by} filter", law, Cloud, "one whose law is a Cloud, such as ParticleFilter")


def with_cloud(law: Any, cloud: Cloud) -> Any:
    """Return a law with other particles, and all that is carried beside them as it was."""
    return replace(law, law=with_cloud(law.law, cloud)) if isinstance(law, Carried) else cloud
