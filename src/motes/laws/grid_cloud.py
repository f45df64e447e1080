"""Weighted nodes of a grid, which holds a part of the probability only: the law of a point-mass filter."""

import jax

from motes.core.record import record
from motes.laws.cloud import Cloud


@record
class GridCloud(Cloud):
    """Weighted nodes of a grid, and what it has lost.

    Attributes:
        particles: nodes, `(x, n)`.
        log_weights: normalized, `(n,)`.
        ancestors: each node its own, `(n,)` int32.
        lost: share of the probability that left the grid on the way to this step, `()`.
        held: share that is left since the last measurement that was used, `()`.
    """

    lost: jax.Array
    held: jax.Array
