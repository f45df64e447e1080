"""What a user hands over as measurements: brought to arrays, or refused in one line that says where."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.types import Inputs
from motes.models.interface import Model
from motes.models.state_space import checked_inputs


def checked_data(model: Any, ys: Any, inputs: Inputs) -> tuple[Any, Inputs]:
    """Return measurements, in the model's type, and inputs as arrays, or refuse what does not fit; see `run`."""
    dtype = checks.instance("run model", model, Model, "a StateSpaceModel or a MixedLinearModel").dtype
    ys = checks.as_numbers("ys", ys, "real numbers, shape (t, y)")
    if checks.is_concrete(ys):
        refuse_infinite("ys", ys, dtype)
    ys = np.asarray(ys, dtype) if isinstance(ys, np.ndarray) else jnp.asarray(ys, dtype)
    if ys.ndim != 2 or ys.shape[0] == 0:
        hint = "Write ys[:, None] for one measured component." if ys.ndim == 1 else ""
        checks.refuse("ys", "shape (t, y) with at least one step", f"shape {ys.shape}", hint)
    inputs = checked_inputs(inputs, ys.shape[0], "ys")
    unable = [part.sensor for part in model.each_mode() if not part.sensor.marginalizes]
    if unable and checks.is_concrete(ys):
        missing = np.isnan(np.asarray(ys))
        some = missing.any(axis=1) & ~missing.all(axis=1)
        if some.any():
            checks.refuse("ys", f"rows without NaN, or all NaN ({type(unable[0]).__name__} cannot leave out single components)",
                          f"row {int(np.argmax(some))} partly NaN", "Use a Gaussian sensor or noise with independent components.")
    return ys, inputs


def refuse_infinite(argument: str, ys: Any, dtype: Any) -> None:
    """Refuse measurements that are infinite, or too large for the type they are computed with."""
    wrong = checks.unknown(ys, dtype, nan=False)
    if wrong is not None:
        given = f"{np.asarray(ys)[tuple(wrong)]} at index {wrong.tolist()}"
        checks.refuse(argument, "finite numbers, or NaN for what was not measured", given)
