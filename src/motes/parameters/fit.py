"""Maximum likelihood: the parameters of a state-space model under which its measurements are most probable."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from motes.core import checks, random
from motes.core.progress import bars
from motes.core.record import replace
from motes.core.types import Inputs, KeyLike, Measurements
from motes.filters.interface import Filter
from motes.models.interface import Model
from motes.parameters.climbing import Ascent, climbed, looked_around, started, verdict
from motes.parameters.expectation_maximization import ask_linear, maximized
from motes.parameters.fitted import Fit
from motes.parameters.likelihood import Likelihood, likelihood_of
from motes.parameters.named import parameters_of
from motes.parameters.response_surface import KEYS, surveyed


def fit(  # noqa: PLR0913 (what one may say of a fit, each by its name)
    model_of: Callable[[Any], Model], ys: Measurements, init: Mapping[str, ArrayLike] | ArrayLike, inputs: Inputs = None, *,
    names: Iterable[str] | None = None, fixed: Mapping[str, ArrayLike] | None = None, positive: Iterable[str] = (),
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None, filter: Filter | None = None, by: str = "likelihood",
    burn: int = 0, rounds: int = 200, key: KeyLike = 0,
) -> Fit:  # fmt: skip
    """Estimate the parameters of a model by maximum likelihood.

    All is computed in float64, also where the session works in float32; the fitted model is in the session's precision. Shows progress
    where the error stream is a terminal, or in a notebook.

    Sources: Nocedal, Wright 2006, Numerical Optimization, algorithm 6.1 (the climb); Box, Wilson 1951, On the experimental attainment of
    optimum conditions (the top of a likelihood by simulation).

    Example:
        >>> model_of = lambda p: mo.models.local_level(p["irregular"], p["level"])
        >>> xs, ys = mo.simulate(0, model_of({"irregular": 1.0, "level": 0.1}), 200)
        >>> found = mo.fit(model_of, ys, {"irregular": 0.5, "level": 0.5}, positive=("irregular", "level"), burn=1)

    Args:
        model_of: function of the parameters, a dictionary or vector as `init` is, that returns a model; JAX traces it.
        ys: measurements `(t, y)` as `mo.run` takes them (NaN: not measured), what `mo.times` gives, or a list of such arrays, one for each
            of several independent sequences.
        init: parameters to begin with: numbers, or arrays, by name, or a vector `(p,)`.
        inputs: of the model, with the time axis first; of several sequences a list of them.
        names: of the numbers of a vector.
        fixed: parameters that are held at a value, by name.
        positive: names of parameters that are above zero: their logarithms are searched.
        bounds: `(low, high)` by name, None for no bound.
        filter: whose likelihood is taken; None for `KalmanFilter` where the model is linear with Gaussian noises, and otherwise for
            `ParticleFilter(n=1000, scheme=mo.resampling.StopGradient())` with the same random numbers for all parameters.
        by: "likelihood", or "em" for expectation maximization with the exact smoother, of linear models (Shumway, Stoffer 1982,
            An approach to time series smoothing and forecasting using the EM algorithm).
        burn: steps at the beginning of each sequence that do not count: with a wide initial law, the number of its states.
        rounds: of the search, at most.
        key: JAX key or integer seed, for filters that draw.

    Raises:
        MotesError: an argument cannot be used, the likelihood is no number at `init`, or a parameter changes nothing.
    """
    checks.option("fit by", by, ("likelihood", "em"))
    checks.positive_integer("fit rounds", rounds)
    with jax.enable_x64(True):
        given = likelihood_of(parameters_of(init, names, fixed, positive, bounds), model_of, ys, inputs, filter, burn)
        with bars("likelihoods", passing=True) as drawn:
            task = drawn.add_task("fit", total=None)

            def told(value: float) -> None:
                drawn.update(task, advance=1, description=f"fit {value:.6g}")

            found = _estimates(given, random.step_keys(random.as_key(key), KEYS), by, rounds, told)
    used = replace(given.filter, on_collapse="raise") if filter is None else filter
    return Fit(model=_model_at(model_of, given.parameters.given(jnp.asarray(found["values"]))), filter=repr(used), **found)


def _model_at(model_of: Callable[[Any], Model], parameters: Any) -> Model:
    """Return the model of the estimates in the session's own precision; while they were searched no value was known, and none refused."""
    try:
        return model_of(parameters)
    except checks.MotesError as error:
        checks.refuse("fit model_of", "a model at the estimates", f"'{str(error).rstrip('.')}'",
                      "Keep parameters where models are: variances by positive=, others by bounds=.")  # fmt: skip


def _estimates(given: Likelihood, keys: jax.Array, by: str, rounds: int, told: Callable[[float], object]) -> dict[str, Any]:
    """Climb, and return what that says of the parameters, in their own units."""
    form, ascent, error = given.parameters, Ascent(keys[:1], given, told), None
    z = started(ascent, form.coordinates())
    here = ascent.slope(z)[0]
    noisy = Ascent(keys[1:2], given, told).slope(z)[0] != here
    if by == "em":
        ask_linear(given)
        z = maximized(ascent, z, rounds)
        top = looked_around(ascent, z)
    elif noisy:
        top, error = surveyed(keys, given, z, rounds, told)
    else:
        top = climbed(ascent, z, rounds)
    converged, message, inverse = verdict(top, form)
    values, free = np.asarray(top.given.parameters.natural(top.z)), top.free
    slopes = np.diag(np.asarray(jax.jacfwd(top.given.parameters.natural)(top.z)))
    covariance = np.zeros((values.size, values.size))
    covariance[np.ix_(free, free)] = np.nan if inverse is None else inverse * np.outer(slopes[free], slopes[free])
    if noisy:
        spread = np.zeros(values.size)
        spread[free] = np.nan if error is None else error * np.abs(slopes[free])
    simulated = f" by simulation, {keys.size} at a time" if noisy else ""
    method = "expectation maximization" if by == "em" else f"maximum likelihood{simulated}"
    return {"values": values, "covariance": covariance, "log_likelihood": top.log_likelihood, "measured": given.steps,
            "simulation_error": spread if noisy else None, "rounds": top.rounds, "names": form.names,
            "held": tuple(np.asarray(top.given.parameters.held).tolist()), "groups": form.groups, "converged": converged,
            "message": message, "method": method}  # fmt: skip
