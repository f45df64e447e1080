"""Rules of the loop: however it is driven, the same call gives the same numbers. Each returns what is wrong, or None."""

import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

from motes.core.record import values
from motes.filters.history import joined
from motes.filters.stream import Stream
from motes.testing.session import GAP, STEPS, Session, differing, quietly, times_traced


def _unlike(what: str, found: Any, wanted: Any) -> str | None:
    count = differing(found, wanted)
    if count == 0:
        return None
    return f"{what} {'have other shapes' if count is None else f'differ in {count} numbers'}."


def stream(session: Session) -> str | None:
    """A stream draws the numbers of a run, to the bit."""
    stream, whole = session.stream(), session.whole
    means = session.fed(stream, range(STEPS), looked_at=range(1, STEPS, 2))
    steps = np.flatnonzero([differing(one, other) != 0 for one, other in zip(means, whole.mean, strict=True)])
    if steps.size:
        return f"the means differ from step {steps[0]} on by up to {np.nanmax(np.abs(np.stack(means) - whole.mean)):.3g}."
    wrong = _unlike("the last laws", stream.state, whole.state)
    if wrong is None and session.filter.has_evidence:
        wrong = _unlike("the log likelihoods", stream.log_likelihood, whole.log_likelihood)
    return wrong


def unmeasured(session: Session) -> str | None:
    """A step at which nothing is measured only predicts, to the bit, and tells of no likelihood."""
    whole = session.whole
    told = {name: float(getattr(whole.info, name)[GAP]) for name in ("log_evidence", "collapsed", "nis", "freedom")}
    loud = [f"{name} {value:g}" for name, value in told.items() if value != 0]
    if loud:
        return f"where nothing is measured its record has {', '.join(loud)}."
    means = session.fed(session.stream(), range(GAP + 2), unmeasured=(GAP,))
    rows = range(GAP + 2) if not session.filter.look_ahead else (GAP + 1,)  # which moves when the next measurement comes
    return _unlike("a stream that only predicts there and the run: the means", [means[row] for row in rows],
                   [whole.mean[row] for row in rows])  # fmt: skip


def cut(session: Session) -> str | None:
    """A run that is continued goes on as a stream that is not cut, to the bit."""
    rest, stream = session.run(session.gappy[STEPS:], after=session.whole), session.stream()
    means = session.fed(stream, range(2 * STEPS), looked_at=range(STEPS // 2, 2 * STEPS, 2))
    wrong = _unlike("a stream and the run that was cut: the means", np.stack(means), joined([session.whole, rest]).mean)
    wrong = wrong or _unlike("a stream and the run that was cut: the last laws", stream.state, rest.state)
    if wrong is None and session.filter.has_evidence:
        wrong = _unlike("a stream and the run that was cut: the log likelihoods", stream.log_likelihood, rest.log_likelihood)
    return wrong


def checkpoint(session: Session) -> str | None:
    """A stream that is saved and loaded goes on as if nothing had happened, to the bit."""
    stream, half = session.stream(), STEPS // 2
    session.fed(stream, range(half))
    with tempfile.TemporaryDirectory() as folder:
        again = Stream.load(stream.save(Path(folder) / "checkpoint.npz"), session.filter, session.model)
    session.fed(again, range(half, STEPS))
    if again.t != STEPS - 1:
        return f"it is at step {again.t}, not {STEPS - 1}."
    return _unlike("the last laws", again.state, session.whole.state)


def compiled_once(session: Session) -> str | None:
    """A second run of the same kind, also by an equal filter, traces nothing anew."""
    _ = session.clean
    before = times_traced()
    session.run(session.ys + session.ys.dtype.type(0.1), key=4)
    with_data = times_traced() - before
    session.run(session.ys, filter=type(session.filter)(**values(session.filter)))
    with_equal = times_traced() - before - with_data
    causes = [name for name, count in (("other data", with_data), ("an equal filter", with_equal)) if count]
    return f"a run with {' and one with '.join(causes)} was traced anew." if causes else None


def vmapped(session: Session) -> str | None:
    """Under `vmap` over keys, models and data each run gives what it gives alone."""
    lanes, (model, ys) = session.lanes, session.other
    # a draw can tip over where sums are rounded otherwise, which is far less than what another key changes
    slack = 0.3 * lanes.mean[: lanes.alike].std(axis=0) + 2e-3 * np.sqrt(np.diagonal(np.asarray(session.clean.cov), axis1=1, axis2=2))
    for lane in (0, 1, lanes.alike, lanes.alike + 1):
        given = {"model": model, "ys": ys} if lane >= lanes.alike else {"ys": session.ys}
        alone = session.run(key=lanes.keys[lane], **given)
        off = np.abs(lanes.mean[lane] - np.asarray(alone.mean))
        if not (off <= slack + 1e-5).all():
            return f"the mean of lane {lane} is off by up to {np.max(off):.3g}."
    return None


def eager(session: Session) -> str | None:
    """Without `jit` two steps give what they give with it."""
    with jax.disable_jit(), quietly():
        found = session.run(session.ys[:2])
    wanted = session.clean
    off = np.abs(np.asarray(found.mean) - np.asarray(wanted.mean[:2]))
    scale = np.sqrt(np.diagonal(np.asarray(wanted.cov[:2]), axis1=1, axis2=2))
    if not (off <= 1e-3 * scale + 1e-5).all():
        return f"the means differ by up to {np.max(off):.3g}."
    evidence = np.abs(np.asarray(found.info.log_evidence) - np.asarray(wanted.info.log_evidence[:2]))
    return None if (evidence <= 1e-3).all() else f"the log evidence differs by up to {np.max(evidence):.3g}."
