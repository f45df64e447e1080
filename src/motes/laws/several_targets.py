"""Scans of several targets, a known number of them: nobody says which plot is whose (Bar-Shalom, Li 1995, section 6.2; Mahler 2007).

Each target gives at most one plot, each plot is of at most one target; the likelihood of a scan sums over all associations:

    p(scan | x_1 .. x_T) = exp(-rate) prod_j kappa(z_j) sum over associations of
        prod over targets i without a plot of (1 - P_D(x_i)) times prod over targets i with plot j of P_D(x_i) p(z_j | x_i) / kappa(z_j)

The sums are in `association.py`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, replace, static
from motes.laws.association import EXACT, NEVER, gained, missed, nobody, whole, with_plot
from motes.laws.cluttered import Cluttered, room_for
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.law import Law
from motes.laws.near_plots import in_chunks
from motes.laws.observed import Observed, value_of

MOST = 100
"""Targets of one sensor."""


@record
class SeveralTargets(Conditional):
    """A sensor whose scans hold plots of several targets, whose states follow each other in that of the model.

    Particle filters weigh by the exact sum over associations of up to six targets, also where they cross. The marginalized filter carries
    what plots do not look at, for all targets. `JPDAParticleFilter` has a cloud for each target, Gaussian filters a Gaussian.

    Source: Bar-Shalom, Li 1995, Multitarget-Multisensor Tracking; Mahler 2007, Statistical Multisource-Multitarget Information Fusion.

    Example:
        >>> one = mo.Cluttered(mo.AdditiveGaussian(lambda x, u, t: x[:1], [[0.1]]), 0.9, clutter=0.01, plots=8)
        >>> both = mo.laws.SeveralTargets(one, (("a", "v_a"), ("b", "v_b")))
        >>> dynamics = mo.AdditiveGaussian(lambda x, u, t: x, jnp.eye(4))
        >>> model = mo.StateSpaceModel(mo.Gaussian(jnp.zeros(4), jnp.eye(4)), dynamics, both, ("a", "v_a", "b", "v_b"))
        >>> mo.run(0, mo.ParticleFilter(n=500), model, [jnp.array([[0.1], [1.0]]), jnp.array([[0.3]])]).mean.shape
        (2, 4)

    Attributes:
        one: the sensor of one target among false plots, whose functions see its own states alone.
        targets: for each target its states, by name or index, in the order of the functions.
    """

    one: Cluttered
    targets: tuple[tuple[str | int, ...], ...] = static()
    measures_anything = True

    def __init__(self, one: Cluttered, targets: tuple[tuple[str | int, ...], ...]):
        """Check what can be known without a model.

        Raises:
            MotesError: an argument has the wrong kind, there are no or too many targets, they have different numbers of states or share
                some, or drawn scans would have more plots than there is room for.
        """
        checks.instance("SeveralTargets one", one, Cluttered, "a Cluttered sensor of one target")
        targets = tuple(tuple(own) if isinstance(own, (tuple, list)) else (own,) for own in targets)
        if not 1 <= len(targets) <= MOST or len({len(own) for own in targets}) > 1:
            checks.refuse("SeveralTargets targets", f"1 to {MOST} targets of the same number of states", [len(own) for own in targets])
        every = [state for own in targets for state in own]
        if len(set(every)) < len(every):
            checks.refuse("SeveralTargets targets", "states of their own", f"{next(s for s in every if every.count(s) > 1)!r} for two")
        needed = 0 if one.rate is None or not checks.is_concrete(one.rate) else room_for(float(one.rate)) + len(targets) - 1
        if one.plots < needed:
            checks.refuse("SeveralTargets plots", f"at least {needed} for {len(targets)} targets", one.plots)
        object.__setattr__(self, "one", one)
        object.__setattr__(self, "targets", targets)

    @property
    def indices(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the states of each target."""
        return self.targets  # type: ignore[return-value]

    def of_states(self, names: tuple[str, ...]) -> "SeveralTargets":
        """Look up the states that are named."""
        places = {name: place for place, name in enumerate(names)} | {place: place for place in range(-len(names), len(names))}
        unknown = [state for own in self.targets for state in own if state not in places]
        if unknown:
            checks.refuse("SeveralTargets targets", f"among the states {', '.join(names)}", repr(unknown[0]))
        found = tuple(tuple(places[state] % len(names) for state in own) for own in self.targets)
        every = [place for own in found for place in own]
        if len(set(every)) < len(every):
            twice = next(place for place in every if every.count(place) > 1)
            checks.refuse("SeveralTargets targets", "states of their own", f"{names[twice]!r} for two")
        return replace(self, targets=found, one=self.one.of_states(tuple(names[place] for place in found[0])))

    def of_each(self) -> list[Conditional]:
        """Return for each target what a plot of it is, given the whole state; the sensor itself where it has no moments."""
        sensor = self.one.sensor

        def of(own: tuple[int, ...]) -> Conditional:
            def mean(x: jax.Array, u: Any, t: Any) -> jax.Array:
                return sensor.mean(linalg.take(x, own), u, t)

            def cov(x: jax.Array, u: Any, t: Any) -> jax.Array:
                return sensor.cov(linalg.take(x, own), u, t)

            return AdditiveGaussian(mean, cov, angles=sensor.angles)

        return [of(own) for own in self.indices] if sensor.has_moments else [sensor]

    def packed(self, ys: Any) -> Observed:
        """Return scans with room for as many plots as the sensor of one target says."""
        return self.one.packed(ys)

    def silence(self, steps: int) -> Observed:
        """Return so many steps without a scan."""
        return self.one.silence(steps)

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: a set has no mean."""
        checks.refuse("SeveralTargets", "a sensor with a mean and a covariance", "one of sets of plots",
                      "Use a particle filter, or a Gaussian filter.")

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Observed:
        """Draw one scan for each particle, plots `(K, z, n)`, those that are not there NaN, in an order that tells nothing."""
        keys = random.step_keys(random.child(key, 5), len(self.indices))
        drawn = [self.one.own_plot(keys[i], linalg.take(X, own), u, t) for i, own in enumerate(self.indices)]
        return self.one.among_false(key, *(jnp.stack(each) for each in zip(*drawn, strict=True)))

    def log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density of a scan given each particle, `(n,)`; see `Cluttered`."""
        if len(self.indices) > EXACT:
            hint = "Use JPDAParticleFilter or a Gaussian filter, whose targets each have a law of their own."
            checks.refuse("SeveralTargets targets", f"at most {EXACT}, whose associations each particle sums over", len(self.indices), hint)
        rows, one, n = jnp.asarray(value_of(value)), self.one, X.shape[-1]
        shared = self.shared(rows)
        own = [linalg.take(X, states) for states in self.indices]
        probabilities = [jnp.broadcast_to(one.detected(x, u, t), (n,)) for x in own]
        misses = [missed(p) for p in probabilities]
        seen = [one.of_plots(x, u, t) for x in own]
        wanted = shared.certain
        for miss, each in zip(misses, seen, strict=True):
            wanted |= one.seen_by_any(rows, shared.gains, miss, each)

        def plot(totals: jax.Array, now: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            z, gain, false = now
            hits = [jnp.log(p) + gained(gain, each.density(z)) for p, each in zip(probabilities, seen, strict=True)]
            return with_plot(totals, hits, false), None

        def with_plots(totals: jax.Array, *plots: Any) -> jax.Array:
            return jax.lax.scan(plot, totals, plots)[0]

        start = nobody(len(own), (n,), X.dtype)
        totals = in_chunks(with_plots, start, wanted, (rows, jnp.nan), (shared.gains, -jnp.inf), (shared.false, 0.0))
        return shared.base + whole(totals, misses)

    def shared(self, rows: jax.Array) -> "Shared":
        """Work out what all particles share of a scan `(K, z)`."""
        base, gains, possible = self.one.all_false(rows)
        return Shared(base, gains, jnp.where(possible, 0, NEVER).astype(rows.dtype))


class Shared(NamedTuple):
    """What all particles share of a scan.

    Attributes:
        base: log likelihood if all plots were false, `()`; plots where no false ones can be are left out.
        gains: what the log density of a plot is added to where it is a target's, `(K,)`; minus infinity where there is none.
        false: log of what a plot brings if it is nobody's, `(K,)`: 0, or `NEVER`.
    """

    base: jax.Array
    gains: jax.Array
    false: jax.Array

    @property
    def certain(self) -> jax.Array:
        """Whether a plot must be a target's, `(K,)`."""
        return self.false < 0
