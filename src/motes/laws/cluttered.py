"""Measurements that come as sets: false plots among them, and a target that is not always seen (Mahler 2007; Bar-Shalom, Li 1995).

A scan is a set of plots z_1 .. z_m. The target gives one of them with probability P_D(x), distributed as p(z | x); all others are false: a
Poisson number of them, of intensity kappa(z) = rate c(z) per unit of measurement space. Nobody says which is which, so that

    p(scan | x) = exp(-rate) prod_j kappa(z_j) [1 - P_D(x) + P_D(x) sum_j p(z_j | x) / kappa(z_j)]
"""

from collections.abc import Callable
from math import exp, lgamma, log
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.laws.association import missed
from motes.laws.conditional import AdditiveGaussian, AdditiveNoise, Conditional, matrix_over, over_particles
from motes.laws.custom import Custom
from motes.laws.density import max_log_normal
from motes.laws.law import Law, as_law, check_size, drawn
from motes.laws.near_plots import CHUNK, distance, in_chunks
from motes.laws.observed import Observed, value_of
from motes.laws.scans import with_room

RARE = 1e-6
"""Largest probability with which a drawn scan may have more false plots than there is room for."""


class Shared(NamedTuple):
    """What all particles share of a scan.

    Attributes:
        base: log density of the scan were all its plots false, without those that cannot be, `()`.
        missed: 0 where all plots can be false, else minus infinity, `()`.
        gains: what it brings if a plot is the target's instead, less log p(z | x), `(K,)`; minus infinity where there is no plot.
    """

    base: jax.Array
    missed: jax.Array
    gains: jax.Array


