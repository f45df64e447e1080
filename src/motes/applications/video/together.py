"""Histories of several targets as one, and taken apart again: so that they are kept, saved and gone on from together."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.applications.video.frames import of_stride
from motes.core.logspace import RunningSum
from motes.core.record import replace, values
from motes.filters.history import Carry, History
from motes.filters.info import Info
from motes.laws.observed import Observed

OWN = "targets"
"""What is kept of each target alone, by its name."""


def together(histories: Mapping[str, History], y: Any) -> History:
    """Return the histories of targets over the same pictures as one.

    Its mean and covariance are those of all states; its record has of each step the smallest effective size, the sum of the log evidence
    and otherwise the largest value.

    Args:
        histories: by the name of the target.
        y: the last measurement, as all targets have it.
    """
    each = list(histories.values())
    mean = np.concatenate([one.mean for one in each], axis=1)
    cov, begin = np.zeros((*mean.shape, mean.shape[1]), mean.dtype), 0
    for one in each:
        block = slice(begin, begin + one.mean.shape[1])
        cov[:, block, block], begin = one.cov, block.stop
    own = {name: {**one.kept, "info": values(one.info)} for name, one in histories.items()}
    ends = {name: {"law": one.last.state, "evidence": values(one.last.evidence), "suspicion": one.last.suspicion}
            for name, one in histories.items()}  # fmt: skip
    info = jax.tree.map(lambda *parts: jnp.asarray(np.max(parts, axis=0)), *(one.info for one in each))
    least, evidence = (jnp.asarray(sums([getattr(one.info, name) for one in each], axis=0))
                       for name, sums in (("ess", np.min), ("log_evidence", np.sum)))  # fmt: skip
    info = replace(info, ess=least, log_evidence=evidence)
    total = RunningSum(*(jnp.asarray(np.sum([getattr(one.last.evidence, part) for one in each])) for part in ("total", "missed")))
    last = Carry(ends, total, max(one.last.suspicion for one in each), Observed(y, each[0].last.y.there), None, each[0].last.step)
    names = tuple(f"{state}_{name}" for name, one in histories.items() for state in one.names)
    return replace(each[0], kept={"mean": jnp.asarray(mean), "cov": jnp.asarray(cov), OWN: own}, info=info, last=last, names=names)


def apart(history: History, name: str, like: tuple[str, ...], stride: int) -> History:
    """Return the history of one target.

    Args:
        history: of several.
        name: of the target.
        like: names of its states.
        stride: with which it is looked at.
    """
    own, last = dict(history.kept[OWN][name]), history.last
    info = Info(**{field: jnp.asarray(value) for field, value in own.pop("info").items()})
    if last is not None:
        end = last.state[name]
        evidence = RunningSum(**{part: jnp.asarray(value) for part, value in end["evidence"].items()})
        y = Observed(of_stride(last.y.value, stride), last.y.there)
        last = replace(last, state=end["law"], evidence=evidence, suspicion=jnp.asarray(end["suspicion"]), y=y)
    return replace(history, kept=own, info=info, last=last, names=like)
