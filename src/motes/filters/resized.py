"""A law with another number of particles."""

from typing import Any

import jax

from motes.core import checks, random
from motes.core.record import replace
from motes.filters.interface import Filter
from motes.laws.carried import Carried
from motes.resampling.schemes import Systematic


def resized(key: jax.Array, law: Any, filter: Filter) -> Any:
    """Return a law with as many particles as a filter has, drawn by systematic resampling.

    Args:
        key: of the step.
        law: whose particles can be drawn: `Cloud`, `MarginalCloud`, mixtures of a filter with n; also with something carried beside it.
        filter: says how many.

    Raises:
        MotesError: the law has none.
    """
    if isinstance(law, Carried):
        return replace(law, law=resized(key, law.law, filter))
    n = filter.fixed_count
    if n is None or not law.weighted:
        checks.refuse("resize filter", "one with a number of particles n", type(filter).__name__)
    return law.resampled(Systematic().ancestors(random.child(key, random.RESAMPLE), law.log_weights, n))
