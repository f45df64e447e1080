"""What a run keeps of each step: functions of the law that return a dictionary of arrays. Any function of that form will do."""

from typing import Any

import jax

from motes.core import checks


def moments(law: Any) -> dict[str, jax.Array]:
    """Keep mean `(x,)` and covariance `(x, x)`; the default."""
    return {"mean": law.mean(), "cov": law.cov()}


def means(law: Any) -> dict[str, jax.Array]:
    """Keep the mean alone."""
    return {"mean": law.mean()}


def laws(law: Any) -> dict[str, Any]:
    """Keep everything: memory grows with the number of particles times steps."""
    return {"mean": law.mean(), "cov": law.cov(), "law": law}


def modes(law: Any) -> dict[str, jax.Array]:
    """Keep mean, covariance and the probabilities of the modes `(m,)`; for the filters of jump-Markov systems.

    Raises:
        MotesError: the law knows no modes.
    """
    if not hasattr(law, "mode_probabilities"):
        checks.refuse("keep.modes", "a filter of jump-Markov systems", f"one whose law is a {type(law).__name__}")
    return {**moments(law), "mode_probabilities": law.mode_probabilities()}


def nothing(law: Any) -> dict[str, jax.Array]:
    """Keep only the info of each step and the last law."""
    return {}
