"""The steps of a stream as compiled programs.

Filter and model come as `form`, and as `parts`: the key and their arrays.
What goes from step to step comes and goes in parts too: to take records apart and together would cost more than many a step does.
"""

from functools import partial
from typing import Any

import jax

from motes.core.packed import Packed
from motes.core.types import Inputs
from motes.filters.history import Carry
from motes.filters.pair import Form
from motes.filters.setup import Setup, setup
from motes.native import report
from motes.tracing.compiling import jitted


def _ready(form: Form, parts: list[Any], u: Inputs, y: jax.Array) -> Setup:
    filter, model = jax.tree.unflatten(form.structure, parts[1:])
    return setup(parts[0], filter, model, u, y)


def handed_on(carry: Carry) -> Packed:
    """Take apart what goes from step to step."""
    # put together, numbers would be worked out once more for it, and rounded otherwise than in a run
    return Packed.of(carry, together=False)


def _is_light(form: Form, *rest: Any) -> bool:
    return form.light


@partial(jitted, few=_is_light, static_argnums=0)
def start(form: Form, parts: list[Any], u: Inputs, y: jax.Array) -> Packed:
    """Return what goes into step 0; of y only shape and type matter."""
    with report.collected():
        return handed_on(_ready(form, parts, u, y).start(u, y))


@partial(jitted, few=_is_light, static_argnums=0)
def move(form: Form, parts: list[Any], held: Packed, u: Inputs) -> Packed:
    """Go to the next step; its measurement counts as missing until it is taken in."""
    with report.collected():
        return handed_on(_ready(form, parts, u, held.whole().y).predict(held.whole(), u))


@partial(jitted, few=_is_light, static_argnums=0)
def take_in(form: Form, parts: list[Any], held: Packed, y: jax.Array) -> tuple[Packed, Packed]:
    """Take in a measurement of the present step; gives also the record of the step."""
    with report.collected() as notes:
        ready = _ready(form, parts, held.whole().u, y)
        carry, info = ready.update(held.whole(), y)
        report.complete(notes, type(ready.filter).__name__)
    return handed_on(carry), Packed.of(info)


@partial(jitted, few=_is_light, static_argnums=0)
def advance(form: Form, parts: list[Any], held: Packed, y: jax.Array, u: Inputs) -> tuple[Packed, Packed]:
    """Go to the next step and take in its measurement; gives also the record of the step."""
    with report.collected() as notes:
        ready = _ready(form, parts, u, y)
        carry, info = ready.step(held.whole(), y, u)
        report.complete(notes, type(ready.filter).__name__)
    return handed_on(carry), Packed.of(info)
