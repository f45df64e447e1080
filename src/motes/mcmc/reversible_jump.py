"""Reversible-jump Markov chain Monte Carlo (Green 1995; Djuric 2004, section 2.1, whose equation 10 lacks the Jacobian).

1. Choose one of the jumps that are possible here, with probability j(model, x); draw its choice and its u.
2. Map (model, x, u, choice) to (model', x', u', choice').
3. Go there with probability min(1, p(x') j' w'(choice') q'(u') / (p(x) j w(choice) q(u)) |d(x', u') / d(x, u)|), where primes belong to the
   reverse jump.
4. Make a step within the model.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, lapack, logspace, random
from motes.core.record import record, replace, static
from motes.laws.cloud import draw
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, accept_or_stay, as_kernel
from motes.mcmc.jumps import Configuration, Jump

TRIALS = 60
"""Jumps tried before a chain starts, to see whether maps and their inverses agree."""


class Proposed(NamedTuple):
    """Where a jump leads, the log ratio there but for its Jacobian, the live part of the Jacobian, and whether the reverse leads back."""

    position: Configuration
    log_ratio: jax.Array
    jacobian: jax.Array
    undone: jax.Array


@record
class ReversibleJump(Kernel):
    """Jumps between models; positions are `mcmc.Configuration`s.

    Source: Green 1995, Reversible jump Markov chain Monte Carlo computation and Bayesian model determination.

    Example:
        >>> jumps = mo.mcmc.birth_death(mo.Gaussian(jnp.zeros(1), jnp.eye(1)), most=4)
        >>> kernel = mo.mcmc.ReversibleJump(jumps, size=lambda k: k, within=mo.mcmc.RandomWalkMetropolis(1.0))
        >>> log_density = lambda at: -0.5 * jnp.sum(at.x**2) - 0.5 * jnp.log(2 * jnp.pi) * at.model
        >>> chains = mo.sample(0, kernel, log_density, mo.mcmc.Configuration(1, jnp.zeros(4)))
        >>> chains.positions.x.shape
        (4, 1000, 4)

    Attributes:
        jumps: names and jumps.
        size: function of the model that returns how many components of x are live.
        within: kernel that moves x within a model, after each jump; None for none.
        probabilities: function `(model, x)` that returns log weights `(m,)` of the jumps; those that have no choice are left out. None: all
            equal.
    """

    names: tuple[str, ...] = static()
    jumps: tuple[Jump, ...]
    size: Callable[[Any], Any] = static()
    within: Kernel | None
    probabilities: Callable[..., jax.Array] | None = static()

    def __init__(
        self,
        jumps: Mapping[str, Jump],
        size: Callable[[Any], Any],
        within: Kernel | None = None,
        probabilities: Callable[..., jax.Array] | None = None,
    ):
        """Check that every jump has its reverse.

        Raises:
            MotesError: naming the jump without one, or the argument that cannot be used.
        """
        if not isinstance(jumps, Mapping) or not jumps or not all(isinstance(jump, Jump) for jump in jumps.values()):
            checks.refuse("ReversibleJump jumps", "a dictionary from names to mo.mcmc.Jump", type(jumps).__name__)
        for name, jump in jumps.items():
            other = jumps.get(jump.reverse)
            if other is None or other.reverse != name:
                given = f"no jump {jump.reverse!r}" if other is None else f"{jump.reverse!r}, whose reverse is {other.reverse!r}"
                checks.refuse(f"ReversibleJump jumps[{name!r}]", "a reverse among the jumps that names it in turn", given)
        if not callable(size):
            checks.refuse("ReversibleJump size", "a function of the model", type(size).__name__)
        if within is not None:
            as_kernel("ReversibleJump within", within, of_many=True)
        for field, value in (("names", tuple(jumps)), ("jumps", tuple(jumps.values())), ("size", size), ("within", within),
                             ("probabilities", probabilities)):
            object.__setattr__(self, field, value)

    @property
    def moves(self) -> tuple[str, ...]:
        """The jumps, then the moves within a model."""
        return (*self.names, *(f"within: {move}" for move in (self.within.moves if self.within else ())))

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return the state of the kernel that moves within models."""
        return () if self.within is None else self.within.init_kernel_state(self._given(log_density, position.model), position.x)

    def init(self, key: jax.Array, log_density: LogDensity, position: Position) -> State:
        """Return the state of a chain, with zeros where nothing lives."""
        return super().init(key, log_density, self._padded(position))

    def _padded(self, position: Configuration) -> Configuration:
        live = jnp.arange(position.x.shape[0]) < self.size(position.model)
        return Configuration(position.model, jnp.where(live, position.x, 0))

    def _given(self, log_density: LogDensity, model: Any) -> LogDensity:
        """Density of x within a model, whatever stands where nothing lives."""
        return lambda x: log_density(self._padded(Configuration(model, x)))

    def _log_jumps(self, position: Configuration) -> jax.Array:
        """Log probabilities of the jumps, `(m,)`."""
        possible = jnp.stack([jnp.any(jump.log_choices(*position) > -jnp.inf) for jump in self.jumps])
        weights = jnp.zeros(len(self.jumps)) if self.probabilities is None else self.probabilities(*position)
        return _log_shares(jnp.where(possible, weights, -jnp.inf))

    def _proposed(self, place: int, key: jax.Array, position: Configuration) -> Proposed:
        """Draw a jump's choice and u (step 1), map them (step 2), and return what step 3 asks of the jump: all but p and j."""
        jump, back = self.jumps[place], self.jumps[self.names.index(self.jumps[place].reverse)]
        model, x = position
        # 1. choice and u
        log_choices = _log_shares(jump.log_choices(model, x))
        choice = draw(random.child(key, random.RESAMPLE), log_choices, 1)[0]
        law = jump.law_at(model, x, choice)
        u = x[:0] if law is None else law.sample(random.child(key, random.NOISE), 1)[:, 0].astype(x.dtype)
        # 2. map
        new_model, new_x, new_u, new_choice = jump.map(model, x, u, choice)
        there = self._padded(Configuration(new_model, new_x))
        # 3. ratio
        new_law = back.law_at(*there, new_choice)
        log_back = _log_shares(back.log_choices(*there))[new_choice] - log_choices[choice]
        log_u = (0 if new_law is None else new_law.log_prob(new_u)) - (0 if law is None else law.log_prob(u))
        old_size, new_size = self.size(model), self.size(there.model)

        def mapped(x: jax.Array, u: jax.Array) -> jax.Array:
            _, to_x, to_u, _ = jump.map(model, x, u, choice)
            return jnp.concatenate([to_x, to_u])

        jacobian = jnp.concatenate(jax.jacfwd(mapped, argnums=(0, 1))(x, u), axis=1)
        live = _live(jacobian, (old_size, x.shape[0]), (new_size, x.shape[0]))
        again = back.map(there.model, there.x, new_u, new_choice)
        undone = (old_size + u.shape[0] == new_size + new_u.shape[0]) & _same(again, (model, x, u, choice), old_size)
        return Proposed(there, log_back + log_u, live, undone)

    def _jumped(self, chosen: jax.Array, key: jax.Array, position: Configuration) -> tuple[Configuration, jax.Array, jax.Array]:
        """Make the chosen jump: where it leads, its log ratio, and whether its reverse leads back."""
        jumps = [partial(self._proposed, place, key) for place in range(len(self.jumps))]
        widest = max(jax.eval_shape(jump, position).jacobian.shape[0] for jump in jumps)

        def widened(jump: Callable[[Configuration], Proposed], position: Configuration) -> Proposed:
            found = jump(position)
            live = found.jacobian
            return found._replace(jacobian=jnp.eye(widest, dtype=live.dtype).at[: len(live), : len(live)].set(live))

        # chains that jump side by side make every jump each: one determinant for all jumps in place of one for each
        found = jax.lax.switch(chosen, [partial(widened, jump) for jump in jumps], position)
        return found.position, found.log_ratio + lapack.log_volume(found.jacobian), found.undone

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make one jump, and a step within the model."""
        jump_key = random.child(key, random.PREDICT)
        # 1. choose a jump; 2. make it
        log_jumps = self._log_jumps(state.position)
        chosen = draw(random.child(jump_key, random.INITIAL), log_jumps, 1)[0]
        there, log_ratio, undone = self._jumped(chosen, jump_key, state.position)
        # 3. accept or stay
        reverses = jnp.array([self.names.index(jump.reverse) for jump in self.jumps])
        density = log_density(there)
        log_ratio = log_ratio + self._log_jumps(there)[reverses[chosen]] - log_jumps[chosen] + density - state.log_density
        # where nothing can be chosen, and where the map is not undone, the chain stays
        allowed = undone & jnp.isfinite(log_jumps[chosen])
        after, done = accept_or_stay(
            random.child(key, random.UPDATE),
            state,
            replace(state, position=there, log_density=density),
            jnp.where(allowed, log_ratio, -jnp.inf),
        )
        made = (jnp.arange(len(self.jumps)) == chosen) & jnp.isfinite(log_jumps[chosen])
        broken = done.invalid | (~undone).astype(jnp.int32)
        info = Info(made * done.tried, made * done.accepted, made * broken)
        # 4. move within the model
        return (after, info) if self.within is None else self._within(self.within, key, log_density, after, t, info)

    def _within(self, within: Kernel, key: jax.Array, log_density: LogDensity, state: State, t: Any, jumped: Info) -> tuple[State, Info]:
        """Move x within its model (step 4)."""
        model = state.position.model
        inner = State(state.position.x, state.log_density, state.kernel_state)
        after, info = within.step(random.child(key, random.MEASURE), self._given(log_density, model), inner, t)
        return State(self._padded(Configuration(model, after.position)), after.log_density, after.kernel_state), Info.joined([jumped, info])

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Try the jumps from the start and from where they lead, and refuse a map that its reverse does not undo."""
        if not (isinstance(position, tuple) and hasattr(position, "model") and hasattr(position, "x")):
            checks.refuse("ReversibleJump init", "a mo.mcmc.Configuration(model, x)", type(position).__name__)
        here = self._padded(Configuration(*position))
        jumped, choose = jax.jit(self._jumped), jax.jit(self._log_jumps)
        tried = np.zeros(len(self.jumps), int)
        for trial in range(TRIALS):
            possible = np.flatnonzero(np.isfinite(np.asarray(choose(here))))
            if not possible.size:
                break
            place = int(possible[np.argmin(tried[possible])])
            tried[place] += 1
            there, log_ratio, undone = jumped(jnp.int32(place), random.step_key(key, trial), here)
            name, back = self.names[place], self.jumps[place].reverse
            if not bool(undone):
                checks.refuse(
                    f"ReversibleJump jumps[{name!r}] map",
                    f"one that {back!r} undoes, with as many live numbers on both sides",
                    f"another point coming back to model {np.asarray(here.model).tolist()}",
                )
            backward = float(choose(there)[self.names.index(back)])
            if not np.isfinite(backward) or not np.isfinite(float(log_ratio)):
                wanted = f"a map to where {back!r} can come back from, with a Jacobian that is not 0"
                given = f"log probability {backward:.4g} of {back!r}, log ratio {float(log_ratio):.4g}"
                checks.refuse(f"ReversibleJump jumps[{name!r}]", wanted, given)
            here = there if np.isfinite(float(log_density(there))) else here
        if self.within is not None:
            self.within.check(key, self._given(log_density, here.model), here.x)


