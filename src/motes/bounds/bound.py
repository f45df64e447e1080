"""What a bound is to its reader: covariances over time, and the errors that they allow."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static
from motes.io import archive
from motes.models.interface import index_of

States = str | int | tuple[str | int, ...]


@record
class Bound:
    """Covariances of the estimation error that a filter is measured against.

    A root mean square error is given in two forms: `rmse`, a curve with one value per time, and `overall_rmse`, the one number that stands
    in the tables of papers. The second is no mean of the first: squares are averaged, then the root is taken.

    Attributes:
        cov: error covariances after the measurement of each time, `(t, x, x)`, in squared units of the states.
        names: names of the states.
        kind: what they are, in words.
    """

    cov: jax.Array
    names: tuple[str, ...] = static()
    kind: str = static()

    def rmse(self, states: States) -> jax.Array:
        """Root of the trace of a block at each time, `(t,)`: the error of a vector such as a position, not of one axis.

        Args:
            states: names or indices of states that share a unit.

        Raises:
            MotesError: there is no such state, or none is given.
        """
        return jnp.sqrt(self._traces(states))

    def overall_rmse(self, states: States) -> jax.Array:
        """Root of the mean over time of the trace of a block, `()` (Karlsson et al. 2005); arguments and errors as for `rmse`."""
        return jnp.sqrt(jnp.mean(self._traces(states)))

    def _traces(self, states: States) -> jax.Array:
        chosen = [states] if isinstance(states, (str, int)) else list(states)
        places = [index_of(state, self.names) for state in chosen]
        if not places or len(set(places)) < len(places):
            checks.refuse("rmse states", f"different states among {', '.join(self.names)}, at least one", chosen)
        return jnp.sum(jnp.diagonal(self.cov, axis1=-2, axis2=-1)[..., np.array(places)], axis=-1)

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` with dimensions time, state and state2; needs the extra `results`."""
        xarray = checks.need("xarray", "results")
        names = list(self.names)
        coordinates = {"time": np.arange(self.cov.shape[0]), "state": names, "state2": names}
        data = {"cov": (("time", "state", "state2"), np.asarray(self.cov))}
        return xarray.Dataset(data, coords=coordinates, attrs=archive.provenance() | {"bound": self.kind})
