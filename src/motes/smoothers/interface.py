"""The contract of a smoother: a frozen record of its own parameters that turns a filtered history into laws given all measurements."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, markdown
from motes.core.record import record, static, values
from motes.filters import frames
from motes.filters.history import History
from motes.filters.needs import ask_density
from motes.io.labels import Labels
from motes.laws.cloud import Cloud, weighted_moments
from motes.laws.factored import FactoredGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law
from motes.laws.marginal_cloud import MarginalCloud
from motes.laws.mixture import Mixture
from motes.models.state_space import StateSpaceModel

if TYPE_CHECKING:
    from pandas import DataFrame


@record
class Smoothed:
    """What a smoother gives.

    Attributes:
        mean: means given all measurements, `(t, x)`.
        cov: covariances given all measurements, `(t, x, x)`.
        paths: m whole trajectories drawn given all measurements, `(t, x, m)`; None where the smoother draws none.
        log_weights: of the paths, normalized, `(m,)`; None where there are none.
        mode_probabilities: of the modes of a jump-Markov system given all measurements, `(t, modes)`; None of another model.
        modes: modes along the paths, `(t, m)` int32, where they are not the last state of the paths; None otherwise.
        names: names of the states.
        label: the smoother, as it prints.
        labels: times of the steps and names of columns, as those of the history; None where it has none.
        start: index of the first step.
        times: of the steps, seconds, as those of the history; None where it has none.
    """

    mean: jax.Array
    cov: jax.Array
    paths: jax.Array | None = None
    log_weights: jax.Array | None = None
    mode_probabilities: jax.Array | None = None
    modes: jax.Array | None = None
    names: tuple[str, ...] = static(default=())
    label: str = static(default="")
    labels: Labels | None = static(default=None)
    start: jax.Array | int = 0
    times: Any = None

    def to_pandas(self) -> "DataFrame":
        """Return a `pandas.DataFrame` with a row for each step, indexed as the history is (extra `results`).

        Columns: mean and standard deviation of each state (`px`, `px_sd`), and probabilities of modes where there are modes.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        columns = frames.mean_and_sd(self.names, self.mean, self.cov) | frames.of_modes(self.mode_probabilities)
        return frames.as_frame(columns, self.labels, frames.first_step(self), frames.seconds_of(self))

    def __str__(self) -> str:
        """Print what was smoothed, one line each."""
        return "\n".join(f"{what:<16}{text}" for what, text in self._facts()) or repr(self)

    def _repr_markdown_(self) -> str:
        return markdown.table(("", "smoothed"), self._facts()) if self._facts() else repr(self)

    def _facts(self) -> list[tuple[str, str]]:
        if self.mean.ndim != 2 or not checks.is_concrete(self.mean):
            return []
        first = frames.first_step(self)
        facts = [("smoother", self.label), ("steps", f"{first} to {first + self.mean.shape[0] - 1}"),
                 ("at the start", frames.in_short(self.names, self.mean[0], self.cov[0]))]  # fmt: skip
        return facts if self.paths is None else [*facts, ("paths", f"{self.paths.shape[-1]} drawn")]


_SMOOTHED: dict[tuple[type[Law], ...], str] = {
    (Gaussian, FactoredGaussian): "RauchTungStriebelSmoother",
    (Cloud,): "BackwardSimulationSmoother",
    (MarginalCloud,): "RaoBlackwellizedSmoother",
    (Mixture,): "MixtureSmoother",
}
"""Which smoother takes laws of a kind: the one place that says so, so that no hint leads from one refusal to the next."""


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
        subtracts: whether it takes covariances apart by differences, so that priors far wider than the noise cost digits.
    """

    subtracts: ClassVar[bool] = False
    lost: ClassVar[tuple[str, str] | None] = None

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a parameter has a value it cannot have; the message names it.
        """
        self.check_parameters()

    def check_parameters(self) -> None:
        """Refuse values of the smoother's own parameters; n, of smoothers that draw, is the number of what they draw.

        Raises:
            MotesError: n is not a positive whole number.
        """
        if "n" in values(self):
            checks.positive_integer(f"{type(self).__name__} n", values(self)["n"])

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


def ask_laws(asked_by: str, history: History, *kinds: type[Law]) -> None:
    """Refuse a history whose laws are of other kinds, naming what smooths them, or were not kept.

    Args:
        asked_by: the smoother, for the message.
        history: the history.
        kinds: the kinds of law that the smoother works with.
    """
    ask_kind(asked_by, history, *kinds)
    _ = history.law


def ask_kind(asked_by: str, history: History, *kinds: type[Law]) -> None:
    """Refuse a history whose laws are of other kinds; see `ask_laws`."""
    law = history.state
    if not isinstance(law, kinds):
        fitting = next((name for those, name in _SMOOTHED.items() if isinstance(law, those)), None)
        hint = f"Use {fitting}." if fitting else f"A {type(law).__name__} cannot be smoothed: run another filter, such as ParticleFilter."
        checks.refuse(f"{asked_by} history", f"laws of the kind {kinds[0].__name__}", type(law).__name__, hint)


def summed_up(log_weights: jax.Array, X: jax.Array, modes: int) -> tuple[jax.Array, jax.Array, jax.Array | None]:
    """Mean `(x,)` and covariance `(x, x)` of points `(x, n)`, and the probabilities of modes that are the last state, if there are any."""
    cloud = Cloud(X, log_weights, jnp.arange(X.shape[-1], dtype=jnp.int32))
    return *weighted_moments(log_weights, X), cloud.mode_probabilities(modes)


def ask_backward_density(asked_by: str, model: StateSpaceModel, descends: bool = True) -> None:
    """Refuse dynamics without a density; where particles do not descend from one another nothing else helps."""
    hint = "GenealogySmoother needs none." if descends else "Without it only clouds of filters that pick particles can be smoothed."
    ask_density(f"{asked_by} dynamics", model.dynamics, " (paths are drawn backward by it)", hint)
