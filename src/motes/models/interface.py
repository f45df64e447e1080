"""The contract of a model: what simulation, filters, smoothers and studies ask of it, whatever its kind.

A new kind of model is one file: a record that derives from `Model`, says how it is checked and what it is as a state-space model.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, Self, TypeVar

import jax.numpy as jnp

from motes.core import checks, markdown
from motes.core.record import described, replace, values
from motes.core.types import Inputs
from motes.laws.conditional import Conditional
from motes.laws.switching import in_each_mode
from motes.models.correlated import Drive

R = TypeVar("R")
LONGEST = 300
"""Letters of a part of a model that a notebook shows at most."""


class Wrap(NamedTuple):
    """What takes the place of user functions, so that equal ones compare equal; see `rebuilt`.

    Attributes:
        function: of a function, or anything else, which comes back as it is; a tuple of the shapes of its arguments; its name in messages.
        conditional: of its name, a conditional, and the shapes of a state, of the inputs and of a value (None where that is not known).
    """

    function: Callable[[Any, tuple[Any, ...], str], Any]
    conditional: Callable[[str, Conditional, Any, Any, Any], Conditional]


class Model(ABC):
    """A model of a system over time and of what is measured of it. Subclasses are records.

    Attributes:
        names: names of the states.
        input_names: names of the inputs of a step where these are an array and have some: of tables their columns are taken, in this order.
        circular: indices of the states that are angles in radians.
        linear: indices of the states that are declared to be conditionally linear-Gaussian; None where nobody did.
        modes: number of modes, the index of which is the last state, of a joined jump-Markov model; 0 of any other.
        correlated: whether the process noise of a step depends on the measurement noise before it.
    """

    names: tuple[str, ...]
    input_names: tuple[str, ...] = ()
    circular: tuple[int, ...]
    linear: tuple[int, ...] | None = None
    modes: int = 0
    correlated: bool = False

    def _repr_markdown_(self) -> str:
        rows = [("states", ", ".join(self.names)), *((name, described(value)) for name, value in values(self).items() if name != "names")]
        short = [(name, text if len(text) <= LONGEST else f"{text[:LONGEST]}...") for name, text in rows]
        return markdown.table((type(self).__name__, ""), short)

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.names)

    @property
    @abstractmethod
    def dtype(self) -> jnp.dtype:
        """Floating type of the states."""

    def index(self, state: str | int) -> int:
        """Return the index of a state given by name or index.

        Raises:
            MotesError: there is no such state.
        """
        return index_of(state, self.names)

    @abstractmethod
    def check(self, inputs_of_step: Inputs) -> None:
        """Run all functions on shapes alone and refuse what does not fit.

        Raises:
            MotesError: a function returns the wrong shape; the message names it.
        """

    @abstractmethod
    def measurement_size(self, inputs_of_step: Inputs) -> int | None:
        """Return the number of measured components, or None where only the data can tell (a custom density)."""

    @abstractmethod
    def as_state_space(self) -> Any:
        """Return the same system as a `StateSpaceModel` of the same states; modes, where there are some, are one more state, the last."""

    def each_mode(self) -> tuple[Any, ...]:
        """Return the kinds of state-space model that the modes have: one for each mode, or one where they share it, or there are none."""
        return (self.as_state_space(),)

    def in_each_mode(self, u: Any, ask: Callable[..., Any], given: Any = ()) -> Any:
        """Ask the state-space model of each mode; a system without modes has one. See `laws.switching.in_each_mode`."""
        return in_each_mode(self.each_mode(), 1, u, ask, given)

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> Self:
        """Return the model with its functions exchanged, so that equal models share compiled code; as it is by default.

        Args:
            wrap: what takes the place of functions and conditionals.
            u: shapes of the inputs of one step.
            y: shape of one measurement, or None.
        """
        return self

    def independent(self) -> tuple["Model", Drive]:
        """Return an equivalent model whose noises are independent, and what makes its inputs of the user's (see `Drive`)."""
        return self, Drive()


def exchanged(record: R, wanted: dict[str, Any]) -> R:
    """Return a record with some fields exchanged; itself where none differs."""
    changed = {name: value for name, value in wanted.items() if value is not getattr(record, name)}
    return replace(record, **changed) if changed else record


def circular(model: Any) -> tuple[int, ...]:
    """Return the indices of the states that are angles, of a model in any form that declares them; none of another."""
    return getattr(model, "circular", ())


def index_of(state: str | int, names: tuple[str, ...]) -> int:
    """Return the index of a state given by name or index.

    Raises:
        MotesError: there is no such state.
    """
    if isinstance(state, str) and state in names:
        return names.index(state)
    if not isinstance(state, str) and -len(names) <= state < len(names):
        return int(state) % len(names)
    checks.refuse("state", f"one of the names {', '.join(names)} or an index below {len(names)}", repr(state))
