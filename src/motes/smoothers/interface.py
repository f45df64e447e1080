"""The contract of a smoother: a frozen record of its own knobs that turns a filtered history into laws given all measurements."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import jax

from motes.core import checks
from motes.core.record import record, static
from motes.filters.history import History
from motes.filters.needs import ask_density
from motes.laws.law import Law
from motes.models.state_space import StateSpaceModel


@record
class Smoothed:
    """What a smoother gives.

    Attributes:
        mean: means given all measurements, `(t, x)`.
        cov: covariances given all measurements, `(t, x, x)`.
        paths: m whole trajectories drawn given all measurements, `(t, x, m)`; None where the smoother draws none.
        log_weights: of the paths, normalized, `(m,)`; None where there are none.
        names: names of the states.
        label: the smoother, as it prints.
    """

    mean: jax.Array
    cov: jax.Array
    paths: jax.Array | None = None
    log_weights: jax.Array | None = None
    names: tuple[str, ...] = static(default=())
    label: str = static(default="")


class Steps(NamedTuple):
    """What dynamics and sensor are told at each step.

    Attributes:
        u: inputs, with the time axis first.
        t: index of the step, `(t,)`.
        y: measurements, `(t, y)`; None where they were not given.
    """

    u: Any
    t: jax.Array
    y: jax.Array | None


@record
class Smoother(ABC):
    """A smoother. Subclasses are records; `smooth` is pure and works under jit and vmap.

    Attributes:
        lost: where it gives means that are no numbers because it found nothing: what it looked for, and what to do instead.
    """

    lost: ClassVar[tuple[str, str] | None] = None

    def __post_init__(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: a knob has a value it cannot have; the message names it.
        """
        self.check_knobs()

    def check_knobs(self) -> None:  # noqa: B027 (some smoothers have nothing to check)
        """Refuse values of the smoother's own knobs."""

    @abstractmethod
    def prepare(self, model: Any, history: History, u: Any) -> Any:
        """Check that model and history have what this smoother needs, and bring the model into its form.

        Args:
            model: the user's model, its noises independent.
            history: filtered.
            u: inputs of one step, for tracing.

        Raises:
            MotesError: something is missing; the message says what, and what to use instead.
        """

    @abstractmethod
    def smooth(self, key: jax.Array, model: Any, history: History, steps: Steps) -> Smoothed:
        """Smooth; `model` is what `prepare` gave."""


def ask_laws(asked_by: str, history: History, kind: type[Law], hint: str) -> None:
    """Refuse a history whose laws are of another kind or were not kept.

    Args:
        asked_by: the smoother, for the message.
        history: the history.
        kind: the kind of law that the smoother works with.
        hint: what to use for other laws.
    """
    if not isinstance(history.state, kind):
        checks.refuse(f"{asked_by} history", f"laws of the kind {kind.__name__}", type(history.state).__name__, hint)
    _ = history.law


def ask_backward_density(asked_by: str, model: StateSpaceModel) -> None:
    """Refuse dynamics without a density."""
    ask_density(f"{asked_by} dynamics", model.dynamics, " (paths are drawn backward by it)", "GenealogySmoother needs none.")
