"""The contract of a filter: a frozen record of its own knobs that maps a law to a law. The model is an argument, never a field."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.alarm import Surprise
from motes.filters.needs import as_state_space
from motes.gaussian.modes import expected, measured
from motes.gaussian.rule import Rule
from motes.laws.cloud import Cloud
from motes.laws.conditional import Conditional
from motes.laws.gaussian import Correction
from motes.laws.mode_mixture import ModeMixture
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import circular
from motes.native import cloudwise
from motes.resampling import gradients
from motes.resampling.policy import Policy, resample
from motes.resampling.schemes import Scheme, Weighted

C = TypeVar("C", bound=Weighted)

HOPELESS = 1e4
"""A measurement this many nats below a perfect fit (141 standard deviations) for the best particle counts as a collapse."""

INFLATION = 4.0
"""Factor on the covariance when a filter answers a collapse by inflating."""


@record
class Info:
    """What a reader wants to know of one step; the next step does not need it.

    Attributes:
        log_evidence: log density of the measurement given those before it; 0 when nothing was measured.
        ess: effective sample size after the measurement; infinite for laws without sampling error.
        collapsed: whether all weights vanished, so that the measurement was not used.
        invalid: number of particles whose likelihood was not a number; they get no weight.
        lowest: smallest log likelihood over the particles.
        highest: largest log likelihood over the particles.
        gap: nats by which the best particle falls short of a perfect fit; half the squared normalized innovation of filters whose law has
            no weights; 0 where the largest possible likelihood is not known.
        surprise: squared distance of the measurement from what was predicted of it; chi-square where the filter's claims are right.
        freedom: degrees of freedom of `surprise`; 0 where nothing was measured, or where no prediction is known.
        alarm: whether measurements have by now scattered so much more than predicted that the filter's claims are wrong (`alarm.py`).
        gated: 1 where the filter's `gate` left the measurement out, else 0.
        lost: share of the probability that left the filter's grid on the way to this step; 0 of filters without a grid.
    """

    log_evidence: jax.Array
    ess: jax.Array
    collapsed: jax.Array
    invalid: jax.Array
    lowest: jax.Array
    highest: jax.Array
    gap: jax.Array
    surprise: jax.Array
    freedom: jax.Array
    alarm: jax.Array
    gated: jax.Array
    lost: jax.Array


def weigh(log_weights: jax.Array, log_likelihood: jax.Array, ceiling: jax.Array) -> tuple[jax.Array, Info]:
    """Multiply weights by likelihoods, and judge whether that is still meaningful.

    Weights have collapsed when they sum to nothing or to infinity, when the best particle is `HOPELESS` nats below its ceiling, or when the
    log likelihoods are so large that rounding hides their differences. NaN likelihoods count as zero and are reported.

    Args:
        log_weights: normalized, `(n,)`.
        log_likelihood: `(n,)`.
        ceiling: largest value the log likelihood can take, `()` or `(n,)`; infinite when not known.

    Returns:
        Normalized log weights `(n,)` (not usable where collapsed) and the record of the step.
    """
    weights, found = logspace.joint_weights(log_weights, log_likelihood, ceiling)
    return weights, judged(found)


def judged(found: jax.Array) -> Info:
    """Return the record of a step from the six numbers of `logspace.joint_weights`."""
    log_evidence, ess, invalid, lowest, highest, gap = found
    unresolved = jnp.abs(highest) * jnp.finfo(found.dtype).eps > 1
    collapsed = ~jnp.isfinite(log_evidence) | (gap > HOPELESS) | unresolved
    none, quiet = jnp.zeros_like(ess), jnp.zeros((), bool)
    return Info(log_evidence, ess, collapsed, invalid.astype(jnp.int32), lowest, highest, gap, none, none, quiet, jnp.int32(0), none)


def single(done: Correction) -> Info:
    """Return the record of a step of a filter whose law has no weights."""
    evidence = done.log_evidence
    _, info = weigh(jnp.zeros((1,), evidence.dtype), evidence[None], done.peak)
    square, freedom = 2 * (done.peak - evidence), jnp.asarray(done.count, evidence.dtype)
    return replace(info, ess=jnp.full_like(evidence, jnp.inf), surprise=square, freedom=freedom)


def surprised(info: Info, found: Surprise) -> Info:
    """Add to the record of a step how far its measurement lies from the prediction."""
    return replace(info, surprise=found.square, freedom=found.freedom)


def evolve(keys: tuple[jax.Array, jax.Array], scheme: Scheme, policy: Policy, cloud: C, move: Callable[[jax.Array, C], C]) -> C:
    """Resample a cloud where the policy says so, then move it.

    Args:
        keys: for resampling, and for the noise.
        scheme: how ancestors are drawn.
        policy: when to resample.
        cloud: law of n weighted particles.
        move: from the key of the noise and the cloud to the moved cloud, each particle on its own.
    """
    moved = cloudwise.evolve(keys, scheme, policy, cloud, move)
    if moved is None:
        return move(keys[1], resample(keys[0], scheme, policy, cloud))
    return gradients.noticed(moved) if gradients.loses(scheme, policy) else moved


def reweigh(cloud: C, judge: Callable[[C], tuple[C, jax.Array, jax.Array]]) -> tuple[C, Info]:
    """Correct a cloud and weigh its particles by a measurement.

    Args:
        cloud: law of n weighted particles.
        judge: gives the corrected cloud, the log likelihood of each particle `(n,)` and its ceiling (see `weigh`), each on its own.
    """
    native = cloudwise.reweigh(cloud, judge)
    if native is not None:
        return native[0], judged(native[1])
    after, likelihood, ceiling = judge(cloud)
    weights, info = weigh(cloud.log_weights, likelihood, ceiling)
    return replace(after, log_weights=weights), info


def by_likelihood(key: jax.Array, sensor: Conditional, cloud: Cloud, y: jax.Array, u: Any, t: Any) -> tuple[Cloud, Info]:
    """Weigh particles that stay where they are by the likelihood of y alone; the key serves the alarm."""

    def judge(cloud: Cloud) -> tuple[Cloud, jax.Array, jax.Array]:
        return cloud, sensor.log_prob(y, cloud.particles, u, t), sensor.ceiling(y, cloud.particles, u, t)

    after, info = reweigh(cloud, judge)
    some = alarm.some_of(cloud.log_weights.shape[0])
    return after, surprised(info, alarm.of_cloud(key, sensor, cloud.particles[:, some], cloud.log_weights[some], y, u, t))


def weigh_modes(rule: Rule, model: JumpMarkovModel, state: ModeMixture, y: jax.Array, u: Any, t: Any) -> tuple[ModeMixture, Info]:
    """Correct the Gaussian of each component by the sensor of its mode, and weigh it by its predictive density of y."""
    done = measured(rule, model, state, y, u, t)
    weights, info = weigh(state.log_weights, done.log_evidence, done.peak)
    few, log_weights = alarm.few_of(state.log_weights.reshape(model.count, -1))
    told = expected(rule, model, state, few, u, t)
    found = alarm.of_mixture(model.models[0].sensor.angles, told.center, told.covariance, log_weights.reshape(-1), y, drawn=False)
    return replace(state, parts=done.law, log_weights=weights), surprised(info, found)


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
class Filter(ABC):
    """A filter. Subclasses are records; methods are pure and work under jit, vmap and grad.

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
    descends: ClassVar[bool] = True
    """Whether each particle came from the one that it names as its ancestor; not so where nodes stay or members are moved by all others."""
    gate: ClassVar[float | None] = None
    """Probability with which a measurement lies inside the gate where the filter's claims are right; None for no gate. A field of some."""
    guide: ClassVar[Guide]
    """What it needs, costs and is good for."""

    def __post_init__(self) -> None:
        """Check the knobs.

        Raises:
            MotesError: a knob has a value it cannot have; the message names it.
        """
        checks.option(f"{type(self).__name__} on_collapse", self.on_collapse, ("raise", "predict", "inflate"))
        if self.gate is not None and not (isinstance(self.gate, float) and 0 < self.gate < 1):
            checks.refuse(f"{type(self).__name__} gate", "a probability between 0 and 1, such as 0.9999, or None", repr(self.gate))
        self.check_knobs()

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
        told = {"has_evidence": self.has_evidence, "weighs": self.weighs, "subtracts": self.subtracts}
        return told | {"particles": particles, "descends": descends}

    def check_knobs(self) -> None:  # noqa: B027 (most filters have nothing of their own to check)
        """Refuse values of the filter's own knobs."""

    def prepare(self, model: Any, u: Any) -> Any:
        """Check that the model has what this filter needs and bring it into the filter's form; doing so twice changes nothing.

        Args:
            model: the user's model.
            u: inputs of one step, for tracing.

        Raises:
            MotesError: something is missing; the message says what, where, and what to use instead.
        """
        return as_state_space(type(self).__name__, model)

    def ask(self, model: Any, u: Any) -> None:  # noqa: B027 (most filters take any numbers)
        """Refuse what the numbers of the user's model do not allow, as far as they are known; asked before anything is compiled."""

    @abstractmethod
    def init(self, key: jax.Array, model: Any) -> Any:
        """Return the law before the first measurement."""

    @abstractmethod
    def update(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Take in the measurement y `(y,)` of the present time."""

    @abstractmethod
    def step(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""

    def settle(self, before: Any, after: Any, info: Info, y: jax.Array) -> tuple[Any, Info]:
        """Apply the two rules that every filter shares: nothing measured changes nothing, and a collapse is answered by the policy."""
        missing = jnp.all(jnp.isnan(y))
        if self.gate is not None:
            outside = (info.freedom > 0) & ~alarm.within(self.gate, info.surprise, info.freedom) & ~missing
            info = replace(info, gated=outside.astype(jnp.int32), collapsed=info.collapsed & ~outside)
        fallback = before
        if self.on_collapse == "inflate":
            inflated = before.inflated(INFLATION)
            fallback = jax.tree.map(lambda kept, wide: jnp.where(missing, kept, wide), before, inflated)
        unused = missing | (info.gated > 0)
        refused = unused | info.collapsed
        state = jax.tree.map(lambda old, new: jnp.where(refused, old, new), fallback, after)
        silent = {name: jnp.where(unused, 0, getattr(info, name)) for name in ("log_evidence", "invalid", "lowest", "highest", "gap")}
        silent |= {name: jnp.where(missing, 0, getattr(info, name)) for name in ("surprise", "freedom")}
        if hasattr(before, "log_weights"):
            silent["ess"] = jax.lax.cond(refused, lambda: logspace.effective_size(before.log_weights), lambda: info.ess)
        return state, replace(info, collapsed=info.collapsed & ~missing, **silent)


@record
class TwoStageFilter(Filter):
    """A filter that predicts first and then corrects; most are. Subclasses write `init`, `predict` and `correct`."""

    @abstractmethod
    def predict(self, key: jax.Array, model: Any, state: Any, u: Any, t: Any) -> Any:
        """Return the law at the next time t, before its measurement."""

    @abstractmethod
    def correct(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Return the law given y, some but not all of which may be NaN; `update` sees to the rest."""

    def update(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Take in the measurement y `(y,)` of the present time; NaN means not measured."""
        after, info = self.correct(key, model, state, y, u, t)
        return self.settle(state, after, info, y)

    def step(self, key: jax.Array, model: Any, state: Any, y: jax.Array, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""
        predicted = self.predict(random.child(key, random.PREDICT), model, state, u, t)
        predicted = predicted.gathered(circular(model))
        # the barrier keeps the two stages apart, so that a stream that does them one by one computes the same bits
        predicted = jax.lax.optimization_barrier(predicted)
        return self.update(random.child(key, random.UPDATE), model, predicted, y, u, t)