def _log_shares(log_weights: jax.Array) -> jax.Array:
    shares, total = logspace.normalize(log_weights)
    return jnp.where(jnp.isfinite(total), shares, -jnp.inf)


def _live(jacobian: jax.Array, before: tuple[Any, int], after: tuple[Any, int]) -> jax.Array:
    """Live part of a Jacobian, filled up with ones on its diagonal; live numbers and length of x on each side, all of u lives."""

    def live_first(length: int, size: Any, padded: int) -> jax.Array:
        where = jnp.arange(length)
        return jnp.argsort((where >= size) & (where < padded), stable=True)

    rows, columns = live_first(jacobian.shape[0], *after), live_first(jacobian.shape[1], *before)
    least = min(jacobian.shape)
    ordered = jacobian[rows[:least]][:, columns[:least]]
    live = jnp.arange(least) < before[0] + jacobian.shape[1] - before[1]
    return jnp.where(live[:, None] & live, ordered, jnp.eye(least, dtype=jacobian.dtype))


def _same(again: Any, first: Any, size: Any) -> jax.Array:
    """Tell whether a jump and its reverse came back to the same model, live x, u and choice, up to rounding."""
    (model, x, u, choice), (old_model, old_x, old_u, old_choice) = again, first
    tolerance = 100 * float(jnp.finfo(old_x.dtype).eps) ** 0.75
    live = jnp.arange(old_x.shape[0]) < size
    near_x = jnp.all(~live | (jnp.abs(x - old_x) <= tolerance * (1 + jnp.abs(old_x))))
    if u.shape != old_u.shape:
        return jnp.zeros((), bool)
    near_u = jnp.all(jnp.abs(u - old_u) <= tolerance * (1 + jnp.abs(old_u)))
    return near_x & near_u & (choice == old_choice) & jnp.all(model == old_model)
