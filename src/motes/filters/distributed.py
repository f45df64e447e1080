"""A filter in K elements: parts of its particles that resample, draw and are summed each on its own, so that devices can share them out.

1. Elements exchange particles, or the comb of the resampling runs over all of them (`resampling/exchange.py`).
2. The inner filter takes each stage on the particles of each element, with numbers of its own and weights normalized within it.
3. A few numbers of each element are gathered: its mass times the evidence within is its share of the evidence, and its next mass.

What is added over elements is added in their order, wherever they are: results depend on K, never on devices.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, engine, random
from motes.core.devices import Crew, shared_out
from motes.core.record import record, replace, static
from motes.filters import alarm
from motes.filters.alarm import Innovation
from motes.filters.info import Info, info_of, with_innovation
from motes.filters.interface import Filter, Guide, TwoStageFilter
from motes.filters.wrapper import Around
from motes.laws.elements import Form, Sums, added, in_elements, log_sum, masses, normalized_within, one_by_one, row
from motes.laws.observed import is_nothing
from motes.native import blocks
from motes.resampling.exchange import Exchange, Proportional
from motes.resampling.policy import Always
from motes.resampling.schemes import Systematic

EXPECTED = "one that moves and weighs a cloud of n particles, such as ParticleFilter or MarginalizedParticleFilter"

TOLD = ("log_evidence", "ess", "invalid", "lowest", "highest", "shortfall", "nis", "freedom")
"""What the record of a step of each element tells the others."""

Stage = Callable[[Any, jax.Array, Any], tuple[Any, Any]]
"""From the inner filter of one element, its key and its law to the law after a stage, and the record of the step or None."""


@record
class Distributed(Around, TwoStageFilter):
    """A particle filter in elements, which `with mo.devices(8):` shares out over devices; its state is a cloud as that of the inner filter.

    Results depend on the number of elements and never on that of the devices.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> filter = mo.Distributed(mo.ParticleFilter(n=1024), elements=4, exchange=mo.Ring(0.1))
        >>> mo.run(1, filter, model, ys).mean.shape
        (50, 1)

    Attributes:
        filter: the inner filter, a `ParticleFilter` or a `MarginalizedParticleFilter`; or another of n particles that predicts and corrects
            a `Cloud` or a `MarginalCloud`.
        elements: K, which divides the number of particles.
        exchange: how elements exchange particles: `Proportional`, `Ring`, `Butterfly` or `Apart`.
    """

    guide = Guide(
        needs="what the inner filter needs",
        cost="that of the inner filter, shared out, and a few numbers of each element between devices",
        use="more particles than one device can hold or move in time",
    )

    filter: Filter
    elements: int = static(default=8)
    exchange: Exchange = Proportional()

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the inner filter has no such particles, their number is not a multiple of elements, or the exchange is none or does
                not fit.
        """
        n = self.filter.particle_count
        if not isinstance(self.filter, TwoStageFilter) or n is None:
            checks.refuse("Distributed filter", EXPECTED, type(self.filter).__name__)
        checks.positive_integer("Distributed elements", self.elements)
        if n % self.elements:
            checks.refuse("Distributed elements", f"a divisor of the filter's n={n}", self.elements)
        checks.instance("Distributed exchange", self.exchange, Exchange, "an exchange such as mo.Proportional()")
        self.exchange.check(self.elements)
        if self.exchange.resamples:
            self._check_resampling()

    def _check_resampling(self) -> None:
        name, filter = type(self.exchange).__name__, self.filter
        instead = "Use mo.Ring(0.1), whose elements resample themselves."
        if not filter.resamples_first:
            given = f"{type(filter).__name__}, which looks at the weights otherwise, too"
            checks.refuse("Distributed filter", f"one that resamples by scheme and policy, for {name}", given, instead)
        scheme, policy = (getattr(filter, field) for field in ("scheme", "policy"))
        if type(scheme) is not Systematic:
            checks.refuse("Distributed filter scheme", f"Systematic, for {name} (one comb for all)", type(scheme).__name__, instead)
        none = jnp.zeros(())
        if policy.needed_by(Sums(none, none, none), self.size) is None:
            checks.refuse("Distributed filter policy", f"ESS, Entropy, Always or Never, for {name}", type(policy).__name__, instead)

    def with_particles(self, n: int) -> "Distributed":
        """Return the same filter with n particles, or as many more as its elements need to have the same number."""
        checks.positive_integer("Distributed n", n)
        return replace(self, filter=self.filter.with_particles(-(-n // self.elements) * self.elements))

    @property
    def size(self) -> int:
        """Number of particles of an element."""
        return (self.filter.particle_count or 0) // self.elements

    def sent(self, model: Any, devices: int) -> int:
        """Return the bytes that each of so many devices sends in a step, beside a few numbers of each element.

        Args:
            model: a state-space or mixed linear model that needs no inputs to be looked at.
            devices: number of devices.
        """
        ready = self.filter.prepare(model.independent()[0], None)
        law = jax.eval_shape(self._each.init, jax.random.key(0), ready)
        lanes, _ = Form(law).particles(law)
        return self.exchange.sent(self.size * self.elements, self.elements, devices, sum(
            int(np.prod(lane.shape[:-1])) * lane.dtype.itemsize for lane in lanes))  # fmt: skip

    @property
    def _each(self) -> Any:
        """The filter of one element."""
        return self.filter.with_particles(self.size)

    def init(self, key: jax.Array, model: Any) -> Any:
        """Begin each element as the inner filter does.

        Raises:
            MotesError: the law of the inner filter is no cloud of particles.
        """
        like = jax.eval_shape(self._each.init, key, model)
        if in_elements(like, self.elements) is None:
            checks.refuse("Distributed filter", EXPECTED, f"{type(self.filter).__name__}, whose law is a {type(like).__name__}")
        form = Form(like)

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            keys = crew.own(random.step_keys(key, self.elements))
            law, _ = form.mapped(lambda key, law: (self._each.init(key, model), None), True, keys, None, False)
            law = jax.lax.optimization_barrier(law)
            equal = jnp.full((crew.here,), -jnp.log(self.elements), law.log_weights.dtype)
            own = (crew.first + jnp.arange(crew.here, dtype=jnp.int32))[:, None] * self.size
            law = replace(law, log_weights=added(law.log_weights, equal), ancestors=law.ancestors + own)
            return form.arrays(form.uncut(law))

        return self._whole(form, shared_out(work, self.elements, [], [], form.ranks))

    def predict(self, key: jax.Array, model: Any, state: Any, u: Any, t: Any) -> Any:
        """Exchange particles, or resample them all, and move them (steps 1 and 2)."""
        return self._begun(key, state, t, lambda each, key, law: (each.predict(key, model, law, u, t), None))[0]

    def correct(self, key: jax.Array, model: Any, state: Any, y: Any, u: Any, t: Any) -> tuple[Any, Info]:
        """Weigh the particles of each element, and the elements (steps 2 and 3)."""
        form = Form(state.plain)

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            law = form.cut(form.law(lanes, rest), crew.here)
            log_mass = None
            if not self.filter.resamples_first:
                log_mass = masses(law.log_weights).log
                law = replace(law, log_weights=jax.lax.optimization_barrier(normalized_within(law.log_weights, log_mass)))
            keys = crew.own(random.step_keys(key, self.elements))
            stage = lambda key, law: self._each.correct(key, model, law, y, u, t)  # noqa: E731
            at_once = self._at_once(law)
            after, info = form.mapped(stage, at_once, keys, law, True)
            if at_once:
                info = self._with_alarm(stage, form, keys, law, info)
            return _finished(crew, form, log_mass, after, info, self._prior(law.log_weights, log_mass))

        return self._taken(form, shared_out(work, self.elements, *form.arrays(state.plain), ranks=form.ranks))

    def _with_alarm(self, stage: Callable[[jax.Array, Any], tuple[Any, Info]], form: Form, keys: jax.Array, law: Any, info: Info) -> Info:
        """Ask a few particles of each element for the alarm, one element after the other: JAX works it out, not kernels."""
        few = form.each(lambda lane: lane[..., alarm.some_of(self.size)], law)

        def innovation(k: jax.Array) -> Innovation:
            with engine.using("jax"):
                seen = stage(keys[k], form.each(lambda lane: row(lane, k), few))[1]
            return Innovation(seen.nis, seen.freedom)

        return with_innovation(info, one_by_one(innovation, keys.shape[0]))

    def step(self, key: jax.Array, model: Any, state: Any, y: Any, u: Any, t: Any) -> tuple[Any, Info]:
        """Go to the next time t and take in its measurement."""
        if not self.look_ahead:
            return super().step(key, model, state, y, u, t)

        def ahead(each: Any, key: jax.Array, law: Any) -> tuple[Any, Info]:
            found = each.ahead(key, model, law, y, u, t)
            return found.after, found.info

        def blind() -> Any:
            return self._begun(key, state, t, lambda each, key, law: (each.ahead(key, model, law, y, u, t).predicted(), None))[0]

        after, info = self._begun(key, state, t, ahead)
        before = blind() if self.gate is not None else jax.lax.cond(info.collapsed | is_nothing(y), blind, lambda: after)
        return self.accept(before, after, info, y)

    def _begun(self, key: jax.Array, state: Any, t: Any, stage: Stage) -> tuple[Any, Any]:
        """Take a stage that begins with an exchange."""
        form = Form(state.plain)

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            given_key = random.child(key, random.RESAMPLE)
            handed = self.exchange.handed(crew, given_key, getattr(self.filter, "policy", None), form, form.law(lanes, rest), t)
            keys = crew.own(random.step_keys(key, self.elements))

            def one(own: tuple[jax.Array, Any], law: Any) -> tuple[Any, Any]:
                key, given = own
                return stage(self._each if given is None else replace(self._each, scheme=given, policy=Always()), key, law)

            law, info = form.mapped(one, self._at_once(state), (keys, handed.given), handed.law, handed.given is None)
            origin = handed.origin if handed.given is not None else jnp.take_along_axis(handed.origin, law.ancestors, axis=1)
            before = handed.law.log_weights if handed.given is None else handed.given.log_weights
            return _finished(crew, form, handed.log_mass, replace(law, ancestors=origin), info, self._prior(before, handed.log_mass))

        return self._taken(form, shared_out(work, self.elements, *form.arrays(state.plain), ranks=form.ranks))

    def _prior(self, log_weights: jax.Array, log_mass: jax.Array | None) -> jax.Array:
        """Return about the log masses `(e,)` of elements, by a few of their particles where they are not known."""
        few = log_weights[..., alarm.some_of(self.size)]
        return one_by_one(lambda k: log_sum(few[k]), few.shape[0]) if log_mass is None else log_mass

    def _at_once(self, law: Any) -> bool:
        """Whether the elements of a device are worked on at once: native kernels then go over them, in an order that is each one's own."""
        return engine.accelerated() or blocks.usable(self.size, law.log_weights.dtype)

    def _whole(self, form: Form, arrays: tuple[Any, Any]) -> Any:
        return in_elements(form.law(*arrays), self.elements)

    def _taken(self, form: Form, made: tuple[Any, Any]) -> tuple[Any, Any]:
        lanes, (rest, info) = made
        return self._whole(form, (lanes, rest)), info


def _finished(  # noqa: PLR0913 (what a stage made, and from what)
    crew: Crew, form: Form, log_mass: jax.Array | None, law: Any, info: Info | None, prior: jax.Array
) -> Any:
    """Return the arrays of what a stage made, weights normalized over all, and the record of the step, if it is one.

    Args:
        crew: the elements here.
        form: of the law.
        log_mass: log masses of the elements here before the stage, `(e,)`; None where the weights, and the evidence, have them in them.
        law: of the elements here, cut; weights normalized within each if it is weighed, or if there are log masses.
        info: of each element here.
        prior: log masses of them before they were weighed, up to a constant, `(e,)`.
    """
    if info is not None:
        info = replace(info, log_evidence=info.log_evidence if log_mass is None else info.log_evidence + log_mass)
        mine = info.log_evidence
        info, total = _of_all(crew.gathered({"prior": prior} | {name: getattr(info, name) for name in TOLD}))
        log_mass = mine - total
    if log_mass is not None:
        law = replace(law, log_weights=added(law.log_weights, log_mass))
    lanes, rest = form.arrays(form.uncut(law))
    return lanes, (rest, info)


def _of_all(of_elements: dict[str, jax.Array]) -> tuple[Info, jax.Array]:
    """Return the record of the step from what all elements say `(K,)`, evidences times masses, and the log of the sum of these.

    Squared distances of the measurement, and their degrees of freedom, are averaged with the masses of before, `prior`, which are known up
    to a constant.
    """
    joint, prior, freedom = (of_elements[name] for name in ("log_evidence", "prior", "freedom"))
    total = log_sum(jnp.where(jnp.isnan(joint), -jnp.inf, joint))
    shares = jnp.where(joint > -jnp.inf, jnp.exp(joint - jnp.where(jnp.isfinite(total), total, 0)), 0)
    squares = jnp.sum(jnp.where(shares > 0, shares**2 / of_elements["ess"], 0))
    found = [total, 1 / squares, jnp.sum(of_elements["invalid"]), jnp.min(of_elements["lowest"]), jnp.max(of_elements["highest"]),
             jnp.min(of_elements["shortfall"])]  # fmt: skip
    info = info_of(jnp.stack([one.astype(total.dtype) for one in found]))
    weights = jnp.where(freedom > 0, jnp.exp(prior - jnp.max(prior)), 0)
    known = jnp.sum(weights)
    square, freedom = (jnp.sum(jnp.where(weights > 0, weights * one, 0)) / jnp.where(known > 0, known, 1)
                       for one in (of_elements["nis"], freedom))  # fmt: skip
    return with_innovation(info, Innovation(square, freedom)), total
