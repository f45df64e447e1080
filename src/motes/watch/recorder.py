"""What a page shows of a stream: the filter's thread leaves the newest state in a slot, and the thread of the page makes frames of it.

Of a step that is left in the slot nothing is computed on the filter's thread, nothing is copied, and nothing is waited for.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
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
"""Steps whose records wait for the page at most."""
JUDGED = 200
"""Last steps that are judged in words."""
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
        held: what goes from step to step.
        filter: that it is of.
        step: the newest.
        picture: what was seen, or None.
    """

    held: Packed
    filter: Filter
    step: Step
    picture: Any


@partial(jax.jit, static_argnames=("most", "moving"))
def _seen(law: Any, most: int, moving: Callable[[Any], Any] | None) -> dict[str, Any]:
    found, places = law.weighted_points(), {} if moving is None else {"moving": moving(law)}
    if found is None:
        return {**moments(law), **places}
    # the others are thinned by their weights, which are numbers only outside of the program
    every = -(-found[0].shape[1] // (SURPLUS * most))
    return {**moments(law), **places, "points": found[0][:, ::every], "log_weights": found[1][::every]}


class Recorder:
    """Moments and rows of a stream, made of what is left in its slot; `turn` is called on one thread alone."""

    def __init__(self, filter: Filter, model: Any, scene: Scene, budget: float | None = None):
        """Take filter and model of the stream, where it is drawn, and the seconds that a step may take."""
        self.scene, self.budget, self.label, self._names = scene, budget, repr(filter), tuple(model.names)
        self._settings = settings.in_force()
        self._slot: Left | None = None
        self._steps: deque[Step] = deque(maxlen=WAITING)
        self._last: deque[tuple[int, Info]] = deque(maxlen=JUDGED)
        self.lock = threading.Lock()
        self.reel = Reel(MEMORY, 60 * MINUTES)
        self.newest: Frame | None = None
        self.findings: tuple[Finding, ...] = ()
        self.told: deque[tuple[int, str]] = deque(maxlen=TOLD)
        self.columns = columns_of(scene)
        self.rows = np.zeros((MOST_ROWS, len(self.columns)))
        self.count, self.generation, self._every, self._skipped = 0, 0, 1, 0
        self.late = self.taken = 0
        self.log_likelihood = float("nan")
        self._judged = -np.inf

    def leave(self, stream: Stream, step: Step, picture: Any = None) -> None:
        """Leave the newest step of a stream in the slot; called on the filter's thread."""
        if stream.held is not None:
            self._steps.append(step)
            self._slot = Left(stream.held, stream.filter, step, picture)

    def turn(self) -> bool:
        """Make a moment of what was left since the last turn; tells whether there was something."""
        slot, self._slot = self._slot, None
        if slot is None:
            return False
        with settings.enforced(self._settings):
            self._make(slot)
        return True

    def _make(self, slot: Left) -> None:
        carry: Carry = slot.held.whole()
        picture, last = slot.picture, slot.step
        moving = None if self.scene.moving is None else self.scene.moving.of
        found = {name: np.asarray(value) for name, value in _seen(carry.state, MOST_POINTS, moving).items()}
        steps = []
        while self._steps:
            steps.append(self._steps.popleft())
            if steps[-1] is last:
                break
        now, first = int(carry.step), int(carry.step) - len(steps) + 1
        self._last.extend((first + place, step.info) for place, step in enumerate(steps))
        number = 0 if self.newest is None else self.newest.number + 1
        made = frame((number, now, last.time), Seen(**found), self.scene, _in_numbers(carry.u),
                     b"" if picture is None else encoded(picture, "JPEG"))  # fmt: skip
        seconds = np.array([step.seconds for step in steps])
        infos = [step.info for step in steps]
        timed = seconds[np.isfinite(seconds)]
        usual = float(np.median(timed)) if timed.size else np.nan
        evidences, rings = float(np.mean([one.log_evidence for one in infos])), any(bool(one.alarm) for one in infos)
        told = row(made, self.scene, (usual, min(float(one.ess) for one in infos), evidences, rings))
        evidence = float(carry.evidence.value()) if slot.filter.has_evidence else float("nan")
        with self.lock:
            self.newest, self.log_likelihood = made, evidence
            self.reel.add(made.thinned(KEPT_POINTS), time.monotonic())
            self.taken += len(steps)
            self.late += 0 if self.budget is None else int(np.sum(timed > self.budget))
            self._keep(told)
        if time.monotonic() - self._judged > EVERY:
            self._judge(carry, slot.filter)

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
        """Return what a report shows of all this."""
        with self.lock:
            facts = [("filter", self.label), ("steps", str(self.taken))]
            if np.isfinite(self.log_likelihood):
                facts.append(("log likelihood", f"{self.log_likelihood:.6g}"))
            if self.budget is not None:
                facts.append(("late steps", f"{self.late} took longer than {1e3 * self.budget:g} ms"))
            frames, rows = self.reel.chosen(MOMENTS), self.rows[: self.count].copy()
            return Film(title=title, facts=facts, scene=self.scene, frames=frames, rows=rows, findings=self.findings)

    def _judge(self, carry: Carry, filter: Filter) -> None:
        """Say in words what is wrong with the last steps, as `diagnose` does."""
        info = jax.tree.map(lambda *parts: np.stack(parts), *(info for _, info in self._last))
        start = np.asarray(self._last[0][0])
        history = History({}, info, carry, start, self._names, repr(filter), **filter.traits)  # type: ignore[arg-type]
        found = diagnose(history).findings
        known = {one.name for one in self.findings}
        with self.lock:
            self.told.extend((int(carry.step), str(one)) for one in found if one.name not in known)
            self.findings = found
        self._judged = time.monotonic()


def _in_numbers(u: Any) -> Any:
    return jax.tree.map(np.asarray, u)
