"""Work over all pairs of two clouds, in pieces that fit into memory."""

from collections.abc import Callable
from typing import Any

import jax

AT_ONCE = 4_000_000
"""So many pairs are worked out at a time."""


def against_all(function: Callable[[Any], Any], rows: Any, others: int) -> Any:
    """Return a function of each row, where each meets all of the others.

    Args:
        function: of one row.
        rows: tree of arrays with the rows on the first axis.
        others: how many each row meets.
    """
    count = jax.tree.leaves(rows)[0].shape[0]
    return jax.lax.map(function, rows, batch_size=max(1, min(count, AT_ONCE // others)))
