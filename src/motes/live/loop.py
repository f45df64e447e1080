"""The loop of a live run: messages in, steps of a filter, records out, checkpoints; until the source ends or it is asked to."""

import gc
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import CollapseError, MotesError
from motes.core.packed import Packed
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.stream import Stream
from motes.live import pace
from motes.live.checkpoint import Checkpoint
from motes.live.counts import LOG
from motes.live.inbox import POLL, Inbox
from motes.live.message import Form, Unreadable
from motes.live.order import Order, Placed
from motes.live.settings import Live
from motes.live.silence import Silence
from motes.live.sink import Guarded, Sink, write_to_all
from motes.live.source import Source

SETTLED = 100
"""Steps after which what is alive then is taken to stay: Python need not look through it again for what can be freed."""


class Taken(NamedTuple):
    """What watchers are told of a step, beside the stream.

    Attributes:
        info: record of the step.
        y: the measurement.
        time: seconds; None where messages have none.
        seconds: that the step took.
        late: whether a late message was taken at its place; the law is that of the newest step all the same.
    """

    info: Info
    y: Any
    time: float | None
    seconds: float
    late: bool


Watcher = Callable[[Stream, Taken], object]


@jax.jit
def _moments(held: Packed) -> jax.Array:
    """Return means and standard deviations of a law, as one array, of what a step handed on."""
    state = held.whole().state
    return jnp.concatenate([state.mean(), jnp.sqrt(jnp.maximum(jnp.diagonal(state.cov()), 0))])


class Work(NamedTuple):
    """What runs.

    Attributes:
        key: JAX key or integer seed.
        filter: the filter.
        model: its model.
        form: what makes inputs of a message.
    """

    key: Any
    filter: Filter
    model: Any
    form: Form


