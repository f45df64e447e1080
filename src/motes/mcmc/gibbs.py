"""The Gibbs sampler (Geman, Geman 1984; Djuric 2004, section 2.1): each part is drawn from its law given all others.

1. Choose the parts: all in turn (systematic scan), or one of them with equal probability (random scan).
2. Draw each chosen part from its law given the present values of all others.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, static
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, check_part, put, take

Draw = Callable[[jax.Array, Any], Any]


@record
class Gibbs(Kernel):
    """Draws parts, or blocks of parts, of a position from their conditional laws.

    Source: Geman, Geman 1984, Stochastic relaxation, Gibbs distributions, and the Bayesian restoration of images.

    Example:
        >>> draw = lambda other: lambda key, at: 0.6 * at[other] + 0.8 * jax.random.normal(key)
        >>> kernel = mo.mcmc.Gibbs({"x": draw("y"), "y": draw("x")})
        >>> log_density = lambda at: (1.2 * at["x"] * at["y"] - at["x"] ** 2 - at["y"] ** 2) / 1.28
        >>> chains = mo.sample(0, kernel, log_density, {"x": 0.0, "y": 0.0})
        >>> chains.positions["x"].shape
        (4, 1000)

    Attributes:
        draws: pairs of a part (see `mcmc.Block`; a tuple of names is a block of a dictionary) and a function of a key and the position
            that draws the part's new value.
        scan: "systematic", each in turn in every step, or "random", one of them in a step.
    """

    draws: tuple[tuple[Any, Draw], ...] = static()
    scan: str = static(default="systematic")

    def __init__(self, draws: Mapping[Any, Draw], scan: str = "systematic"):
        """Check the parameters.

        Args:
            draws: part to function.
            scan: order of the parts.

        Raises:
            MotesError: naming the one that cannot be used.
        """
        if not isinstance(draws, Mapping) or not draws:
            checks.refuse("Gibbs draws", "a dictionary from parts to functions (key, position)", type(draws).__name__)
        for part, function in draws.items():
            if not callable(function):
                checks.refuse(f"Gibbs draws[{part!r}]", "a function (key, position)", type(function).__name__)
        checks.option("Gibbs scan", scan, ("systematic", "random"))
        object.__setattr__(self, "draws", tuple(draws.items()))
        object.__setattr__(self, "scan", scan)

    @property
    def moves(self) -> tuple[str, ...]:
        """One move per part."""
        return tuple(f"draw {part}" for part, _ in self.draws)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask that each function returns what it replaces."""
        for part, function in self.draws:
            check_part(f"Gibbs draws[{part!r}]", position, part)
            old, new = (jax.eval_shape(what, key, position) for what in (lambda key, position, part=part: take(position, part), function))
            if jax.tree.map(jnp.shape, old) != jax.tree.map(jnp.shape, new):
                checks.refuse(f"Gibbs draws[{part!r}]", f"a value like {jax.tree.map(jnp.shape, old)}", jax.tree.map(jnp.shape, new))

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Draw all parts in turn, or one of them."""

        # 2. draw a part
        def drawn(place: int, position: Position) -> Position:
            part, function = self.draws[place]
            new = function(random.step_key(key, place), position)
            return put(position, part, jax.tree.map(lambda leaf, old: jnp.asarray(leaf, old.dtype), new, take(position, part)))

        count = len(self.draws)
        position = state.position
        # 1. choose the parts
        if self.scan == "systematic":
            for place in range(count):
                position = drawn(place, position)
            tried = jnp.ones(count)
        else:
            chosen = (random.uniform(random.child(key, random.RESAMPLE), (), jnp.float32) * count).astype(jnp.int32)
            position = jax.lax.switch(chosen, [lambda position, place=place: drawn(place, position) for place in range(count)], position)
            tried = (jnp.arange(count) == chosen).astype(jnp.result_type(float))
        return State(position, log_density(position)), Info(tried, tried, jnp.zeros(count, jnp.int32))
