"""A filter around another, as somebody else would write one: it remembers how far measurements lay from what was predicted."""

import jax.numpy as jnp

from motes.core.record import record
from motes.filters.wrapper import Wrapper
from motes.laws.carried import Carried


@record
class Remembering(Wrapper):
    """Carries the running mean of the log of what each measurement added to the evidence."""

    def begun(self, key, model, law):
        return jnp.zeros(())

    def after(self, key, before, law, info, y, u, t):
        return Carried(law, 0.9 * before.beside + 0.1 * jnp.nan_to_num(info.log_evidence)), info
