"""KLD sampling (Fox 2003): as many particles as it takes to tell the law from its histogram, out of a few sizes.

1. Take the particles of the step before, as many as were found enough: by resampling where that is another number.
2. The inner filter, with that number, takes its step.
3. Count the cells of a grid in which particles lie; k of them ask for
   (k - 1) / (2 error) (1 - 2 / (9 (k - 1)) + sqrt(2 / (9 (k - 1))) z)^3 particles, z being the normal quantile of the level.

Each size is compiled; arrays are as long as the largest asks for, and what is not used has no weight.
"""

from collections.abc import Callable
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.filters.info import Info
from motes.filters.interface import Filter, Guide
from motes.filters.wrapper import Wrapper, cloud_of, with_cloud
from motes.laws.carried import Carried
from motes.laws.cloud import Cloud
from motes.resampling.schemes import Systematic


@record
class AdaptiveSize(Wrapper):
    """A particle filter whose number of particles follows the spread of its law; its state is a `Carried` cloud.

    The law's `beside` is the place of the present size among `sizes`, and that of the one which was found enough.

    Source: Fox 2003, Adapting the sample size in particle filters through KLD-sampling.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> filter = mo.AdaptiveSize(mo.ParticleFilter(n=2000), sizes=(200, 2000), widths=(0.5,))
        >>> mo.run(1, filter, model, ys).mean.shape
        (50, 1)

    Attributes:
        filter: whose law is a `Cloud`; its own n is not used.
        sizes: numbers of particles to choose from, increasing.
        widths: of the cells of the grid, one per state, in its units; infinite for a state that does not count.
        error: bound on the Kullback-Leibler distance of the histogram from the law.
        level: probability with which the bound holds.
    """

    guide = Guide(
        needs="what the inner filter needs",
        cost="that of the inner filter with the present size, and a sort",
        use="the law is wide at times, as in localization without a start, and narrow for long",
    )

    sizes: tuple[int, ...] = static()
    widths: tuple[float, ...] = static()
    error: float = static(default=0.05)
    level: float = static(default=0.99)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: sizes do not increase, a width is not above 0, error or level is no number between 0 and 1, or the filter has no n.
        """
        if self.filter.particle_count is None:
            checks.refuse("AdaptiveSize filter", "one with a number of particles n", type(self.filter).__name__)
        for name in ("sizes", "widths"):
            if not isinstance(getattr(self, name), (tuple, list)) or not getattr(self, name):
                checks.refuse(f"AdaptiveSize {name}", "some numbers, in a tuple", getattr(self, name))
        for size in self.sizes:
            checks.positive_integer("AdaptiveSize sizes", size)
            if (least := self.filter.with_particles(size).particle_count) != size:
                checks.refuse("AdaptiveSize sizes", f"numbers of particles that the filter can have, such as {least}", size)
        if list(self.sizes) != sorted(set(self.sizes)):
            checks.refuse("AdaptiveSize sizes", "numbers that increase", self.sizes)
        if not all(isinstance(width, (int, float)) and width > 0 for width in self.widths):
            checks.refuse("AdaptiveSize widths", "a width above 0 for each state", self.widths)
        if all(width == float("inf") for width in self.widths):
            checks.refuse("AdaptiveSize widths", "a finite width for one state at least", self.widths)
        for name in ("error", "level"):
            checks.above_zero(f"AdaptiveSize {name}", getattr(self, name))
            if not 0 < getattr(self, name) < 1:
                checks.refuse(f"AdaptiveSize {name}", "a number between 0 and 1", getattr(self, name))

    @property
    def particle_count(self) -> int:
        """The most particles that it chooses."""
        return self.sizes[-1]

    @property
    def fixed_count(self) -> None:
        """None, as it chooses the number."""
        return

    def with_particles(self, n: int) -> "AdaptiveSize":
        """Return the same filter with at most n particles, or as many more as the inner filter needs."""
        n = self.filter.with_particles(n).particle_count or n
        return replace(self, sizes=(*(size for size in self.sizes if size < n), n))

    def _sized(self, n: int) -> Filter:
        """Return the inner filter with so many particles."""
        return self.inner.with_particles(n)

    def begun(self, key: jax.Array, model: Any, law: Any) -> Any:
        """Begin with the most."""
        most = jnp.int32(len(self.sizes) - 1)
        return most, most

    def init(self, key: jax.Array, model: Any) -> Carried:
        """Begin with the most particles.

        Raises:
            MotesError: there are not as many widths as states.
        """
        law = self._sized(self.sizes[-1]).init(key, model)
        size = cloud_of("AdaptiveSize", law).particles.shape[0]
        if len(self.widths) != size:
            checks.refuse("AdaptiveSize widths", f"one for each of {size} states", f"{len(self.widths)}")
        return Carried(law, self.begun(key, model, law))

    def predict(self, key: jax.Array, model: Any, state: Carried, u: Any, t: Any) -> Carried:
        """Take as many as were found enough (step 1), and predict."""

        def at(place: int) -> Callable[[], Any]:
            def work() -> Any:
                one = self._sized(self.sizes[place])
                return self._padded(one.predict(key, model, self._taken(key, state, place), u, t))  # type: ignore[attr-defined]

            return work

        enough = state.beside[1]
        return Carried(jax.lax.switch(enough, [at(place) for place in range(len(self.sizes))]), (enough, enough))

    def update(self, key: jax.Array, model: Any, state: Carried, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Take in the measurement of the present time with the present size."""

        def at(place: int) -> Callable[[], Any]:
            def work() -> Any:
                law, info = self._sized(self.sizes[place]).update(key, model, self._cut(state.law, place), y, u, t)
                return self._padded(law), info

            return work

        present = state.beside[0]
        law, info = jax.lax.switch(present, [at(place) for place in range(len(self.sizes))])
        return Carried(law, (present, self._enough(law))), info

    def step(self, key: jax.Array, model: Any, state: Carried, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Go to the next time t with as many as were found enough (steps 1 to 3)."""

        def at(place: int) -> Callable[[], Any]:
            def work() -> Any:
                taken = self._taken(random.child(key, random.PREDICT), state, place)
                law, info = self._sized(self.sizes[place]).step(key, model, taken, y, u, t)
                return self._padded(law), info

            return work

        present = state.beside[1]
        law, info = jax.lax.switch(present, [at(place) for place in range(len(self.sizes))])
        return Carried(law, (present, self._enough(law))), info

    def after(self, key: jax.Array, before: Carried, law: Any, info: Info, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Change nothing: sizes are chosen where the inner filter is called."""
        return Carried(law, before.beside), info

    def _cut(self, law: Any, place: int) -> Any:
        n, cloud = self.sizes[place], cloud_of("AdaptiveSize", law)
        return with_cloud(law, Cloud(cloud.particles[:, :n], cloud.log_weights[:n], cloud.ancestors[:n]))

    def _taken(self, key: jax.Array, state: Carried, place: int) -> Any:
        """Return the law with so many particles: those that there are, or as many drawn from them."""
        cloud, n = cloud_of("AdaptiveSize", state.law), self.sizes[place]

        def drawn() -> Cloud:
            return cloud.resampled(Systematic().ancestors(random.child(key, random.FILTER), cloud.log_weights, n))

        as_it_is = (state.beside[0] == place) & jnp.all(cloud.log_weights[n:] == -jnp.inf)
        return with_cloud(state.law, jax.lax.cond(as_it_is, lambda: cloud_of("AdaptiveSize", self._cut(state.law, place)), drawn))

    def _padded(self, law: Any) -> Any:
        """Return the law with as many particles as the largest size, the others without weight."""
        cloud = cloud_of("AdaptiveSize", law)
        short = self.sizes[-1] - cloud.log_weights.shape[0]
        more = jnp.broadcast_to(cloud.particles[:, :1], (cloud.particles.shape[0], short))
        return with_cloud(law, Cloud(
            jnp.concatenate([cloud.particles, more], axis=1),
            jnp.pad(cloud.log_weights, (0, short), constant_values=-jnp.inf),
            jnp.pad(cloud.ancestors, (0, short)),
        ))  # fmt: skip

    def _enough(self, law: Any) -> jax.Array:
        """Place of the smallest size that the cells of the law are content with (step 3)."""
        cloud = cloud_of("AdaptiveSize", law)
        counted = [state for state, width in enumerate(self.widths) if np.isfinite(width)]
        widths = jnp.asarray([self.widths[state] for state in counted], cloud.particles.dtype)
        cells = jnp.floor(cloud.particles[np.array(counted, int)] / widths[:, None]).astype(jnp.int32)
        used = cloud.log_weights > -jnp.inf
        # what has no weight is put in a cell of its own
        cells = jnp.where(used, cells, jnp.iinfo(jnp.int32).max)
        order = jnp.lexsort(cells)
        differs = jnp.any(cells[:, order][:, 1:] != cells[:, order][:, :-1], axis=0)
        count = 1 + jnp.sum(differs) - (~jnp.all(used)).astype(jnp.int32)
        spare = jnp.maximum(count - 1, 1).astype(cloud.particles.dtype)
        term, z = 2 / (9 * spare), NormalDist().inv_cdf(self.level)
        wanted = jnp.where(count > 1, spare / (2 * self.error) * (1 - term + jnp.sqrt(term) * z) ** 3, 1)
        return jnp.minimum(jnp.sum(jnp.asarray(self.sizes) < wanted), len(self.sizes) - 1).astype(jnp.int32)
