"""What a run keeps of each step: functions of the law that return a dictionary of arrays. Any function of that form will do."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np

from motes.core import checks
from motes.laws.cloud import Cloud

Keep = Callable[[Any], dict[str, Any]]


def moments(law: Any) -> dict[str, jax.Array]:
    """Keep mean `(x,)` and covariance `(x, x)`; the default."""
    return {"mean": law.mean(), "cov": law.cov()}


def means(law: Any) -> dict[str, jax.Array]:
    """Keep the mean alone."""
    return {"mean": law.mean()}


def laws(law: Any) -> dict[str, Any]:
    """Keep everything: memory grows with the number of particles times steps."""
    return {"mean": law.mean(), "cov": law.cov(), "law": law}


def paths(law: Any) -> dict[str, Any]:
    """Keep mean, covariance, and particles with their ancestors but without what each carries (a Gaussian, a map); for `GenealogySmoother`.

    Raises:
        MotesError: the law has no particles that name their ancestors.
    """
    found = law.weighted_points() if getattr(law, "marks_ancestors", False) else None
    if found is None:
        checks.refuse("keep.paths", "a filter whose particles name their ancestors", f"one whose law is a {type(law).__name__}")
    points, log_weights = found
    return {**moments(law), "law": Cloud(points, log_weights, law.ancestors)}


def modes(law: Any = None, count: int = 0, lag: int = 0) -> Any:
    """Keep mean, covariance and the probabilities of the modes `(m,)`; for jump-Markov systems.

    With `keep=mo.keep.modes(lag=4)` also those of each of the last modes given all measurements till now, `(lag + 1, m)`, the newest first:
    `history.mode_probabilities_after(4)` makes a series of them. `run` has a `JumpMarkovFilter` remember as many.

    Args:
        law: of a filter for jump-Markov systems, or a cloud of a joined model; left out to choose what to keep.
        count: number of modes of the joined model; `run` knows it.
        lag: number of earlier modes.

    Raises:
        MotesError: the law knows no modes, or does not remember as many.
    """
    if law is None:
        checks.natural("keep.modes lag", lag)
        return partial(modes, lag=lag)
    found = law.mode_probabilities(count)
    if found is None:
        given = f"one whose law is a {type(law).__name__}" + ("" if count else ", of a model without modes")
        checks.refuse("keep.modes", "a filter of jump-Markov systems, or a cloud of a joined model", given)
    kept = {**moments(law), "mode_probabilities": found}
    if lag:
        delayed = law.delayed_mode_probabilities()
        if delayed is None or delayed.shape[0] <= lag:
            checks.refuse("keep.modes lag", "a filter that remembers modes, such as JumpMarkovFilter(n=30, lag=4)", lag)
        kept["delayed_mode_probabilities"] = delayed[: lag + 1]
    return kept


def after_lag(delayed: Any, lag: int) -> Any:
    """Return the series `(t, ...)` of what each row is known to be `lag` rows later; the last rows have fewer after them.

    Args:
        delayed: of each row what is known of it and of those before, the newest first, `(t, lag + 1, ...)` or more.
        lag: number of rows.
    """
    rows = np.arange(delayed.shape[0])
    seen = np.minimum(rows + lag, delayed.shape[0] - 1)
    return delayed[seen, seen - rows]


def clusters(law: Any, count: int = 4) -> dict[str, jax.Array]:
    """Keep mean, covariance, and the heaviest clusters of the law: their means `(k, x)`, covariances `(k, x, x)` and weights `(k,)`.

    Args:
        law: of any filter.
        count: k; `functools.partial(mo.keep.clusters, count=8)` keeps more.
    """
    found = law.modes(count)
    return {**moments(law), "cluster_mean": found.mean, "cluster_cov": found.cov, "cluster_weight": found.weight}


def with_modes(keep: Keep, count: int) -> Keep:
    """Return what to keep in a run of a joined model of so many modes; 0 for any other model."""
    return partial(modes, count=count, lag=_lag_of(keep)) if _keeps_modes(keep) else keep


def remembering(filter: Any, keep: Keep) -> Any:
    """Return a filter that remembers as many modes as are kept of it."""
    return filter.remembering(_lag_of(keep)) if _keeps_modes(keep) and _lag_of(keep) else filter


def _keeps_modes(keep: Keep) -> bool:
    return keep is modes or (isinstance(keep, partial) and keep.func is modes)


def _lag_of(keep: Any) -> int:
    return keep.keywords.get("lag", 0) if isinstance(keep, partial) else 0


def nothing(law: Any) -> dict[str, jax.Array]:
    """Keep only the info of each step and the last law."""
    return {}
