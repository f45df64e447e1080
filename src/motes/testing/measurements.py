"""Rules of what a filter makes of measurements. Each returns what is wrong, or None."""

from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import CollapseError, MotesError
from motes.core.record import replace
from motes.filters.history import History
from motes.filters.kalman import KalmanFilter
from motes.resampling.policy import Never
from motes.testing.models import EXTREME, extreme, linear, one_state
from motes.testing.session import STEPS, DoesNotApply, Session, quietly

OUTLIER = 3
"""Step of the outlier."""


def missing(session: Session) -> str | None:
    """Components that are not measured leave the law as a model that never had them does."""
    session.ask_own_model()
    for seen in combinations(range(3), 2):
        ys = session.ys.copy()
        ys[:, [i for i in range(3) if i not in seen]] = np.nan
        ys[2:] = np.nan  # further on draws can tip over where sums are rounded otherwise
        told = [{"mean": one.mean, "covariance": one.cov, "log evidence": one.info.log_evidence}
                for one in (session.run(ys), session.run(ys[:, list(seen)], model=linear(seen)))]  # fmt: skip
        for name in told[0]:
            one, other = (np.asarray(each[name])[:2] for each in told)
            if not np.allclose(one, other, rtol=1e-3, atol=1e-4):
                return f"with components {seen} of 3 measured the {name} is off by {np.max(np.abs(one - other)):.3g}."
    return None


def likelihood(session: Session) -> str | None:
    """On a linear-Gaussian model its likelihood is that of the Kalman filter: the mean ratio over many keys, level 1e-6, is 1.

    Give or take 0.02, for grids, and for kernels that widen a cloud.
    """
    session.ask_likelihood()
    session.ask_own_model()
    exact = session.run(session.ys, filter=KalmanFilter()).log_likelihood
    alike = session.lanes.alike
    ratio = np.exp(session.lanes.log_evidence[:alike].astype(float).sum(axis=1) - float(exact))
    error = 4.9 * ratio.std(ddof=1) / np.sqrt(alike)
    if abs(ratio.mean() - 1) < error + 0.02:
        return None
    return f"it is {ratio.mean():.4g} times the exact one, on average over {alike} keys, give or take {error:.2g}."