@record
class Cluttered(Conditional):
    """A sensor whose measurements are sets of plots, of which at most one is the target's.

    Measurements are what `mo.plots` makes of a list of scans. The likelihood is that of the set, summed over which plot is the target's,
    if any is: a scan without plots speaks for states at which the target is hard to see. Kalman filters and their relatives take it as
    probabilistic data association. Plots far from all particles are left out where that cannot be seen in the likelihood.

    Source: Mahler 2007, Statistical Multisource-Multitarget Information Fusion; Bar-Shalom, Li 1995, Multitarget-Multisensor Tracking.

    Example:
        >>> base = mo.textbook.constant_velocity()
        >>> scans = mo.Cluttered(base.sensor, detection=0.9, clutter=(5.0, mo.Uniform([-20.0, -20.0], [20.0, 20.0])), plots=20)
        >>> model = mo.StateSpaceModel(base.initial, base.dynamics, scans, base.names)
        >>> xs, ys = mo.simulate(0, model, 30)
        >>> mo.run(1, mo.MarginalizedParticleFilter(n=500), model, ys).mean.shape
        (30, 4)

    Attributes:
        sensor: the law of the target's own plot `(z,)`.
        detection: probability that it gives one, a number or a user function `(x, u, t)` that returns one.
        density: intensity of false plots, their expected number per unit of measurement space; None where a law says it.
        law: law of one false plot `(z,)`; None where the intensity is the same everywhere.
        rate: expected number of false plots of a scan, with `law`; None otherwise.
        plots: most plots that a scan can have, K.
    """

    sensor: Conditional
    detection: Any
    density: Any
    law: Law | None
    rate: Any
    plots: int = static()
    measures_anything = True

    def __init__(self, sensor: Conditional, detection: Any = 0.9, *, clutter: Any, plots: int):
        """Check what can be known without a model.

        Args:
            sensor: the law of the target's own plot, such as `AdditiveGaussian`.
            detection: probability that the target gives one, above 0 and at most 1, or a function `(x, u, t)` that returns it.
            clutter: intensity of false plots per unit of measurement space, the same everywhere; or a pair of their expected number in a
                scan and the law of one, which says where they can lie. With a number the factor exp(-rate), which no state changes, is
                left out of likelihoods, and nothing can be simulated.
            plots: most plots of a scan; a scan of more is refused.

        Raises:
            MotesError: an argument has the wrong kind, or drawn scans would have more plots than `plots` too often.
        """
        checks.instance("Cluttered sensor", sensor, Conditional, "a sensor such as AdditiveGaussian")
        if sensor.measures_anything and not isinstance(sensor, Custom):
            checks.refuse("Cluttered sensor", "a sensor of one plot, a vector", type(sensor).__name__)
        if isinstance(sensor, AdditiveGaussian) and not callable(sensor.Q):
            checks.covariance("Cluttered sensor Q", sensor.Q, np.shape(sensor.Q)[0], definite=True)
        if not callable(detection):
            checks.above_zero("Cluttered detection", detection, 1)
            detection = checks.as_float("Cluttered detection", detection)
        checks.positive_integer("Cluttered plots", plots)
        density, rate, law = None, None, None
        if isinstance(clutter, tuple) and len(clutter) == 2:
            rate, law = checks.as_float("Cluttered clutter rate", clutter[0]), as_law("Cluttered clutter law", clutter[1])
            checks.above_zero("Cluttered clutter rate", rate)
            _ask_room(rate, plots)
        else:
            wanted = "a density of false plots above 0, or a pair (false plots per scan, law of one)"
            if np.ndim(clutter) or callable(clutter) or isinstance(clutter, (Law, str)):
                checks.refuse("Cluttered clutter", wanted, type(clutter).__name__)
            density = checks.as_float("Cluttered clutter", clutter)
            checks.above_zero("Cluttered clutter", density)
        fields = {"sensor": sensor, "detection": detection, "density": density, "law": law, "rate": rate, "plots": plots}
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def of_states(self, names: tuple[str, ...]) -> "Cluttered":
        """Look up the states that the sensor names."""
        return replace(self, sensor=self.sensor.of_states(names))

    def packed(self, ys: Any) -> Observed:
        """Return scans with room for K plots each, those that are there first.

        Raises:
            MotesError: they are no scans, one has more plots than K, or a plot lacks some of its components.
        """
        leaves_out = self.law is not None and self.law.marginalizes and self.sensor.marginalizes
        return with_room(ys, self.plots, leaves_out, self._components)

    @property
    def _components(self) -> int | None:
        """How many components a plot has, where sensor or clutter say so."""
        if isinstance(self.sensor, AdditiveGaussian) and not callable(self.sensor.Q):
            return np.shape(self.sensor.Q)[0]  # type: ignore[arg-type]
        return None if self.law is None else drawn(self.law).shape[0]

    def silence(self, steps: int) -> Observed:
        """Return so many steps without a scan.

        Raises:
            MotesError: neither clutter nor sensor say how many components a plot has.
        """
        if self._components is None:
            return super().silence(steps)
        return Observed(np.full((steps, self.plots, self._components), np.nan), np.zeros(steps, bool))

    def check(self, x: Any, u: Any, t: Any) -> None:
        """Run detection and clutter on shapes alone and refuse what does not fit.

        Args:
            x: shape of a state.
            u: shapes of the inputs of a step.
            t: shape of its number.

        Raises:
            MotesError: the detection is no single number, or the law of false plots has other components than the sensor.
        """
        found = jax.eval_shape(lambda x, u, t: jnp.asarray(self.detected(x, u, t)), x, u, t)
        checks.shape("Cluttered detection(x, u, t)", jnp.zeros(found.shape), (), "(one probability)")
        if self.law is not None and isinstance(self.sensor, (AdditiveGaussian, AdditiveNoise)):
            of_f = self.sensor.mean if isinstance(self.sensor, AdditiveGaussian) else self.sensor.f
            size = jax.eval_shape(lambda x, u, t: jnp.asarray(of_f(x, u, t)), x, u, t).shape[0]
            check_size("Cluttered clutter law", self.law, size)

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: a set has no mean."""
        checks.refuse("Cluttered", "a sensor with a mean and a covariance", "one of sets of plots",
                      "Use a particle filter, a Gaussian filter, InteractingMultipleModel or JumpMarkovFilter.")

    def detected(self, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Probability that the target gives a plot, `()` or `(n,)`, of states `(x,)` or `(x, n)`."""
        if not callable(self.detection):
            return jnp.asarray(self.detection, X.dtype)
        return over_particles(self.detection, X, u, t) if X.ndim > 1 else jnp.asarray(self.detection(X, u, t)).astype(X.dtype)

    def log_intensity(self, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Log intensity of false plots at those of a scan `(K, z)`, `(K,)`, and log probability of none, `()`, 0 where it is not known."""
        if self.law is None:
            found = jnp.broadcast_to(jnp.log(self.density), rows.shape[:1]), jnp.zeros(())
        else:
            found = jnp.log(self.rate) + jax.vmap(self.law.log_prob)(rows), -self.rate
        return found[0].astype(rows.dtype), found[1].astype(rows.dtype)

    def all_false(self, rows: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return what a scan `(K, z)` is if no plot is a target's.

        Returns:
            Its log likelihood `()`, without plots where no false ones can be; what the log density of each plot is added to if it is a
            target's, `(K,)`, minus infinity where there is none; and which ones can be nobody's, `(K,)`.
        """
        there = ~jnp.all(jnp.isnan(rows), axis=1)
        log_intensity, base = self.log_intensity(rows)
        possible = jnp.isfinite(log_intensity)
        base = base + jnp.sum(jnp.where(there & possible, log_intensity, 0))
        gains = jnp.where(there, jnp.where(possible, -log_intensity, 0), -jnp.inf).astype(rows.dtype)
        return base, gains, possible | ~there

    def shared(self, rows: jax.Array) -> Shared:
        """Work out what all particles share of a scan `(K, z)`."""
        base, gains, possible = self.all_false(rows)
        # a plot where no false ones can be is the target's, and of two such at least one is nobody's
        certain = jnp.sum(~possible)
        gains = jnp.where(certain == 0, gains, jnp.where((certain == 1) & ~possible, gains, -jnp.inf))
        return Shared(base, jnp.where(certain == 0, 0, -jnp.inf).astype(rows.dtype), gains)

    def log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density of a scan given each particle, `(n,)`, with respect to that of plots z in their units, per plot."""
        rows = jnp.asarray(value_of(value))
        probability, shared = self.detected(X, u, t), self.shared(rows)
        hit, miss = jnp.log(probability), missed(probability, -jnp.inf) + shared.missed
        seen = self.of_plots(X, u, t)
        total = jnp.broadcast_to(miss, X.shape[-1:])
        if rows.shape[0] <= CHUNK:
            return shared.base + _with_plots(total, hit, seen.density, rows, shared.gains)
        wanted = self.seen_by_any(rows, shared.gains, total, seen)

        def with_plots(total: jax.Array, rows: jax.Array, gains: jax.Array) -> jax.Array:
            return _with_plots(total, hit, seen.density, rows, gains)

        return shared.base + in_chunks(with_plots, total, wanted, (rows, np.nan), (shared.gains, -np.inf))

    def of_plots(self, X: jax.Array, u: Any, t: Any) -> "OfPlots":
        """Return what weighs plots given states `(x, n)` of the target."""
        sensor = self.sensor
        if not isinstance(sensor, AdditiveGaussian):
            return OfPlots(lambda z: sensor.log_prob(z, X, u, t), None, None)
        means, cov = sensor.means(X, u, t), matrix_over(sensor.Q, X, u, t)
        return OfPlots(lambda z: sensor.log_prob_about(z, means, cov), means, cov)

    def seen_by_any(self, rows: jax.Array, gains: jax.Array, floors: jax.Array, of_plots: "OfPlots") -> jax.Array:
        """Do what `wanted` does for what weighs plots, with a floor for each particle `(n,)`; all where no Gaussian says predictions."""
        if of_plots.means is None or of_plots.cov is None:
            return jnp.isfinite(gains)
        return self.wanted(rows, gains, jnp.min(jnp.where(jnp.isnan(floors), jnp.inf, floors)), of_plots.means, of_plots.cov)

    def wanted(self, rows: jax.Array, gains: jax.Array, floor: jax.Array, means: jax.Array, cov: jax.Array) -> jax.Array:
        """Tell of each plot whether it can be seen in the likelihood of any of n particles or Gaussians; bool `(K,)`.

        Args:
            rows: the scan `(K, z)`.
            gains: see `Shared`.
            floor: below all log likelihoods, less `Shared.base`.
            means: predicted plots `(z, n)`.
            cov: their covariance, `(z, z)` or `(z, z, n)`.
        """
        peak = jnp.max(max_log_normal(jnp.zeros((rows.shape[1], *cov.shape[2:]), rows.dtype), cov))
        most = gains + peak - 0.5 * distance(self.sensor.angles, rows, means, cov)
        # all that are left out together stay below the rounding of the least likely one
        unseen = floor + np.log(0.5 * float(jnp.finfo(rows.dtype).eps) / rows.shape[0])
        return jnp.isfinite(gains) & ~(most < unseen)

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Observed:
        """Draw one scan for each particle, plots `(K, z, n)`, those that are not there NaN, in an order that tells nothing."""
        return self.among_false(key, *(each[None] for each in self.own_plot(key, X, u, t)))

    def own_plot(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> tuple[jax.Array, jax.Array]:
        """Draw the target's own plot `(z, n)`, and whether there is one, `(n,)`."""
        seen = random.uniform(random.child(key, 1), X.shape[-1:], X.dtype) < self.detected(X, u, t)
        return self.sensor.sample(random.child(key, 0), X, u, t), seen

    def among_false(self, key: jax.Array, own: jax.Array, seen: jax.Array) -> Observed:
        """Draw false plots, and put those of m targets `(m, z, n)` that are seen `(m, n)` among them."""
        law, (m, _, n), dtype = self.law, own.shape, own.dtype
        if law is None:
            checks.refuse("Cluttered clutter", "a pair (false plots per scan, law of one) (it is simulated here)", "a density")
        keys = [random.child(key, place) for place in range(2, 5)]
        false = law.sample(keys[0], self.plots * n).astype(dtype).reshape(-1, self.plots, n)
        # the number by inversion; what has no room, for which `_ask_room` keeps it rare, is lost
        counts = jnp.arange(self.plots - m, dtype=dtype)
        below = jnp.cumsum(jnp.exp(counts * jnp.log(self.rate) - self.rate - jax.lax.lgamma(counts + 1)))
        number = jnp.sum(random.uniform(keys[1], (n,), dtype) >= below[:, None], axis=0)
        there = (jnp.arange(self.plots)[:, None] < number).at[-m:].set(seen)
        all_plots = jnp.where(there[:, None], jnp.swapaxes(false, 0, 1).at[-m:].set(own), jnp.nan)
        order = jnp.argsort(jnp.where(there, random.uniform(keys[2], there.shape, dtype), 2), axis=0)
        return Observed(jnp.take_along_axis(all_plots, order[:, None], axis=0), jnp.ones((n,), bool))


class OfPlots(NamedTuple):
    """Log densities `(n,)` of a plot given each particle; predicted plots and their covariance, None where no Gaussian says them."""

    density: Callable[[jax.Array], jax.Array]
    means: jax.Array | None
    cov: jax.Array | None


def _with_plots(
    total: jax.Array, hit: jax.Array, density: Callable[[jax.Array], jax.Array], rows: jax.Array, gains: jax.Array
) -> jax.Array:
    """Add to a log likelihood `(n,)` the plots of some rows `(c, z)`."""
    each = hit + jnp.where(jnp.isfinite(gains)[:, None], gains[:, None] + jax.vmap(density)(rows), -jnp.inf)
    return jax.nn.logsumexp(jnp.concatenate([total[None], each]), axis=0)


def room_for(rate: float) -> int:
    """Plots that a scan needs room for where so many are false on average: one has more less than once in a million."""
    needed, more = -1, 1.0
    while more > RARE:
        needed += 1
        more -= exp(needed * log(rate) - rate - lgamma(needed + 1))
    return max(needed, int(rate)) + 1


def _ask_room(rate: jax.Array, plots: int) -> None:
    """Refuse so little room that drawn scans would not be what the model says."""
    if not checks.is_concrete(rate):
        return
    needed = room_for(float(rate))
    if plots < needed:
        checks.refuse("Cluttered plots", f"at least {needed}, since scans of {float(rate):g} false plots on average have up to so many",
                      plots)  # fmt: skip
