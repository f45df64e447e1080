"""What a page shows of a stream: the filter's thread leaves the newest state in a slot, and the thread of the page makes frames of it.

Of a step that is left in the slot nothing is computed on the filter's thread, nothing is copied, and nothing is waited for.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from motes.core import settings
from motes.core.findings import Finding
from motes.core.packed import Packed
from motes.diagnostics.diagnose import diagnose
from motes.filters.history import Carry, History
from motes.filters.info import Info
from motes.filters.interface import Filter
from motes.filters.keep import moments
from motes.filters.stream import Stream
from motes.report.film import KEPT_POINTS, LEADING, MOST_POINTS, Frame, Reel, Seen, frame, row
from motes.report.run import MOMENTS, Film, columns_of
from motes.report.scene import Scene, encoded

WAITING = 20_000
"""Steps whose records wait for the page at most, and that a report judges at most."""
JUDGED = 200
"""Last steps that the page judges in words."""
EARLY, EARLY_BYTES = 64, 32 << 20
"""First steps whose laws are held until they are drawn, and bytes of them, at most: many come while programs are compiled."""
MOST_ROWS = 4_096
"""Rows that are held; where there are more, every second one goes."""
MEMORY, MINUTES = 96 << 20, 10.0
"""Bytes and minutes of moments that are held to go back to."""
SURPLUS = 4
"""How many times as many particles are fetched as are drawn: some filters hold many without weight."""
EVERY = 0.5
"""Seconds between two judgements."""
TOLD = 40
"""Lines about what was found that are held."""

LOG = logging.getLogger(__name__)


class Step(NamedTuple):
    """What the filter's thread leaves of a step.

    Attributes:
        info: record of the step.
        seconds: that it took; NaN where nobody measured.
        time: of the measurement, seconds; NaN where steps are only numbered.
    """

    info: Info
    seconds: float
    time: float


class Left(NamedTuple):
    """What is in the slot.

    Attributes:
        number: how many steps were left by then.
        held: what goes from step to step.
        filter: that it is of.
        step: the newest.
        picture: what was seen, or None.
    """

    number: int
    held: Packed
    filter: Filter
    step: Step
    picture: Any


class Waiting(NamedTuple):
    """A step that was not looked at yet.

    Attributes:
        number: how many steps were left by then.
        step: the step.
        held: what goes from it to the next, where it is to be drawn too; else None.
    """

    number: int
    step: Step
    held: Packed | None


@partial(jax.jit, static_argnames=("most", "moving"))
def _seen(law: Any, most: int, moving: Callable[[Any], Any] | None) -> dict[str, Any]:
    found, places = law.weighted_points(), {} if moving is None else {"moving": moving(law)}
    if found is None:
        return {**moments(law), **places}
    # the others are thinned by their weights, which are numbers only outside of the program
    every = -(-found[0].shape[1] // (SURPLUS * most))
    return {**moments(law), **places, "points": found[0][:, ::every], "log_weights": found[1][::every]}


class Recorder:
    """Moments and rows of a stream, made of what is left in its slot; `turn` and `film` may be called on any thread, `leave` on one."""

    def __init__(self, filter: Filter, model: Any, scene: Scene, budget: float | None = None):
        """Take filter and model of the stream, where it is drawn, and the seconds that a step may take."""
        self.scene, self.budget, self.label, self._names = scene, budget, repr(filter), tuple(model.names)
        self._settings = settings.in_force()
        self._slot: Left | None = None
        self._shown: Left | None = None
        self._steps: deque[Waiting] = deque(maxlen=WAITING)
        self._left, self._early = 0, -1
        self._record: deque[np.ndarray] = deque(maxlen=WAITING)
        self._turning = threading.Lock()
        self.lock = threading.Lock()
        self.reel = Reel(MEMORY, 60 * MINUTES)
        self.newest: Frame | None = None
        self.findings: tuple[Finding, ...] = ()
        self.told: deque[tuple[int, str]] = deque(maxlen=TOLD)
        self.columns = columns_of(scene)
        self.rows = np.zeros((MOST_ROWS, len(self.columns)))
        self.count, self.generation, self._every, self._skipped = 0, 0, 1, 0
        self.late = self.taken = self.unknown = 0
        self.log_likelihood = float("nan")
        self._judged = -np.inf

    def leave(self, stream: Stream, step: Step, picture: Any = None) -> None:
        """Leave the newest step of a stream in the slot; called on the filter's thread."""
        held = stream.held
        if held is None:
            return
        if self._early < 0:
            self._early = min(EARLY, EARLY_BYTES // (1 + sum(array.nbytes for array in held.arrays)))
        self._left += 1
        self._steps.append(Waiting(self._left, step, held if self._left <= self._early else None))
        self._slot = Left(self._left, held, stream.filter, step, picture)

    def turn(self) -> bool:
        """Make a moment of what was left since the last turn; tells whether there was something."""
        with self._turning:
            slot, self._slot = self._slot, None
            if slot is None:
                return False
            with settings.enforced(self._settings):
                self._take(slot)
            return True

    def _take(self, slot: Left) -> None:
        """Take in the records that wait, then draw: what cannot be drawn was taken all the same."""
        came: list[Waiting] = []
        while self._steps and self._steps[0].number <= slot.number:
            came.append(self._steps.popleft())
        # so many may have come since that its own record is gone, too
        came = came or [Waiting(slot.number, slot.step, None)]
        self._record.extend(np.array([float(leaf) for leaf in jax.tree.leaves(one.step.info)]) for one in came)
        carry: Carry = slot.held.whole()
        evidence = float(carry.evidence.value()) if slot.filter.has_evidence else float("nan")
        with self.lock:
            self.unknown += slot.number - self.taken - len(came)
            self.taken, self.log_likelihood = slot.number, evidence
            self.late += 0 if self.budget is None else sum(one.step.seconds > self.budget for one in came)
        if self._shown is None or slot.filter is not self._shown.filter:
            # with a budget it has another number of particles than it was named with
            self.label = repr(slot.filter)
        self._shown = slot
        parts: list[list[Step]] = [[]]
        for one in came:
            parts[-1].append(one.step)
            if one.held is not None and one is not came[-1]:
                # one of the first that cannot be drawn is left out: the newest will say why
                with suppress(Exception):
                    self._draw(one.held.whole(), parts[-1])
                    parts.append([])
        try:
            self._draw(carry, parts[-1], slot.picture)
        except Exception:
            # what cannot be drawn is not drawn: the filter goes on, and the page with it
            LOG.exception("a moment could not be drawn")
        if time.monotonic() - self._judged > EVERY:
            self._judge()

    def _draw(self, carry: Carry, steps: list[Step], picture: Any = None) -> None:
        """Make a moment of the last of some steps, and a row of them all."""
        moving = None if self.scene.moving is None else self.scene.moving.of
        found = {name: np.asarray(value) for name, value in _seen(carry.state, MOST_POINTS, moving).items()}
        number = 0 if self.newest is None else self.newest.number + 1
        made = frame((number, int(carry.step), steps[-1].time), Seen(**found), self.scene, _in_numbers(carry.u),
                     b"" if picture is None else encoded(picture, "JPEG"))  # fmt: skip
        seconds = np.array([step.seconds for step in steps])
        infos = [step.info for step in steps]
        timed = seconds[np.isfinite(seconds)]
        usual = float(np.median(timed)) if timed.size else np.nan
        evidences, rings = float(np.mean([one.log_evidence for one in infos])), any(bool(one.alarm) for one in infos)
        told = row(made, self.scene, (usual, min(float(one.ess) for one in infos), evidences, rings))
        with self.lock:
            self.newest = made
            self.reel.add(made.thinned(KEPT_POINTS), time.monotonic())
            self._keep(told)

    def _keep(self, told: np.ndarray) -> None:
        self._skipped += 1
        if self._skipped < self._every and not told[LEADING.index("alarm")]:
            return
        self._skipped = 0
        if self.count == MOST_ROWS:
            self.rows[: MOST_ROWS // 2] = self.rows[::2].copy()
            self.count, self.generation, self._every = MOST_ROWS // 2, self.generation + 1, 2 * self._every
        self.rows[self.count] = told
        self.count += 1

    def film(self, title: str) -> Film:
        """Return what a report shows of all this, of every step that was left by now."""
        self.turn()
        with self._turning, self.lock:
            facts = [("filter", self.label), ("steps", str(self.taken))]
            if np.isfinite(self.log_likelihood):
                facts.append(("log likelihood", f"{self.log_likelihood:.6g}"))
            if self.budget is not None:
                facts.append(("late steps", f"{self.late} took longer than {1e3 * self.budget:g} ms"))
            if self.unknown:
                facts.append(("without a record", f"{self.unknown} steps, which came faster than they could be looked at"))
            if self.taken > len(self._record):
                facts.append(("judged", f"the last {len(self._record)} steps"))
            frames, rows = self.reel.chosen(MOMENTS), self.rows[: self.count].copy()
            findings = () if self._shown is None else diagnose(self._history(self._shown, WAITING)).findings
            return Film(title=title, facts=facts, scene=self.scene, frames=frames, rows=rows, findings=findings)

    def _judge(self) -> None:
        """Say in words what is wrong with the last steps, as `diagnose` does."""
        assert self._shown is not None
        history = self._history(self._shown, JUDGED)
        found = diagnose(history).findings
        known = {one.name for one in self.findings}
        with self.lock:
            self.told.extend((int(history.last.step), str(one)) for one in found if one.name not in known)
            self.findings = found
        self._judged = time.monotonic()

    def _history(self, shown: Left, most: int) -> History:
        """Return the records of so many last steps at most, as a run that ended with what was shown last."""
        carry: Carry = shown.held.whole()
        leaves, structure = jax.tree.flatten(shown.step.info)
        columns = np.array(list(self._record)[-most:]).T
        info = structure.unflatten([column.astype(np.asarray(leaf).dtype) for column, leaf in zip(columns, leaves, strict=True)])
        start = np.asarray(int(carry.step) + 1 - columns.shape[1])
        return History({}, info, carry, start, self._names, repr(shown.filter), **shown.filter.traits)  # type: ignore[arg-type]


def _in_numbers(u: Any) -> Any:
    return jax.tree.map(np.asarray, u)
