"""Messages that come twice, late, out of order, or from a clock that was set: where each has its place, or that it has none."""

import heapq
import statistics
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from motes.core.checks import MotesError, refuse
from motes.io.instants import SAME
from motes.live.counts import Counts
from motes.live.message import Message
from motes.live.settings import Live

REMEMBERED = 1000
"""Messages among which one is a duplicate; and numbers that may be lost at once, however short the time was."""
STUBBORN = 20
"""So many messages in a row that have no place come from a clock that was set back, or a source that began anew."""
LOST = 10
"""Times as many numbers as the usual step says may be lost in a time; what says more is wild."""
USUAL = 5
"""Last steps whose median is the usual one: a gap, or one wild time, does not change it."""


class Placed(NamedTuple):
    """A message that is to be taken.

    Attributes:
        message: what came.
        back: how many of the last steps come after it.
        anew: whether the filter is to begin anew with it.
    """

    message: Message
    back: int = 0
    anew: bool = False


class Order:
    """The rule for the order of messages, and the last ones that were taken.

    Attributes:
        window: those of the last steps, `lag + 1` at most, the present one last; where the clock was set, the time of the one before is
            what the new clock would have said.
    """

    def __init__(self, settings: Live, counts: Counts):
        """Begin before the first message."""
        self.settings, self.counts = settings, counts
        self.lag = settings.lag if settings.late == "fold in" else 0
        self.window: deque[Placed] = deque(maxlen=self.lag + 1)
        self._seen: deque[tuple[float, int]] = deque(maxlen=REMEMBERED)
        self._known: set[tuple[float, int]] = set()
        self._waiting: list[tuple[float, int, Message]] = []
        self._came = self._stubborn = self._twice = 0
        self._latest: Message | None = None
        self._gaps: deque[float] = deque(maxlen=USUAL)
        self._arrived: float | None = None
        self._newest: float | None = None

    def take(self, message: Message) -> Iterator[Placed]:
        """Give what is to be taken now that a message came, each once the one before was; with "wait" it may be others than this one.

        Raises:
            MotesError: the clock of the source was set, and the run is to end then.
        """
        known = self.settings.duplicate == "drop" and self._is_known(message)
        try:
            yield from self._taken_in(message, known)
        except MotesError:
            # who goes on from a file meets it again
            self._not_come(message, known)
            raise

    def _taken_in(self, message: Message, known: bool) -> Iterator[Placed]:
        if known:
            self._twice += 1
            if self._is_stubborn():
                yield from self.rest()
                yield self._begun_anew(message)
            else:
                self.counts.add("duplicates", f"{_called(message)} came before and is dropped.")
        elif self.settings.late != "wait" or message.time is None:
            placed = self._placed(message)
            if placed is not None:
                yield placed
        else:
            if self._newest is not None and message.time < self._newest - self.settings.jump:
                # what waits came before the clock was set
                yield from self.rest()
                self._newest = None
            self._came += 1
            # a message in between ends a row of duplicates, whether it has a place or not is told later
            self._twice = 0
            taken = self.window[-1].message.time if self.window else None
            if self._newest is not None and (message.time if taken is None else taken) <= message.time < self._newest:
                self.counts.add("sorted")
            if self._newest is None or message.time >= self._newest:
                self._newest, self._latest = message.time, message
            heapq.heappush(self._waiting, (message.time, self._came, message))
            yield from self._due(self._newest - self.settings.wait)

    def _not_come(self, message: Message, known: bool) -> None:
        """Forget a message at which the run ends."""
        self._waiting = [one for one in self._waiting if one[2] is not message]
        heapq.heapify(self._waiting)
        self._latest = None
        if self._seen and not known:
            self._known.discard(self._seen.pop())

    def has(self, message: Message) -> bool:
        """Tell whether a message is the newest of those that were taken, or of those that wait."""
        return message is self._latest or (bool(self.window) and self.window[-1].message is message)

    def rest(self) -> Iterator[Placed]:
        """Give what still waits, in order; where a source has ended."""
        return self._due(float("inf"))

    def taken(self, placed: Placed) -> None:
        """Note that a message was taken, after all that are to come before it."""
        self.window.append(placed)

    def since(self, placed: Placed) -> float | None:
        """Return the seconds from the last step to one that comes next, never less than 0; None where they are not known."""
        time = placed.message.time
        if time is None:
            return None
        before = self.window[-1].message.time if self.window else time
        return 0.0 if before is None else max(0.0, time - before)

    def back(self, steps: int) -> list[Placed]:
        """Take the last steps back, and return them in order."""
        return [self.window.pop() for _ in range(steps)][::-1]

    def settle(self) -> None:
        """Forget all steps but the present one: none of them can be gone back to."""
        present = self.window[-1]
        self.window.clear()
        self.window.append(present)

    def kept(self) -> dict[str, Any]:
        """Return what a checkpoint keeps, as JSON can hold it."""
        return {"window": [(one.message.content, one.message.number, one.message.time) for one in self.window], "gaps": list(self._gaps),
                "waiting": [message.content for _, _, message in sorted(self._waiting)], "newest": self._newest, "seen": list(self._seen),
                "stubborn": self._stubborn, "twice": self._twice}  # fmt: skip

    def go_on(self, kept: dict[str, Any], message: Callable[[Any], Message]) -> list[Placed]:
        """Take back what a checkpoint kept, but for the last steps, which it returns: the first was taken before the checkpoint.

        Args:
            kept: by `kept`.
            message: makes a message of its content.
        """
        self._newest, self._stubborn, self._twice = kept["newest"], kept["stubborn"], kept["twice"]
        self._gaps.extend(kept["gaps"])
        for content in kept["waiting"]:
            self._came += 1
            waits = message(content)
            assert waits.time is not None
            heapq.heappush(self._waiting, (waits.time, self._came, waits))
        self._seen.extend((mark, digest) for mark, digest in kept["seen"])
        self._known = set(self._seen)
        return [Placed(message(content)._replace(number=number, time=time)) for content, number, time in kept["window"]]

    def _due(self, until: float) -> Iterator[Placed]:
        while self._waiting and self._waiting[0][0] <= until:
            # it waits still where the run ends at it
            placed = self._placed(self._waiting[0][2])
            heapq.heappop(self._waiting)
            if placed is not None:
                yield placed

    def _is_known(self, message: Message) -> bool:
        mark = message.number if message.number is not None else message.time
        if mark is None:
            return False
        # two sensors may measure at one time, and a source may begin anew: the same is what says the same
        key = (mark, message.digest)
        if key in self._known:
            return True
        if len(self._seen) == REMEMBERED:
            self._known.discard(self._seen[0])
        self._seen.append(key)
        self._known.add(key)
        return False

    def _placed(self, message: Message) -> Placed | None:
        time = message.time
        arrived, self._arrived = self._arrived, message.arrived
        if not self.window:
            return Placed(message)
        last = self.window[-1].message.time
        passed = None if time is None or last is None else time - last
        if passed is not None:
            gone = float("inf") if message.arrived is None or arrived is None else message.arrived - arrived
            if passed < -self.settings.jump or passed - gone > self.settings.jump:
                return self._jumped(message, passed)
        missing = self._missing(message)
        if missing > REMEMBERED and missing > LOST * (passed or 0.0) / (self._usual() or float("inf")):
            return self._without_place(message, "wild", f"{_called(message)} has a number far ahead of the time, and is dropped.")
        back = self._later(message)
        # a number that is older with a time that is newer is of a source that began anew
        if back and (back == len(self.window) or (passed or 0.0) > SAME):
            return self._without_place(message, "dropped", f"{_called(message)} came too late and is dropped.")
        self._stubborn = self._twice = 0
        before = self.window[-1 - back].message.time
        if time is not None and before is not None and time < before - SAME:
            self.counts.add("backward", f"the time goes back by {before - time:.3g} s at {_called(message)}, and counts as a step of 0 s.")
        if back:
            if message.number is not None and self.counts.of["missing"]:
                self.counts.of["missing"] -= 1
            self.counts.add("late", f"{_called(message)} came late and is taken at its place, {back} steps back.")
            return Placed(message, back)
        if passed is not None and passed > 0:
            self._gaps.append(passed)
        if missing > 0:
            self.counts.add("missing", number=missing)
        return Placed(message)

    def _usual(self) -> float:
        return statistics.median_low(self._gaps) if self._gaps else 0.0

    def _missing(self, message: Message) -> int:
        """Return how many numbers are between a message and the last step."""
        last = self.window[-1].message.number
        return 0 if message.number is None or last is None else message.number - last - 1

    def _without_place(self, message: Message, kind: str, why: str) -> Placed | None:
        self._stubborn += 1
        if self._is_stubborn():
            return self._begun_anew(message)
        self.counts.add(kind, why)
        return None

    def _is_stubborn(self) -> bool:
        """Tell whether too many messages in a row had no place."""
        return self._stubborn + self._twice >= STUBBORN

    def _later(self, message: Message) -> int:
        """Return how many of the last steps come after a message."""
        by_number, time = message.number is not None, message.time
        found = 0
        for placed in reversed(self.window):
            if by_number and placed.message.number is not None:
                later = placed.message.number > message.number  # type: ignore[operator]
            else:
                later = time is not None and placed.message.time is not None and placed.message.time > time + SAME
            if not later:
                break
            found += 1
        return found

    def _jumped(self, message: Message, passed: float) -> Placed:
        way = f"{abs(passed):.3g} s {'ahead' if passed > 0 else 'back'}"
        return self._from_here_on(message, f"the clock of the source went {way} at {_called(message)}")

    def _begun_anew(self, message: Message) -> Placed:
        return self._from_here_on(message, f"{STUBBORN} messages in a row had no place: the source began anew by {_called(message)}")

    def _from_here_on(self, message: Message, said: str) -> Placed:
        if self.settings.clock_jump == "stop":
            refuse("live clock_jump", f"messages in order, and times within {self.settings.jump:g} s", said,
                   'Set clock_jump = "bridge" or "begin anew" to go on.')  # fmt: skip
        self._stubborn = self._twice = 0
        self._seen.clear()
        self._known.clear()
        if self.settings.clock_jump == "begin anew" or not self.window:
            self.counts.add("jumps", f"{said}: the filter begins anew.")
            self.window.clear()
            return Placed(message, anew=True)
        usual = self._usual()
        self.counts.add("jumps", f"{said}: it counts as the usual step of {usual:.3g} s.")
        # what came before the jump cannot be told from what is late after it
        self.settle()
        # that of the new clock is never shifted: it would lose digits
        time = None if message.time is None else message.time - usual
        self.window[-1] = Placed(self.window[-1].message._replace(number=None, time=time))
        return Placed(message)


def _called(message: Message) -> str:
    if message.number is not None:
        return f"message {message.number}"
    return "a message" if message.time is None else f"the message of {message.time!r:.30} s"
