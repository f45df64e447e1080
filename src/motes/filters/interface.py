"""The contract of a filter: a frozen record of its own parameters that maps a law to a law. The model is an argument, never a field."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, markdown, random
from motes.core.record import described, record, replace, static, values
from motes.filters import alarm
from motes.filters.info import Info
from motes.laws.law import LawT
from motes.laws.observed import is_nothing
from motes.models.interface import circular
from motes.models.state_space import as_state_space
from motes.resampling import gradients
from motes.tracing.compiling import traced_once

FEW = 32
"""States up to which products of matrices are not worth sharing out."""
INFLATION = 4.0
"""Factor on the covariance when a filter answers a collapse by inflating."""


class Guide(NamedTuple):
    """What a reader who looks for a filter wants to know of it; docs/how-to-choose.md is made of these.

    Attributes:
        needs: what it asks of the model.
        cost: of a step, in the number of states x and of particles n.
        use: when to use it.
    """

    needs: str
    cost: str
    use: str


@record
class Filter(ABC, Generic[LawT]):
    """A filter of a kind of law. Subclasses are records; methods are pure and work under jit, vmap and grad.

    Attributes:
        on_collapse: what to do when all weights vanish. "raise": `run` raises outside jit and leaves a flag in the info inside.
            "predict": go on as if nothing had been measured. "inflate": the same, with the law's covariance times 4.
    """

    on_collapse: str = static(default="raise", kw_only=True)
    look_ahead: ClassVar[bool] = False
    """Whether the filter moves only when it knows the next measurement."""
    has_evidence: ClassVar[bool] = True
    """Whether the filter knows the density of what was measured; where not, histories and streams refuse to tell it."""
    weighs: ClassVar[bool] = True
    """Whether the filter weighs particles or hypotheses; the others, Kalman filters, go by the innovation alone."""
    subtracts: ClassVar[bool] = False
    """Whether covariances are corrected by differences, so that priors far wider than the noise cost digits."""
    starves: ClassVar[bool] = False
    """Whether the effective sample size counts n draws, few of which are not enough."""
    adds_inputs: ClassVar[bool] = False
    """Whether functions of the model get more inputs than the user gives, which are then a dictionary or None."""
    light: ClassVar[bool] = False
    """Whether the law is of few numbers where the model has few states: threads then cost more than they bring."""
    descends: ClassVar[bool] = True
    """Whether each particle came from the one that it names as its ancestor; not so where nodes stay or members are moved by all others."""
    resamples_first: ClassVar[bool] = False
    """Whether `predict` (or `ahead`) begins by resampling with `scheme` where `policy` says so, and nothing else is done with weights than
    to multiply them: a law whose weights add up to something else than one then makes an evidence as many times as large."""
    gate: ClassVar[Any] = None
    """Probability with which a measurement lies inside the gate where the filter's claims are right; None for no gate. A field of some."""
    guide: ClassVar[Guide]
    """What it needs, costs and is good for."""

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: a parameter has a value it cannot have; the message names it.
        """
        checks.option(f"{type(self).__name__} on_collapse", self.on_collapse, ("raise", "predict", "inflate"))
        if isinstance(self.gate, Mapping):
            object.__setattr__(self, "gate", tuple(self.gate.items()))
        gates = dict(self.gate) if isinstance(self.gate, tuple) else {} if self.gate is None else {"": self.gate}
        for name, gate in gates.items():
            if not (isinstance(name, str) and isinstance(gate, float) and 0 < gate < 1):
                expected = "a probability between 0 and 1, such as 0.9999, a dictionary of such by sensor, or None"
                checks.refuse(f"{type(self).__name__} gate", expected, repr(gate if name == "" else {name: gate}))
        self.check_parameters()

    def _repr_markdown_(self) -> str:
        guide = self.guide
        rows = [*((name, described(value)) for name, value in values(self).items()), ("needs", guide.needs), ("cost of a step", guide.cost),
                ("use", guide.use)]  # fmt: skip
        return markdown.table((type(self).__name__, ""), rows)

    def with_gate(self, gate: float | None) -> "Filter":
        """Return the same filter with another gate."""
        return replace(self, gate=gate)

    @property
    def particle_count(self) -> int | None:
        """Number of particles n that the filter is given; None of one that has none."""
        return values(self).get("n")

    @property
    def fixed_count(self) -> int | None:
        """Number of particles of every law; None of a filter that has none, or chooses it from step to step."""
        return self.particle_count

    def with_particles(self, n: int) -> "Filter":
        """Return the same filter with n particles; with the least number above, where it cannot have every number.

        Raises:
            MotesError: n is no positive whole number, or the filter has no particles.
        """
        checks.positive_integer(f"{type(self).__name__} n", n)
        if self.particle_count is None:
            checks.refuse("with_particles filter", "one with a number of particles n", type(self).__name__)
        return replace(self, n=n)

    @property
    def loses_derivatives(self) -> bool:
        """Whether the filter picks particles in a way that derivatives do not see (see `resampling/gradients.py`)."""
        policy = getattr(self, "policy", None)
        return policy is not None and gradients.loses(getattr(self, "scheme", None), policy)

    @property
    def traits(self) -> dict[str, Any]:
        """What a history says of its filter."""
        particles = getattr(self, "n", 0) if self.starves else 0
        descends = self.descends and getattr(getattr(self, "scheme", None), "picks", True)
        own = {"has_evidence": self.has_evidence, "weighs": self.weighs, "subtracts": self.subtracts}
        return own | {"particles": particles, "descends": descends}

    def is_light(self, model: Any) -> bool:
        """Tell whether a step with a model is of few numbers."""
        return self.light and model.size <= FEW

    def remembering(self, lag: int) -> "Filter":
        """Return a filter whose law remembers so many modes of the steps before.

        Raises:
            MotesError: no law of this filter does.
        """
        checks.refuse("keep.modes lag", "a filter that remembers modes: JumpMarkovFilter", type(self).__name__)

    def check_parameters(self) -> None:  # noqa: B027 (most filters have nothing of their own to check)
        """Refuse values of the filter's own parameters."""

    def prepare(self, model: Any, u: Any) -> Any:
        """Check that the model has what this filter needs and bring it into the filter's form: once for each compiled program.

        Args:
            model: the user's model, its noises independent.
            u: inputs of one step as the model's functions take them, for tracing; the user's are `models.correlated.users(u)`.

        Raises:
            MotesError: something is missing; the message says what, where, and what to use instead.
        """
        return as_state_space(type(self).__name__, model)

    def seen_inputs(self, u: Any) -> Any:
        """Return the inputs of a step as the model's functions get them, of the user's; for tracing."""
        return u

    def ask(self, model: Any, u: Any) -> None:  # noqa: B027 (most filters take any numbers)
        """Refuse what the numbers of the user's model do not allow, as far as they are known; asked before anything is compiled."""

    @abstractmethod
    def init(self, key: jax.Array, model: Any) -> LawT:
        """Return the law before the first measurement."""

    @abstractmethod
    def update(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Take in the measurement y `(y,)` of the present time."""

    @abstractmethod
    def step(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""

    def accept(self, before: Any, after: Any, info: Info, y: jax.Array) -> tuple[Any, Info]:
        """Accept an update by the rules that all filters share: nothing measured changes nothing, the gate, the policy for a collapse."""
        missing = is_nothing(y)
        if self.gate is not None:
            outside = (info.freedom > 0) & ~alarm.within(self.gate, info.nis, info.freedom) & ~missing
            info = replace(info, gated=outside.astype(jnp.int32), collapsed=info.collapsed & ~outside)
        fallback = before
        if self.on_collapse == "inflate":
            inflated = before.inflated(INFLATION)
            fallback = jax.tree.map(lambda kept, wide: jnp.where(missing, kept, wide), before, inflated)
        unused = missing | (info.gated > 0)
        refused = unused | info.collapsed
        state = jax.tree.map(lambda old, new: jnp.where(refused, old, new), fallback, after)
        silent = {name: jnp.where(unused, 0, getattr(info, name)) for name in ("log_evidence", "invalid", "lowest", "highest", "shortfall")}
        silent |= {name: jnp.where(missing, 0, getattr(info, name)) for name in ("nis", "freedom")}
        if before.weighted:
            silent["ess"] = jax.lax.cond(refused, before.effective_size, lambda: info.ess)
        return state, replace(info, collapsed=info.collapsed & ~missing, **silent)


@record
class TwoStageFilter(Filter[LawT]):
    """A filter that predicts first and then corrects; most are. Subclasses write `init`, `predict` and `correct`."""

    @abstractmethod
    def predict(self, key: jax.Array, model: Any, state: Any, u: Any, t: Any) -> Any:
        """Return the law at the next time t, before its measurement."""

    @abstractmethod
    def correct(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Return the law given y, some but not all of which may be NaN; `update` sees to the rest."""

    def update(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Take in the measurement y `(y,)` of the present time; NaN means not measured."""
        # a run has it in two places: step 0, and the loop over all others
        after, info = traced_once(type(self).correct)(self, key, model, state, y, u, t)
        return self.accept(state, after, info, y)

    def step(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""
        predicted = self.predict(random.child(key, random.PREDICT), model, state, u, t)
        predicted = predicted.gathered(circular(model))
        # the barrier keeps the two stages apart, so that a stream that does them one by one computes the same bits
        predicted = jax.lax.optimization_barrier(predicted)
        return self.update(random.child(key, random.UPDATE), model, predicted, y, u, t)
