"""What a user hands over as measurements: brought to arrays, or refused in one line that says where."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.types import Inputs
from motes.io import tabular
from motes.io.labels import Labels, agree, untold_gaps
from motes.laws.observed import Observed
from motes.models.interface import Model
from motes.models.state_space import checked_inputs


def labelled_data(model: Any, ys: Any, inputs: Inputs) -> tuple[Any, Inputs, Labels | None]:
    """Return measurements and inputs as arrays, and what stands beside the measurements, or refuse what does not fit.

    Args:
        model: that they are of.
        ys: as `checked_data` takes them.
        inputs: likewise; where they have times of their own, these must be those of the measurements.

    Raises:
        MotesError: they do not fit; the message says where.
    """
    sensors = dict(checks.instance("run model", model, Model, "a StateSpaceModel or a MixedLinearModel").each_mode()[0].sensor.sensors)
    ys, found = tabular.unlabelled("ys", ys)
    if found is None:
        return *checked_data(model, ys, inputs), None
    agree_inputs("inputs", "the times of ys", found, inputs, "Align them first: inputs = inputs.reindex(ys.index).")
    untold_gaps("ys", found)
    if sensors and found.columns and set(found.columns) <= set(sensors) and not isinstance(ys, Mapping):
        ys = {name: ys[:, [place]] for place, name in enumerate(found.columns)}
    return *checked_data(model, ys, inputs), found


def agree_inputs(argument: str, expected: str, labels: Labels, inputs: Inputs, hint: str) -> None:
    """Refuse inputs with times of their own that are others than those of labels; see `io.labels.agree`."""
    for leaf in jax.tree.leaves(tabular.by_name(inputs)):
        agree(argument, expected, labels, tabular.unlabelled(argument, leaf)[1], hint)


def checked_data(model: Any, ys: Any, inputs: Inputs) -> tuple[Any, Inputs]:
    """Return measurements and inputs as arrays, or refuse what does not fit; see `run`.

    Measurements are an array `(t, y)` in the model's type, or `Observed` with the time axis first. Tables and series of other libraries
    lose their labels here, once they were asked whether rows are missing; `labelled_data` gives them, too.
    """
    dtype = checks.instance("run model", model, Model, "a StateSpaceModel or a MixedLinearModel").dtype
    sensors = [part.sensor for part in model.each_mode()]
    if tabular.is_labelled(ys):
        return labelled_data(model, ys, inputs)[:2]
    ys = sensors[0].packed(ys)
    if isinstance(ys, Observed):
        ys = jax.tree.map(lambda leaf: _numbers("ys", leaf, dtype) if _is_real(leaf) else leaf, ys)
        return ys, checked_inputs(inputs, steps_of(ys), "ys", names=model.input_names)
    ys = _with_rows(ys)
    whole = _stacked(ys) if isinstance(ys, (list, tuple)) and is_array(ys) else None
    if whole is not None or not is_array(ys) or _rank(ys) > 2:
        found = _observed(sensors, ys if whole is None else whole[0], dtype, None if whole is None else whole[1])
        return found, checked_inputs(inputs, steps_of(found), "ys", names=model.input_names)
    ys = _numbers("ys", ys, dtype)
    if ys.ndim != 2 or ys.shape[0] == 0:
        hint = "Write ys[:, None] for one measured component, np.array(ys) first of a list." if ys.ndim == 1 and ys.size else ""
        checks.refuse("ys", "shape (t, y) with at least one step", f"shape {ys.shape}", hint)
    inputs = checked_inputs(inputs, ys.shape[0], "ys", names=model.input_names)
    if checks.is_concrete(ys):
        missing = np.isnan(np.asarray(ys))
        if missing.any():
            _ask_whole(sensors, np.asarray(missing.any(axis=1) & ~missing.all(axis=1)))
    return ys, inputs


def of_one_step(model: Model, y: Any) -> Any:
    """Return one measurement as those of a run of one step, time axis first."""
    if is_array(y):
        return np.atleast_1d(checks.as_numbers("y", y))[None]
    return jax.tree.map(lambda leaf: np.asarray(checks.as_numbers("y", leaf))[None], model.each_mode()[0].sensor.in_arrays(y))


def steps_of(ys: Any) -> int:
    """Return of how many steps measurements are, time axis first."""
    return jax.tree.leaves(ys)[0].shape[0]


def refuse_infinite(argument: str, ys: Any, dtype: Any) -> None:
    """Refuse measurements that are infinite, or too large for the type they are computed with."""
    wrong = checks.unknown(ys, dtype, nan=False)
    if wrong is not None:
        given = f"{np.asarray(ys)[tuple(wrong)]} at index {wrong.tolist()}"
        checks.refuse(argument, "finite numbers, or NaN for what was not measured", given)


def _numbers(argument: str, ys: Any, dtype: Any) -> Any:
    """Return numbers as an array in the type that is computed with."""
    ys = checks.as_numbers(argument, ys, "real numbers, shape (t, y)" if argument == "ys" else "an array of numbers")
    if checks.is_concrete(ys):
        refuse_infinite(argument, ys, dtype)
    return np.asarray(ys, dtype) if isinstance(ys, np.ndarray) else jnp.asarray(ys, dtype)


def is_array(value: Any) -> bool:
    """Tell an array, or what NumPy makes one of (a list too), from a tree of arrays."""
    return type(value) in (list, tuple, np.ndarray) or (not isinstance(value, Mapping) and jax.tree_util.all_leaves([value]))


def _with_rows(ys: Any) -> Any:
    """Return a list of vectors with NaN in place of those that are None."""
    if type(ys) not in (list, tuple) or not any(one is None for one in ys):
        return ys
    sizes = {np.shape(one) for one in ys if one is not None and is_array(one) and _rank(one) == 1}
    return [np.full(next(iter(sizes)), np.nan) if one is None else one for one in ys] if len(sizes) == 1 else ys


def _rank(value: Any) -> int:
    """Return how many axes an array has; of lists that are none, which is said elsewhere, one."""
    try:
        return np.ndim(value)
    except ValueError:
        return 1


def _stacked(steps: Sequence[Any]) -> tuple[Any, np.ndarray] | None:
    """Put measurements that come one by one, None where there was none, behind one another; None if they are rows of numbers."""
    there = np.array([one is not None for one in steps])
    steps = [checks.as_numbers("ys", one) if one is not None and is_array(one) and _rank(one) > 1 else one for one in steps]
    some = [one for one in steps if one is not None]
    if not some or (is_array(some[0]) and _rank(some[0]) < 2):
        return None
    blank = jax.tree.map(lambda leaf: np.zeros_like(leaf) if not _is_real(leaf) else np.full_like(leaf, np.nan), some[0])
    forms = {str(jax.tree.map(lambda leaf: (np.shape(leaf), str(np.asarray(leaf).dtype)), one)) for one in some}
    if len(forms) > 1:
        checks.refuse("ys", "measurements of one form", " and ".join(sorted(forms))[:250], "Pad sets with NaN to one length.")
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(blank if one is None else one for one in steps)), there


def _is_real(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _observed(sensors: list[Any], ys: Any, dtype: Any, there: Any) -> Observed:
    """Return measurements of any form, time axis first.

    Args:
        sensors: of each mode.
        ys: tree of arrays.
        dtype: type of the states, which other numbers with a point get, too.
        there: at which steps there was a measurement at all, `(t,)`; None where the numbers say it.
    """
    given = f"an array of shape {np.shape(ys)}" if is_array(ys) else f"a {type(ys).__name__}"
    for sensor in sensors:
        if not sensor.measures_anything:
            checks.refuse("ys", f"shape (t, y), as {type(sensor).__name__} measures", given, "Write a Custom sensor for it.")

    def one(path: Any, leaf: Any) -> Any:
        array = checks.as_numbers(f"ys{jax.tree_util.keystr(path)}", leaf)
        return _numbers(f"ys{jax.tree_util.keystr(path)}", array, dtype) if _is_real(array) else array

    found = jax.tree_util.tree_map_with_path(one, ys)
    lengths = {np.shape(leaf)[0] if np.ndim(leaf) else None for leaf in jax.tree.leaves(found)}
    if len(lengths) != 1 or lengths & {0, None}:
        checks.refuse("ys", "arrays with the time axis first, one length, at least one step", f"first axes {sorted(map(str, lengths))}")
    steps, leaves = steps_of(found), jax.tree.leaves(found)
    real = [leaf.reshape(steps, -1) for leaf in leaves if _is_real(leaf)]
    module = np if checks.is_concrete(found) and not any(isinstance(leaf, jax.Array) for leaf in leaves) else jnp
    if there is None:
        silent = [module.isnan(leaf).all(axis=1) for leaf in real]
        there = ~module.stack(silent).all(axis=0) if len(real) == len(leaves) else module.ones(steps, bool)
    if real and checks.is_concrete(found):
        for sensor in sensors:
            for part, own in sensor.each(found):
                gaps = [np.isnan(np.asarray(leaf)).reshape(steps, -1) for leaf in jax.tree.leaves(own) if _is_real(leaf)]
                some = np.stack([leaf.any(axis=1) for leaf in gaps]).any(axis=0) if gaps else np.zeros(steps, bool)
                every = np.stack([leaf.all(axis=1) for leaf in gaps]).all(axis=0) if gaps else some
                _ask_whole([part], some & ~every & np.asarray(there))
    return Observed(found, there)


def _ask_whole(sensors: list[Any], partly: np.ndarray) -> None:
    """Refuse rows in which some numbers are missing, of sensors that cannot leave them out."""
    unable = [sensor for sensor in sensors if not sensor.marginalizes]
    if unable and partly.any():
        hint = ("Say partial=True where the density takes care of NaN, or use" if unable[0].measures_anything else "Use") + \
            " a Gaussian sensor or noise with independent components."
        checks.refuse("ys", f"rows without NaN, or all NaN ({type(unable[0]).__name__} cannot leave out single components)",
                      f"row {int(np.argmax(partly))} partly NaN", hint)
