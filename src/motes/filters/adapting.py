"""A filter with a memory that is learned while it runs: of what a target looks like, of a bias, of how noisy a sensor is.

1. The inner filter takes its step with a model that sees the memory as it is.
2. The memory is learned anew from the law and the measurement.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.core.user_functions import called
from motes.filters.info import Info
from motes.filters.interface import Guide
from motes.filters.wrapper import Wrapper
from motes.laws.carried import Carried
from motes.laws.observed import is_nothing, value_of
from motes.models.correlated import Augmented

MEMORY = "memory"
"""Name of the memory among the inputs."""


@record
class Adapting(Wrapper):
    """A filter whose model learns; its state is a `Carried` law, whose `beside` is the memory.

    The model's functions f(x, u, t) find the memory as `u["memory"]`, among the user's inputs, which are a dictionary or None.

    Source: Klein, Schulz, Frintrop, Cremers 2010, Adaptive real-time video-tracking for arbitrary objects.

    Example:
        >>> model = mo.textbook.growth()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mean = lambda key, memory, law, y, u, t: 0.9 * memory + 0.1 * law.mean()
        >>> mo.run(1, mo.Adapting(mo.ParticleFilter(n=500), jnp.zeros(1), mean), model, ys).state.beside.shape
        (1,)

    Attributes:
        filter: any filter.
        memory: tree of arrays to begin with.
        learn: `(key, memory, law, y, u, t)` gives the memory for the next step, in the same form; not asked where nothing was measured.
    """

    guide = Guide(
        needs="what the inner filter needs, and a rule by which the model learns",
        cost="that of the inner filter and of the rule",
        use="the sensor changes while it is looked through",
    )

    memory: Any
    learn: Callable[..., Any] = static()

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: learn is no function.
        """
        if not callable(self.learn):
            checks.refuse("Adapting learn", "a function (key, memory, law, y, u, t)", type(self.learn).__name__)
        for leaf in jax.tree.leaves(self.memory):
            if not isinstance(leaf, jax.Array) and np.asarray(leaf).dtype.kind not in "biuf":
                checks.refuse("Adapting memory", "a tree of arrays of numbers", type(leaf).__name__)

    adds_inputs = True  # type: ignore[assignment]

    def inputs_with(self, u: Any, beside: Any) -> dict[str, Any]:
        """Return the inputs with the memory.

        Raises:
            MotesError: they are no dictionary, or have such a name.
        """
        if u is not None and not isinstance(u, dict):
            checks.refuse("Adapting inputs", "a dictionary by name, or None (the memory is added)", type(u).__name__)
        if u is not None and MEMORY in u:
            checks.refuse("Adapting inputs", f"other names than {MEMORY!r}", repr(MEMORY))
        return {**(u or {}), MEMORY: beside}

    def seen_inputs(self, u: Any) -> Any:
        """Return the inputs with the memory; for tracing."""
        return self.filter.seen_inputs(u if isinstance(u, Augmented) else self.inputs_with(u, self.memory))

    def prepare(self, model: Any, u: Any) -> Any:
        """Ask of the model what the inner filter asks.

        Raises:
            MotesError: its noises are correlated, or the inner filter cannot use it.
        """
        if isinstance(u, Augmented):
            checks.refuse("Adapting model", "independent process and measurement noise", "noise_cross_cov")
        return self.filter.prepare(model, u)

    def begun(self, key: jax.Array, model: Any, law: Any) -> Any:
        """Begin with the memory that was given."""
        return jax.tree.map(jnp.asarray, self.memory)

    def after(self, key: jax.Array, before: Carried, law: Any, info: Info, y: Any, u: Any, t: Any) -> tuple[Carried, Info]:
        """Learn from the law and the measurement."""
        learned = called("Adapting learn(key, memory, law, y, u, t)", self.learn, key, before.beside, law, value_of(y), u, t)
        if _form(learned) != _form(before.beside):
            checks.refuse("Adapting learn", f"a memory of the form {_form(before.beside)}", _form(learned))
        missing = is_nothing(y)
        return Carried(law, jax.tree.map(lambda new, old: jnp.where(missing, old, new), learned, before.beside)), info


def _form(memory: Any) -> str:
    """Say what a memory is made of."""
    return str(jax.tree.map(lambda leaf: f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}", memory)).replace("'", "")