def derivative(session: Session) -> str | None:
    """Its log likelihood can be differentiated by the numbers of the model."""
    session.ask_likelihood()
    with quietly():
        found = jax.grad(lambda model: session.run(session.ys, model=model).log_likelihood, allow_int=True)(session.model)
    numbers = [np.asarray(leaf) for leaf in jax.tree.leaves(found) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    wrong = sum(int(np.sum(~np.isfinite(leaf))) for leaf in numbers)
    return f"{wrong} of {sum(leaf.size for leaf in numbers)} derivatives are not finite numbers." if wrong else None


def _struck(session: Session, size: float) -> np.ndarray:
    ys = session.ys.copy()
    ys[OUTLIER] += size * np.resize([1.0, -0.7], ys.shape[1])
    return ys


def _unused(history: History, session: Session) -> str | None:
    """Tell whether a measurement far off was not marked as unused, or anything else was."""
    steps = np.flatnonzero(np.asarray(history.info.collapsed)).tolist()
    if session.filter.has_evidence and steps != [OUTLIER]:  # a cost is never too high
        return f"steps {steps} are marked as collapsed, not step {OUTLIER} alone."
    return None


def outlier(session: Session) -> str | None:
    """After an outlier of 10, 1e3 or 1e6 all stays finite, and the estimate comes back to three standard deviations of the truth."""
    never_resamples = isinstance(getattr(session.filter, "policy", None), Never)
    for size in (10.0, 1e3, 1e6):
        ys = _struck(session, size)
        history = session.run(ys)
        if not all(np.isfinite(np.asarray(leaf)).all() for leaf in (history.mean, history.cov)):
            return f"after one of {size:g} the estimates are not finite."
        wrong = _unused(history, session) if size > 1e2 else None
        if wrong:
            return f"after one of {size:g} {wrong}"
        exact = session.run(ys, filter=KalmanFilter(on_collapse="predict")) if session.own else session.clean
        sigma = np.sqrt(np.diagonal(np.asarray(exact.cov)[-1]))
        off = np.abs(np.asarray(history.mean) - session.truth[:STEPS])[-3:].mean(axis=0) / sigma
        if not never_resamples and not (off < 3).all():
            return f"{STEPS - OUTLIER} steps after one of {size:g} the estimate is {off.max():.3g} standard deviations off."
    return None


def collapse(session: Session) -> str | None:
    """A measurement that nothing explains is told of with its step."""
    session.ask_likelihood()
    history = session.run(_struck(session, 1e6))
    words = "all weights vanished" if session.filter.weighs else "innovation"
    try:
        history.raise_on_collapse()
    except CollapseError as told:
        text = str(told)
        return None if text.startswith(f"step {OUTLIER}:") and words in text else f"it says {text:.120}"
    return "it is used, and nobody is told."


def inflation(session: Session) -> str | None:
    """With on_collapse="inflate" a measurement that nothing explains leaves the mean as it is and the covariance four times as large."""
    session.ask_likelihood()
    ys = _struck(session, 1e6)
    plain, wide = session.run(ys), session.run(ys, filter=replace(session.filter, on_collapse="inflate"))
    if not all(np.isfinite(np.asarray(leaf)).all() for leaf in (wide.mean, wide.cov)):
        return "the estimates are not finite."
    mean, cov = (np.asarray(kept)[OUTLIER] for kept in (plain.mean, plain.cov))
    if not np.allclose(wide.cov[OUTLIER], 4 * cov, rtol=1e-3, atol=1e-4) or not np.allclose(wide.mean[OUTLIER], mean, rtol=1e-3, atol=1e-3):
        return f"variances {np.diagonal(cov)} became {np.diagonal(np.asarray(wide.cov)[OUTLIER])}."
    return _unused(wide, session)


def weights(session: Session) -> str | None:
    """Likelihoods that are no use for any state collapse, and those that are none for some states are not used; never in silence."""
    session.ask_own_model()
    if not session.filter.weighs:
        raise DoesNotApply("the filter weighs nothing.")
    if session.filter.adds_inputs:
        raise DoesNotApply("its inputs are a dictionary.")
    model, ys = extreme(), session.ys[:, :2]
    for number, case in enumerate(EXTREME):
        if number == 0:
            continue
        inputs = np.zeros(STEPS, np.float32)
        inputs[2] = number
        try:
            history = session.run(ys, model=model, inputs=inputs)
        except MotesError as refusal:
            raise DoesNotApply(f"the filter refuses a sensor of which the density alone is known ({refusal})") from None
        if not np.isfinite(np.asarray(history.mean)).all():
            return f"where the likelihood is {case} the mean is not finite."
        if case.startswith("not"):
            counts = np.asarray(history.info.invalid)[1:3].tolist()
            if counts[0] or not counts[1]:
                return f"where the likelihood is {case} it counts {counts} of them before and there."
            continue
        steps = np.flatnonzero(np.asarray(history.info.collapsed)).tolist()
        if steps[:1] != [2]:
            return f"where the likelihood at step 2 is {case} it marks steps {steps} as collapsed."
    return None


def _finite(session: Session, ys: np.ndarray, size: int, **others: Any) -> str | None:
    mean = np.asarray(session.run(ys, **others).mean)
    if mean.shape != (STEPS, size):
        return f"means of {STEPS} steps and {size} states have shape {mean.shape}."
    return None if np.isfinite(mean).all() else "means are not finite."


def fewest(session: Session) -> str | None:
    """It works with one particle."""
    if not session.has_size:
        raise DoesNotApply("the filter has no n.")
    return _finite(session, session.ys, session.model.size, filter=session.filter.with_particles(1))


def smallest(session: Session) -> str | None:
    """It works on one state, with three particles."""
    session.ask_own_model()
    filter = session.filter.with_particles(3) if session.has_size else session.filter
    try:
        return _finite(session, session.ys[:, :2], 1, filter=filter, model=one_state())
    except MotesError as refusal:
        raise DoesNotApply(f"its parameters are for another model ({refusal})") from None