class Run:
    """A live run.

    Attributes:
        stream: the filter at work; None before the first message.
        counts: what came of the messages.
    """

    def __init__(
        self, work: Work, source: Source, settings: Live, *, sinks: Sequence[Sink] = (), watchers: Sequence[Watcher] = (),
        checkpoint: Checkpoint | None = None, budget: float | None = None,
    ):  # fmt: skip
        """Take the parts.

        Args:
            work: what runs.
            source: where messages come from.
            settings: the rules.
            sinks: where results go.
            watchers: are called after each step, by the thread of the filter: cheap, and never waiting.
            checkpoint: where the run is kept; None for nowhere.
            budget: seconds that a step may take; None for any.
        """
        self._work, self.source, self.settings, self.counts = work, source, settings, source.counts
        self.order = Order(settings, source.counts)
        self.sinks = [Guarded(sink) for sink in sinks]
        self.watchers, self.checkpoint = list(watchers), checkpoint
        self.stream: Stream | None = None
        self._last: Any = None
        self._budget = budget
        self._filter: Filter | None = None
        self._pace: pace.Pace | None = None
        self._steps = 0

    def restore(self) -> bool:
        """Go on from the checkpoint, if there is one; tell whether there was.

        Raises:
            FileError: it is damaged or of another run.
        """
        filter, model = self._work.filter, self._work.model
        kept = None if self.checkpoint is None or not self.settings.resume else self.checkpoint.load(filter, model, self.order.lag)
        if kept is None:
            return False
        self.stream, beside = kept
        if beside.get("position") is not None:
            # before anything is cut
            self.source.check(beside["position"], beside.get("mark"))
        for guarded in self.sinks:
            guarded.sink.go_on(beside["sinks"].get(guarded.sink.place), cut=self.source.repeats)
        if self.stream is None:
            return False
        self._filter = self.stream.filter
        again = self.order.go_on(beside["order"], self.source.message)
        self.order.taken(again[0])
        for placed in again[1:]:
            self._step(placed, again=True)
        self.counts.of = Counter(beside["counts"])
        self.source.remember(beside["last"])
        self._last, self.source.position = beside["last"], beside["position"]
        if self.source.position is not None:
            self.source.go_on(self.source.position)
        LOG.info("goes on after step %d%s.", self.stream.t, "" if self.source.repeats else "; what came since cannot be asked for again")
        if self._budget is not None:
            self._paced()
        return True

    def go(self, ends: Callable[[], bool]) -> None:
        """Take messages until the source ends, or `ends` says so.

        Raises:
            MotesError: the clock of the source was set and the run is to end then, or nothing came for as long as it has patience.
        """
        if self.checkpoint is not None and self.stream is None:
            self.checkpoint.begin({"sinks": self._kept_by_sinks()})
        for guarded in self.sinks:
            guarded.sink.ends = ends
        inbox = Inbox(self.source)
        silence = Silence(self.source.name, self.settings.patience)
        saved, unsaved = time.monotonic(), False
        try:
            while not ends():
                came = inbox.take(POLL)
                now = time.monotonic()
                if came is None:
                    for placed in self.order.rest():
                        self._take(placed)
                    break
                said = False
                for place, received in enumerate(came):
                    said = self._heard(received) or said
                    if time.monotonic() - saved > self.settings.checkpoint:
                        self.save()
                        saved, unsaved = time.monotonic(), False
                    else:
                        unsaved = True
                    if ends():
                        inbox.put_back(came[place + 1 :])
                        break
                if unsaved and now - saved > self.settings.checkpoint:
                    # nothing comes that would have it saved
                    self.save()
                    saved, unsaved = now, False
                if said:
                    # a batch may have taken long
                    silence.broken()
                else:
                    silence.goes_on(now, len(came))
        finally:
            inbox.close()
            if not self.save() and self.checkpoint is not None and self.stream is None:
                self.checkpoint.forget()
            self.close()

    def close(self) -> None:
        """Close the source and the sinks."""
        self.source.close()
        for sink in self.sinks:
            sink.close()

    def _heard(self, received: Any) -> bool:
        """Take what came, and tell whether it was a message."""
        position, held = self.source.position, self._work.form.held
        message = self.source.understood(received)
        if message is None:
            return False
        if message.y is None:
            self.counts.add("inputs")
        try:
            for placed in () if message.y is None else self.order.take(message):
                self._take(placed)
        except MotesError:
            # the run ends at it: who goes on begins with it
            if not self.order.has(message):
                self.source.position, self._work.form.held = position, held
            raise
        if message.y is None or self.order.has(message):
            self._last = message.content
        else:
            # inputs of what was dropped, refused, or is of a step before do not hold for those that come
            self._work.form.held = held
        return True

    @property
    def kept_at(self) -> int | None:
        """Step of the last checkpoint; None where there is none."""
        return None if self.checkpoint is None else self.checkpoint.step

    def save(self) -> bool:
        """Write a checkpoint of what was taken by now, and tell whether it is there."""
        sinks = self._kept_by_sinks()
        if self.checkpoint is None or self.stream is None or self._last is None or not self.order.window:
            return False
        position = self.source.position
        beside = {"counts": self.counts.kept(), "order": self.order.kept(), "last": self._last, "position": position,
                  "mark": None if position is None else self.source.mark(position), "sinks": sinks}  # fmt: skip
        return self.checkpoint.save(self.stream, beside, len(self.order.window) - 1)

    def _kept_by_sinks(self) -> dict[str, Any]:
        return {guarded.sink.place: guarded.kept() for guarded in self.sinks}

    def _take(self, placed: Placed) -> None:
        """Take a message at its place, write what came of it, and tell who watches."""
        began = time.perf_counter()
        self.stream = None if placed.anew else self.stream
        again = self.order.back(placed.back)
        if placed.back:
            assert self.stream is not None
            self.stream.back(placed.back)
        taken = self._step(placed._replace(back=0, anew=False))
        for one in again:
            self._step(one, again=True)
        if not taken:
            return
        stream = self.stream
        assert stream is not None and stream.held is not None and stream.info is not None
        numbers = np.asarray(_moments(stream.held), np.float64).tolist()
        seconds = time.perf_counter() - began
        self.counts.add("steps")
        record = self._record(stream, stream.info, numbers, seconds, placed)
        write_to_all(self.sinks, record)
        told = Taken(stream.info, placed.message.y, self.order.window[-1].message.time, seconds, placed.back > 0)
        for watcher in self.watchers:
            watcher(stream, told)
        self._steps += 1
        if self._steps == SETTLED:
            gc.collect()
            gc.freeze()
        self._paced(seconds)

    def _step(self, placed: Placed, again: bool = False) -> bool:
        """Take a step, and tell whether its measurement could be used in any way; one that is taken again was counted before."""
        message, y = placed.message, placed.message.y
        try:
            u = self._work.form.with_step(message.u, self.order.since(placed))
            if self.stream is None:
                self.stream = self._started(u, y)
            else:
                self.stream.predict(u)
        except Unreadable as reason:
            self.counts.add("unreadable", f"{self.source.name}: {reason}.")
            return False
        except MotesError as reason:
            self.counts.add("refused", f"{reason}")
            if self.stream is None:
                self._work.form.forget()
            return False
        try:
            self.stream.update(y)
        except CollapseError as reason:
            if not again:
                self.counts.add("collapsed", f"{reason} The measurement is left out.")
            self.stream.update(None)
        except MotesError as reason:
            if not again:
                self.counts.add("refused", f"{reason}")
            if self.stream.held is None:
                self.stream = None
                self._work.form.forget()
                return False
            self.stream.update(None)
        self.order.taken(placed)
        return True

    def _begun(self, u: Any, filter: Filter) -> Stream:
        return Stream(self._work.key, filter, self._work.model, u, self.order.lag)

    def _started(self, u: Any, y: Any) -> Stream:
        """Begin a stream; with a budget one of as many particles as it allows."""
        if self._filter is None:
            self._filter = self._work.filter
            if self._budget is not None and self._filter.fixed_count is not None:
                self._filter = pace.fitting(self._filter, partial(self._begun, u), y, u, self._budget)
        return self._begun(u, self._filter)

    def _paced(self, seconds: float | None = None) -> None:
        if self._budget is None or self.stream is None:
            return
        if self._pace is None:
            self._pace = pace.Pace(self._budget, self._compiled)
            self._pace.ahead(self.stream.filter)
        smaller = None if seconds is None else self._pace.taken(seconds)
        if smaller is not None:
            LOG.warning("budget: steps keep running late; from step %d on there are %s particles.", self.stream.t, smaller.fixed_count)
            self.stream.resize(smaller)
            self._filter = smaller
            self.order.settle()
            self._pace.ahead(smaller)

    def _compiled(self, filter: Filter) -> None:
        """Take three steps with a filter of another size, so that its programs are compiled."""
        placed = self.order.window[-1]
        message = placed.message
        try:
            u = self._work.form.with_step(message.u, None if message.time is None else 0.0)
            stream = self._begun(u, filter)
            for _ in range(2):
                stream.update(message.y)
                np.asarray(_moments(stream.held))
                stream.predict(u)
        except MotesError as reason:
            LOG.debug("a smaller size cannot be compiled ahead: %s", reason)

    def _record(self, stream: Stream, info: Info, numbers: list[float], seconds: float, placed: Placed) -> dict[str, Any]:
        names = stream.model.names
        newest = self.order.window[-1].message
        return {
            "step": stream.t, "time": newest.time, **({"number": newest.number} if self._work.form.number else {}),
            **{f"mean {name}": number for name, number in zip(names, numbers, strict=False)},
            **{f"sd {name}": number for name, number in zip(names, numbers[len(names) :], strict=True)},
            "ess": float(info.ess), "log_evidence": float(info.log_evidence), "alarm": bool(info.alarm), "collapsed": bool(info.collapsed),
            "late": placed.back, "seconds": round(seconds, 6),
        }  # fmt: skip
