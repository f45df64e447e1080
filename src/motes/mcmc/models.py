"""Which model: what draws of whole numbers tell of their probabilities."""

from typing import Any

import numpy as np

from motes.core import checks
from motes.io.result_table import Table
from motes.mcmc import convergence


def frequencies(draws: Any) -> Table:
    """Return a row for each value of whole numbers `(chain, draw)`: how probable it is, with the Monte Carlo standard error of that.

    Give the model of each draw, as a number: of components, of changes, a code of the chosen variables.

    Raises:
        MotesError: draws are no whole numbers, or have no axis for the chains.
    """
    values = np.asarray(draws)
    checks.shape("frequencies draws", values, (None, None), "(chain, draw)")
    if not (np.issubdtype(values.dtype, np.integer) or values.dtype == bool):
        checks.refuse("frequencies draws", "whole numbers", f"dtype {values.dtype}")
    rows = []
    for value in np.unique(values):
        here = 1.0 * (values == value)
        rows.append((int(value), float(here.mean()), convergence.standard_error(here)))
    return Table(("value", "probability", "s.e."), tuple(rows))
