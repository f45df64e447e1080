"""One verb for all smoothers."""


from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import replace
from motes.core.types import Inputs, KeyLike, Measurements
from motes.filters import notices
from motes.filters.data import checked_data, steps_of
from motes.filters.history import History
from motes.laws.observed import Observed
from motes.models.canonical import canonical, one_of, shape_of
from motes.models.interface import Model
from motes.models.state_space import at_step, checked_inputs
from motes.models.times import parted
from motes.smoothers.interface import Smoothed, Smoother, Steps
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


def smooth(
    key: KeyLike, smoother: Smoother, model: Model, history: History, ys: Measurements | None = None, inputs: Inputs = None
) -> Smoothed:
    """Smooth a run: the law of each state given the measurements of all steps.

    Pure: it can be jitted and vmapped. The second call with the same kinds of arguments does not compile again.

    Args:
        key: JAX key or integer seed; another than that of the run.
        smoother: the smoother, such as `RauchTungStriebelSmoother()`.
        model: the model of the run.
        history: of the run, from its first step to its last (`joined` if it was cut), with laws kept where the smoother needs them.
        ys: measurements of the run `(t, y)`, for smoothers that look at them and for models whose noises are correlated; what `times` gave
            has the inputs, too.
        inputs: inputs of the run, with the time axis first.

    Raises:
        MotesError: smoother, model, history, measurements and inputs do not fit each other.
    """
    if not isinstance(smoother, Smoother):
        checks.refuse("smooth smoother", "a smoother such as RauchTungStriebelSmoother()", type(smoother).__name__)
    if not isinstance(history, History):
        checks.refuse("smooth history", "what mo.run gave", type(history).__name__)
    checks.instance("smooth model", model, Model, "the model of the run")
    if isinstance(history.state, dict):
        checks.refuse("smooth history", "a history whose laws are known", "one from a file that does not name their kind",
                      "Smooth before saving, or run anew.")
    ys, inputs = parted("smooth", ys, inputs)
    count = history.info.ess.shape[0]
    inputs = checked_inputs(inputs, count, "history", names=model.input_names)
    if ys is not None:
        ys, inputs = checked_data(model, ys, inputs)
        form, of_run = jax.tree.map(one_of, ys), jax.tree.map(shape_of, history.last.y)
        if isinstance(ys, Observed) and (form != of_run or steps_of(ys) != count):
            checks.refuse("smooth ys", "the measurements of the run", "others")
        if not isinstance(ys, Observed):
            checks.shape("smooth ys", ys, (count, *of_run.shape), "(as in the run)")
    elif model.correlated:
        checks.refuse("smooth ys", "the measurements of the run (its noises are correlated)", "None")
    known = canonical(model, jax.tree.map(one_of, inputs), history.last.y)
    # the label says with which parameters, and would make each filter compile anew; as would times and models
    bare = replace(history, label="", labels=None, made_by=None, times=None)
    found = _smooth(random.key_or_data(key), smoother, known, bare, ys, inputs, Beside((smoother, known)))
    if checks.is_concrete((found.mean, history.rounding)):
        _ask_found(smoother, found.mean, history)
        _tell_of_wide_priors(smoother, history)
    of_steps = {"labels": history.labels, "start": history.start, "times": history.times}
    return replace(found, names=history.names, label=repr(smoother), **of_steps)


def _ask_found(smoother: Smoother, mean: jax.Array, history: History) -> None:
    """Refuse means that are no numbers where the run's own are."""
    if smoother.lost is None:
        return
    own, (expected, hint) = history.kept.get("mean", history.info.log_evidence), smoother.lost
    void = np.isnan(np.asarray(mean)).any(axis=1)
    if void.any() and not np.isnan(np.asarray(own)).any():
        step = int(history.start) + int(np.flatnonzero(void)[-1])
        checks.refuse(f"{type(smoother).__name__} history", expected, f"none of them at step {step}", hint)


def _tell_of_wide_priors(smoother: Smoother, history: History) -> None:
    """Warn where a smoother loses digits that the filter did not."""
    if smoother.subtracts and not history.subtracts:
        for one in notices.coarseness(replace(history, subtracts=True)):
            if one.name == "wide prior":
                cure = "Use a narrower prior or float64 (jax.config.update('jax_enable_x64', True))."
                checks.warn(f"smooth: {one.text} The first steps may be wrong. {cure}")


@jitted
def _smooth(
    key: jax.Array, smoother: Smoother, model: Model, history: History, ys: Any, inputs: Inputs, beside: Beside
) -> Smoothed:
    model, drive = model.independent()
    inputs = drive.over(inputs, ys)
    count = history.info.ess.shape[0]
    prepared = smoother.prepare(model, history, at_step(inputs, 0))
    return smoother.smooth(random.as_key(key), prepared, history, Steps(inputs, history.start + jnp.arange(count, dtype=jnp.int32), ys))
